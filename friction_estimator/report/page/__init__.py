"""The page that an engineer opens first: what it says, its charts, and the two ways it is written."""
