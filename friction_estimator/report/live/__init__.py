"""Live views of a running node: a page in a browser, a screen of text."""
