"""Recordings: read, write, and the message types that carry samples."""
