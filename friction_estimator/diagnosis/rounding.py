"""What rounding of the force to a lattice makes of a prediction: its errors on lattices of other origins and steps."""

from collections.abc import Iterator

import numpy as np

from friction_estimator.core.sample import Floats

LATTICES = 40
FINER = 0.7
"""Lattices for which the gains that rounding makes are worked out, and the step of the finest over that of the force.
Where the force holds a few levels the fit has followed their rounded values, and lies on the lattice itself: another
origin then gives every level the same error, another step gives each its own (decision 0225)."""

GOLDEN = 0.6180339887498949
"""Share of a step between the origins of one lattice and the next: they spread evenly, and unlike the steps do."""


def rounding_errors(force_N: Floats, lattice_N: float, number: int = LATTICES) -> Iterator[Floats]:
    """Yield the errors of a force rounded to lattices of several origins and steps, (n,) each, N; none without one.

    The origin is the sensor's: the model does not know it to a step. The errors of a finer lattice are scaled to those
    of the force's own.

    >>> list(rounding_errors(np.array([0.0, 0.3]), 1.0, 1))
    [array([ 0. , -0.3])]
    """
    for k in range(number if lattice_N else 0):
        finer = 1.0 - (1.0 - FINER) * k / number
        step = finer * lattice_N
        shift = step * ((k * GOLDEN) % 1.0)
        yield (step * np.round((force_N - shift) / step) + shift - force_N) / finer
