"""Outputs that are never lost and never half written: built aside, exchanged, locked, swept."""
