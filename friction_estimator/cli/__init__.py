"""The command line: one small file a verb."""

from friction_estimator.threads import one_thread

one_thread()  # before a module of this package brings in numpy
