"""Fits to a whole record: second moments, variable projection, covariance."""
