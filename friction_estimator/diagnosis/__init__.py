"""Show what the simulation gets wrong, name the cause, extend the model, measure the gain."""
