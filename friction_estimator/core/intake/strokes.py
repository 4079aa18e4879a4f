"""Strokes of a drive: where it reverses, told with hysteresis so that noise about zero reverses nothing."""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Bools, Floats, Ints, Samples
from friction_estimator.core.settings.units import rest_noise, robust_top

REVERSAL_SHARE = 0.03
"""Share of the top speed that a stroke reaches on either side of a reversal. A thousandth, tried before, counts 971
reversals on a measured drive that makes ten."""

NOISE_FACTOR, LARGEST_SHARE = 4.0, 0.3
"""Standard deviations of the velocity's noise that a stroke reaches at least, and the share of the top speed that is
asked for at the most. One sample of a rest in 30,000 passes four of them by itself, so two in a row have to."""


def reversal_speed(samples: Samples) -> float:
    """Return the speed that a stroke of these samples has to reach, m/s."""
    top = robust_top([np.abs(samples.velocity_m_s)])
    return float(min(max(REVERSAL_SHARE * top, NOISE_FACTOR * rest_noise(samples)), LARGEST_SHARE * top))


@njit(cache=True)
def reaches(before, now, level):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether two samples in a row show a stroke: both are faster than `level`, one way."""
    return min(abs(before), abs(now)) > level and (before > 0.0) == (now > 0.0)


@njit(cache=True)
def _reversals(velocity, restart, level, found):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `found` with the samples that begin a stroke; return how many there are."""
    count = begin = 0
    side = sign = 0.0
    for k in range(velocity.size):
        if restart[k]:
            side = sign = 0.0
        now = np.sign(velocity[k])
        if now not in (0.0, sign):
            sign, begin = now, k
        if k and not restart[k] and reaches(velocity[k - 1], velocity[k], level):
            if side not in (0.0, now):
                found[count] = begin
                count += 1
            side = now
    return count


def reversals(velocity_m_s: Floats, restart: Bools, level_m_s: float) -> Ints:
    """Return the samples that begin a stroke, (m,): the last change of sign before velocity reaches the other side.

    A reversal within a gap is not seen and not counted, nor is one sample that reaches it alone.

    >>> v = np.array([1.0, 0.5, -0.01, -0.2, 0.01, 0.0, -0.2, -1.0, -0.5, 0.02, -1.0])
    >>> reversals(v, np.zeros(11, np.bool_), 0.1).tolist()
    [6]
    """
    found = np.empty(velocity_m_s.size, np.int64)
    return found[: _reversals(velocity_m_s, restart, level_m_s, found)].copy()
