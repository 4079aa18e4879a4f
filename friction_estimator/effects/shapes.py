"""Free shapes over speed, for causes whose dependence on speed no formula tells: quadratic B-splines of |v|.

B_j(|v|),  j = 0 ... SHAPES - 1,  sum_j B_j = 1,  knots evenly spaced in asinh(|v| / bend)

B_0 alone is not zero at standstill, the last one alone not at the top speed. What a sum of them makes lies between its
coefficients, so a step is not overshot.

The columns of a free shape are a force times all but the last of them, and then that force itself: the plainer form,
from which the others differ. The prior says by how much, where no sample shows it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats
from friction_estimator.effects.axis import BEND, REACH
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

SHAPES = 6
"""Splines from standstill to the top speed, narrowest at low speed."""

INTERVALS = SHAPES - 2
KNOTS = np.concatenate([[0.0, 0.0], np.arange(INTERVALS + 1.0) / INTERVALS, [1.0, 1.0]])

FREE = 2.0
"""Value of a regressor's key `shape` that asks for the free shape."""


TWICE = 3.0
"""And for the free shape with two dependences on the pressure."""


DEVIATION = 1.0
"""By how much a free shape may differ from the plainer form at a speed by the prior, over the rms of the friction."""

LOW_SPEED = 0.03
"""Share of the top speed at which the level of a free shape is stated: the boundary level, not the viscous part. Or at
the slowest speed that the record holds."""


def is_free(params: Mapping[str, float]) -> bool:
    """Return whether a regressor of these parameters has a free shape."""
    return params.get("shape", 0.0) >= FREE


def splines(velocity_m_s: Floats, reference: Reference) -> Floats:
    """Return the splines of the speed, (n, SHAPES)."""
    place = np.arcsinh(np.abs(velocity_m_s) / reference.bend_m_s) / REACH
    return weights_at(place)


def free(velocity_m_s: Floats, reference: Reference, first: int = 0) -> Floats:
    """Return the columns of a free shape of unit force, of the splines from `first` on, (n, SHAPES - first)."""
    return _about_all(splines(velocity_m_s, reference)[:, first:])


def free_at(share: float, first: int = 0) -> Floats:
    """Return `free` at a share of the top speed, (SHAPES - first,): its product with the coefficients is the shape."""
    return np.asarray(_about_all(weights_at(place_of(share))[:, first:])[0])


def _about_all(made: Floats) -> Floats:
    """Return splines, (n, c), with their sum in the place of the last of them."""
    made[:, -1] = made.sum(axis=1)
    return made


def weights_at(place: Floats) -> Floats:
    """Return the splines at places from 0 (standstill) to 1 (top speed), (n, SHAPES).

    >>> weights_at(np.array([0.0, 0.125, 1.0])).tolist()
    [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.25, 0.625, 0.125, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]
    """
    out = np.zeros((place.size, SHAPES))
    _fill(place, KNOTS, out)
    return out


@njit(cache=True)
def _fill(place, knots, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Write the three splines that are not zero at each place: Cox and de Boor, Piegl and Tiller's algorithm A2.2.

    SciPy's `BSpline.design_matrix` has the same bits, and takes 50 us for the one sample that a live node has.
    """
    for k in range(place.size):
        if np.isnan(place[k]):
            out[k] = np.nan
            continue
        x = min(max(place[k], 0.0), 1.0)
        first = min(int(x * (out.shape[1] - 2)), out.shape[1] - 3)
        i = first + 2  # knots[i] <= x <= knots[i + 1]
        here = 1.0 / (knots[i + 1] - knots[i])
        low, high = (knots[i + 1] - x) * here, (x - knots[i]) * here
        low /= knots[i + 1] - knots[i - 1]
        high /= knots[i + 2] - knots[i]
        out[k, first] = (knots[i + 1] - x) * low
        out[k, first + 1] = (x - knots[i - 1]) * low + (knots[i + 2] - x) * high
        out[k, first + 2] = (x - knots[i]) * high


def information(shapes: Sequence[int], columns: Floats, friction_N: float) -> Floats:
    """Return what is known before of the coefficients of some columns (n, c), (c,): of what free shapes differ by.

    A spline that few samples see, near rest, would have any coefficient: 16 times the friction, where a drive of speed
    steps went through those speeds in 24 of 9600 samples.

    Parameters
    ----------
    shapes : see `Columns`. friction_N : rms of the friction, N.
    """
    known, first = np.zeros(columns.shape[1]), 0
    for size in shapes:
        last = first + size - 1
        known[first:last] = np.mean(np.square(columns[:, last])) / (DEVIATION * friction_N) ** 2
        first += size
    return known


def low_speed(context: Context) -> float:
    """Return the share of the top speed at which the level of a free shape is stated."""
    return max(LOW_SPEED, context.slow_share)


def place_of(share: float) -> Floats:
    """Return the place of a share of the top speed, (1,)."""
    return np.array([np.arcsinh(share * BEND) / REACH])


def sliding(features: Features, reference: Reference) -> Features:
    """Return the features of a forward motion at the same speeds, none of them too slow for the level."""
    moving = reference.moving(features.velocity_m_s)
    return replace(features, velocity_m_s=moving, previous_m_s=moving)
