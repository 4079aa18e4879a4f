"""Basis, theoretical curves, the two models and what fixed parameters predict."""
