"""Adaptation sample by sample: laws, the compiled loop, estimator, live step, relinearisation, replay."""
