"""What the simulation gets wrong: evidence, named cause, extended model, measured gain."""
