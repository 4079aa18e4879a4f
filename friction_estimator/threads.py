"""One thread for linear algebra: on matrices of a hundred columns more triple the work and move last bits.

The node and the command line agree bit for bit only if both use the same number.
"""

import os

VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Set the number of threads to 1 where the environment does not say otherwise; call before numpy is imported."""
    for name in VARIABLES:
        os.environ.setdefault(name, "1")
