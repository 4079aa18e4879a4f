"""Inner products of tall matrices in pieces so small that the linear algebra library starts no threads for them.

A machine that also drives a rig has no idle cores: threads that wait for each other in a spin loop then cost far
more than they bring (measured: a factor of five).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Floats

SMALL = 200_000
"""Multiplications in a product below which OpenBLAS stays on one thread (its own limit is 262,144)."""


def inner(left: NDArray[Any], right: NDArray[Any]) -> Floats:
    """Return left' right for (n, p) and (n, q), or (n,): (p, q) or (p,).

    >>> inner(np.ones((5, 2)), np.ones(5)).tolist()
    [5.0, 5.0]
    """
    n, p = left.shape
    q = 1 if right.ndim == 1 else right.shape[1]
    rows = max(16, SMALL // max(1, p * q))
    total = left[:rows].T @ right[:rows]
    for start in range(rows, n, rows):
        total = total + left[start : start + rows].T @ right[start : start + rows]
    return np.asarray(total, np.float64)
