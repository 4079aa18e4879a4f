"""The derivative of a recorded channel, zero-phase: what `d()` of `import` means.

Each sample takes the slope of the cubic that fits its neighbours on both sides best (Savitzky and Golay 1964), and so
many neighbours as the motion allows there: of half-widths that grow by about a half, the widest one whose slope lies
within the error bands of all narrower ones (Lepski 1991), `STEPS_BACK` steps narrower, as `tracking` does with the past
alone. Noise and counts are those of the whole stretch.
"""

from collections import deque
from itertools import pairwise

import numpy as np

from friction_estimator.core.intake.encoder import LARGEST_POSITION, Encoder
from friction_estimator.core.intake.tracking import BAND, GAP_PERIODS, LEAST_COUNT, Tracker
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints

HALF_WIDTHS = (2, 3, 4, 6, 9, 13, 19, 28, 42, 63, 94, 141, 211, 316, 474, 711, 1066, 1600)
"""Neighbours on either side, fewest first."""

STEPS_BACK = 3
"""Half-widths by which the choice stays below the widest one that agrees, unless all do."""

FEWEST = 3
"""Samples of a stretch from which a slope is told."""

DEGREE = 3

EVEN_WITHIN = 0.1
"""Share of a period by which samples may miss an even grid and count as even."""

MOST_GROWTH = 10
"""Times as many samples as there are that an even grid may have."""


def kernel(half_width: int) -> Floats:
    """Return the weights of 2 m + 1 neighbours whose sum is the slope a sample, of the least-squares cubic.

    >>> (12.0 * kernel(2) + 1e-9).round(6).tolist()  # the five-point rule
    [1.0, -8.0, 0.0, 8.0, -1.0]
    """
    k = np.arange(-half_width, half_width + 1, dtype=np.float64) / half_width
    powers = np.vander(k, DEGREE + 1, increasing=True)
    return np.asarray(np.linalg.pinv(powers)[1] / half_width)


def scale_of(x: Floats) -> tuple[float, float]:
    """Return the standard deviation of a channel's noise and its count, from differences of even samples, (n,).

    Third differences of a smooth motion hold only noise, of twenty times its power; the least second difference that is
    no rounding is a count, or a small part of the noise.
    """
    if x.size < 4:
        return 0.0, 0.0
    third = np.abs(np.diff(x, 3)) / np.sqrt(20.0)
    second = np.abs(np.diff(x, 2))
    counts = second[second > LEAST_COUNT * third.max()]
    count = float(counts.min()) if counts.size else 0.0
    return max(float(np.median(third)) / 0.6745, count / np.sqrt(12.0)), count


def derivative(stamp_ns: Ints, values: Floats, begins: Bools) -> Floats:
    """Return the derivative of a channel by time, (n,), in its unit a second.

    Parameters
    ----------
    stamp_ns : (n,), rising within a stretch.
    values : (n,), NaN where nothing was measured: the derivative is NaN there, and its neighbours do without it. Wraps
        of an encoder are undone first.
    begins : where a stretch begins; a gap of more than `GAP_PERIODS` sample periods begins one too. None sees another.
    """
    out = np.full(values.size, np.nan)
    known = np.flatnonzero(np.abs(values) <= LARGEST_POSITION)
    if known.size < FEWEST:
        return out
    stamps, x = stamp_ns[known], values[known].astype(np.float64)
    piece = np.cumsum(begins)[known]
    step = np.diff(stamps)
    inside = (np.diff(piece) == 0) & (step > 0)
    period = float(np.median(step[inside])) if inside.any() else 0.0
    fresh = np.concatenate([[True], ~inside | (step > GAP_PERIODS * period)])
    velocity = np.nan_to_num(Tracker().push(stamps, x))
    Encoder().push(stamps, velocity, fresh, x)
    edges = [*np.flatnonzero(fresh).tolist(), known.size]
    for begin, end in pairwise(edges):
        if end - begin >= FEWEST:
            time_s = (stamps[begin:end] - stamps[begin]) / NS_PER_S
            out[known[begin:end]] = _slope(time_s, x[begin:end])
    return out


def _slope(time_s: Floats, x: Floats) -> Floats:
    """Return the slope of one stretch, (n,): on an even grid of its own period where its samples are not even."""
    period = float(np.median(np.diff(time_s)))
    scale = scale_of(x)
    even = period * np.arange(x.size)
    if np.abs(time_s - even).max() < EVEN_WITHIN * period:
        return even_slope(x, *scale) / period
    even = period * np.arange(round(float(time_s[-1]) / period) + 1)
    if even.size > MOST_GROWTH * x.size:  # stamps in bursts: a grid of their median step would be far too fine
        return np.gradient(x, time_s)
    slope = even_slope(np.interp(even, time_s, x), *scale) / period
    return np.interp(time_s, even, slope)


def even_slope(x: Floats, noise: float, count: float) -> Floats:
    """Return the slope a sample of even samples, (n,), of this noise and count (see `scale_of`)."""
    widths = [m for m in HALF_WIDTHS if m < x.size]
    if not widths:
        return np.asarray(np.gradient(x))
    low, high = np.full(x.size, -np.inf), np.full(x.size, np.inf)
    agrees = np.ones(x.size, np.bool_)
    recent: deque[Floats] = deque(maxlen=STEPS_BACK + 1)
    out = np.empty(x.size)
    for m in widths:
        weights = kernel(m)
        # The stretch goes on beyond its ends turned by half a turn about them: position and slope stay as they are.
        ends = np.concatenate([2.0 * x[0] - x[m:0:-1], x, 2.0 * x[-1] - x[-2 : -m - 2 : -1]])
        recent.append(_correlated(ends, weights))
        band = max(BAND * noise * float(np.sqrt(weights @ weights)), count * float(np.abs(np.cumsum(weights)).max()))
        np.maximum(low, recent[-1] - band, out=low)
        np.minimum(high, recent[-1] + band, out=high)
        agrees &= low <= high
        out[agrees] = recent[0][agrees]
    out[agrees] = recent[-1][agrees]
    return out


def _correlated(ends: Floats, weights: Floats) -> Floats:
    if weights.size < 64:
        return np.asarray(np.correlate(ends, weights, "valid"))
    from scipy.signal import fftconvolve  # noqa: PLC0415 - slow to import, needed for long windows only

    middle = ends[ends.size // 2]  # whatever the origin, rounding stays that of the stroke
    return np.asarray(fftconvolve(ends - middle, weights[::-1], "valid"))
