"""Banded sparse matrices, by what scipy 1.11 has: its `diags_array` and `eye_array` came with 1.12 only."""

import numpy as np
from scipy.sparse import dia_array

from friction_estimator.core.sample import Floats


def diagonal(values: Floats) -> dia_array:
    """Return the matrix (n, n) with these values (n,) on its diagonal.

    >>> diagonal(np.array([1.0, 2.0])).toarray().tolist()
    [[1.0, 0.0], [0.0, 2.0]]
    """
    return dia_array((values[None, :], [0]), shape=(values.size, values.size))


def identity(size: int) -> dia_array:
    """Return the identity, (size, size)."""
    return diagonal(np.ones(size))


def differences(size: int) -> dia_array:
    """Return what takes the differences of neighbours, (size - 1, size).

    >>> differences(3).toarray().tolist()
    [[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]]
    """
    return dia_array((np.array([[-1.0], [1.0]]).repeat(size, axis=1), [0, 1]), shape=(size - 1, size))
