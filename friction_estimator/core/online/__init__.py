"""Adaptation sample by sample: laws, the compiled loop, estimator, live step, growth, replay."""
