"""Search spaces in units of the record, and what lies beyond it: alike from 1e-3 to 1 m/s and from 100 Hz to 5 kHz."""

from collections.abc import Iterable

import numpy as np

from friction_estimator.core.quantities import POSITION, quantity
from friction_estimator.core.sample import Floats
from friction_estimator.effects.features import Context
from friction_estimator.effects.kernels import RING

FINEST_TIME, SHORTEST_TIME = 0.02, 0.01
"""Sample periods: the shortest time in a grid, and the shortest that may be named. Half a percent of a sample moves the
force by less than a ten-thousandth of its change in it."""

LONGEST_SHARE = 0.25
"""Of the shortest drive period: a delay by more is a delay of the drive as well."""

WITHOUT_PERIOD = 100.0
"""Sample periods that stand for a quarter of the period where the drive has none."""

FINEST_LENGTH = 0.4
"""Of the distance moved between a reversal and the first sample: a shorter one is over before it is seen."""

SMALLEST_LENGTH = 1e-6
"""Of the stroke: finer than any position sensor divides it."""

LONGEST_LENGTH, BEYOND_LENGTH = 0.04, 0.25
"""Of the stroke: the longest distance after a reversal in a grid, and the longest that may be named."""

FEWEST_POINTS = 6

RELAXED = 0.2
"""Of the record: a relaxation must go through several of its times to be told from a spring."""

REFINED = 2.5
"""Times a value of a grid, up and down, within which it is refined: the ranges of neighbours overlap."""

STRAIGHT = 2.0
"""Times the record: an exponential that is longer is a straight line, and so is this one."""


def chosen(values: Iterable[float], name: str) -> list[dict[str, float]]:
    """Return a one-parameter grid.

    >>> chosen([1, 2], "delay")
    [{'delay': 1.0}, {'delay': 2.0}]
    """
    return [{name: float(value)} for value in values]


def geometric(low: float, high: float, ratio: float = 2.0) -> Floats:
    """Return points from `low` to `high`, a factor of at most `ratio` apart.

    >>> geometric(1.0, 8.0).tolist()
    [1.0, 2.0, 4.0, 8.0]
    """
    return np.geomspace(low, high, 1 + max(1, int(np.ceil(np.log(high / low) / np.log(ratio) - 1e-9))))


def longest_time_s(context: Context) -> float:
    """Return the longest delay or time constant that the drive can show, s."""
    return LONGEST_SHARE * min(context.periods_s) if context.periods_s else WITHOUT_PERIOD * context.step_s


def times(context: Context) -> Floats:
    """Return delays and time constants, s: from 0.02 samples to a quarter of the shortest period."""
    low = FINEST_TIME * context.step_s
    longest = min(longest_time_s(context), (RING - 2) * context.step_s)
    return geometric(low, max(longest, 2.0**FEWEST_POINTS * low))


def beyond_time(what: str, value_s: float, context: Context) -> str | None:
    """Return why a delay or time constant cannot be told from this record, or None."""
    if value_s < SHORTEST_TIME * context.step_s:
        return f"its {what} of {value_s:.3g} s is below a hundredth of the sample period"
    longest = max(longest_time_s(context), 2.0**FEWEST_POINTS * FINEST_TIME * context.step_s)
    if value_s > longest * (1.0 + 1e-6):
        return f"its {what} of {value_s:.3g} s is longer than a quarter of the shortest drive period"
    return None


def first_distance_m(context: Context, speed_m_s: float | None = None) -> float:
    """Return the distance between a reversal and the sample after it, m, in a drive of this top speed (the record's).

    A sine of this stroke and top speed has the acceleration 2 v^2 / stroke at its ends, and half of that times the
    squared sample period is (v dt)^2 / stroke.
    """
    speed = context.top_speed_m_s if speed_m_s is None else speed_m_s
    return float(np.square(speed * context.step_s) / max(context.stroke_m, 1e-300))


def lengths(context: Context, ratio: float = 2.0) -> Floats:
    """Return distances after a reversal, m; empty where the shaft does not move.

    The shortest is one that the slowest drive shows: a sine of the longest period has the top speed pi stroke / period.
    """
    if context.stroke_m <= 0.0:
        return np.zeros(0)
    high = LONGEST_LENGTH * context.stroke_m
    slowest = min([context.top_speed_m_s, *(np.pi * context.stroke_m / period for period in context.periods_s)])
    low = max(FINEST_LENGTH * first_distance_m(context, slowest), SMALLEST_LENGTH * context.stroke_m)
    return geometric(min(low, high / 2.0**FEWEST_POINTS), high, ratio)


def beyond_length(what: str, value_m: float, context: Context) -> str | None:
    """Return why a distance after a reversal cannot be told from this record, or None.

    Where the channel of the velocity is noisy, nobody knows what it moved in a sample to better than that noise.
    """
    told = f"its {what} of {quantity(value_m, POSITION, '.3g')}"
    if value_m < context.blurred_m:
        return f"{told} is shorter than what the noise of the velocity moves in a sample"
    if value_m > BEYOND_LENGTH * context.stroke_m:
        return f"{told} is longer than a quarter of the stroke"
    return None


def about(value: float) -> tuple[float, float]:
    """Return the range about a value of a grid in which it is sought."""
    return value / REFINED, value * REFINED


def below(value: float, most: float) -> tuple[float, float]:
    """Return the range about a value in which it is sought: up to `most`, but never to less than half of the value."""
    low, high = about(value)
    return low, max(min(high, most), value / 2.0)


def longest_piece_s(context: Context) -> float:
    """Return the longest time without a gap, s; the whole record where the context does not know it."""
    return context.longest_piece_s or context.duration_s


def longest_relaxation_s(context: Context) -> float:
    """Return the longest relaxation time that the record can show, s."""
    return min(RELAXED * context.duration_s, longest_piece_s(context))
