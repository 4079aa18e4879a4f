"""The inverse of a triangular matrix, by numpy alone: scipy's binding of LAPACK is a tenth of the start of a node."""

import numpy as np

from friction_estimator.core.sample import Floats

LEAF = 48
"""Rows up to which a part is inverted at once."""


def inverse(lower: Floats) -> Floats:
    """Return the inverse of a lower triangular matrix, (n, n); it is lower triangular.

    By halves, of rows of length one::

        [[A, 0], [B, C]]^-1 = [[A^-1, 0], [-C^-1 B A^-1, C^-1]]

    So each entry is as accurate as its size allows where rows differ by many orders, as the deviations of a prior may;
    `numpy.linalg.inv` is as accurate as the largest. Raises LinAlgError where a number on the diagonal is 0.

    >>> inverse(np.array([[1e-6, 0.0], [1.0, 2.0]])).round(3).tolist()
    [[1000000.0, 0.0], [-500000.0, 0.5]]
    """
    length = np.linalg.norm(lower, axis=1)
    length[length == 0.0] = 1.0
    out = np.zeros_like(lower)
    _invert(lower / length[:, None], out)
    out /= length
    return out


def _invert(lower: Floats, out: Floats) -> None:
    n = len(lower)
    if n <= LEAF:
        out[:] = np.tril(np.linalg.inv(lower))
        return
    half = n // 2
    _invert(lower[:half, :half], out[:half, :half])
    _invert(lower[half:, half:], out[half:, half:])
    out[half:, :half] = -out[half:, half:] @ (lower[half:, :half] @ out[:half, :half])
