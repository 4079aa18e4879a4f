"""Many recordings diagnosed one by one: what each shows, since when, and how it grows over those of a rig."""
