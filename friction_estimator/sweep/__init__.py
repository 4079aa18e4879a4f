"""Configurations over recordings: which there are, what each is worth where it did not learn, in order."""
