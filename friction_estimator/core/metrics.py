"""Figures of merit, the same everywhere."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from friction_estimator.core.sample import Bools, Floats

LEAST_CYCLES = 3
"""Fewer drive cycles than this are not reported as cycles."""

ONE_WAY = 0.98
"""Share of the samples in motion that go one way, from which the other direction counts as never met."""

ROUNDING = 1e-13
"""A standard deviation below this share of the largest value is what rounding leaves of a constant."""


def spread(values: Floats) -> float:
    """Return the standard deviation, exactly 0 for a constant and for fewer than two values.

    >>> spread(np.full(1000, 3.3)), float(np.std(np.full(1000, 3.3))) > 0.0
    (0.0, True)
    """
    if values.size < 2:
        return 0.0
    deviation = float(np.std(values))
    return deviation if deviation > ROUNDING * float(np.max(np.abs(values))) else 0.0


def nrmse(measured: Floats, predicted: Floats) -> float:
    """Return rms(measured - predicted) / std(measured); NaN below two samples or where the signal is constant.

    >>> nrmse(np.array([0.0, 2.0]), np.array([1.0, 1.0]))
    1.0
    """
    scale = spread(measured)
    return float(np.sqrt(np.mean(np.square((measured - predicted) / scale)))) if scale > 0.0 else float("nan")


def nrmse_persistence(measured: Floats, restart: Bools) -> float:
    """Return the nrmse of the guess f[k-1]; samples after a restart have no predecessor and are left out."""
    follows = ~restart[1:]
    error = np.diff(measured)[follows]
    scale = spread(measured[1:][follows])
    return float(np.sqrt(np.mean(np.square(error / scale)))) if scale > 0.0 else float("nan")


def white_noise(force_N: Floats, restart: Bools) -> float:
    """Return the rms of what is white in a measured force, N: no prediction made before the measurement is better.

    Of third differences inside gap-free pieces, e = (f[k] - 3 f[k-1] + 3 f[k-2] - f[k-3]) / sqrt(20): a motion that is
    smooth over four samples vanishes in them (Gasser, Sroka, Jennen-Steinmetz 1986). Their median counts, so that
    reversals, where friction jumps, do not. NaN below 100 of them.
    """
    if force_N.size < 4:
        return float("nan")
    whole = ~(restart[1:-2] | restart[2:-1] | restart[3:])
    third = np.abs(np.diff(force_N, 3)[whole])
    return float(np.median(third) / (0.6745 * np.sqrt(20.0))) if third.size >= 100 else float("nan")


def one_way(moving_m_s: Floats) -> int:
    """Return the direction, 1 or -1, that a shaft in motion keeps; 0 where it goes both ways, and without a sample.

    >>> one_way(np.array([0.1, 0.2])), one_way(np.array([-0.1, -0.2])), one_way(np.array([-0.1, 0.2]))
    (1, -1, 0)
    """
    forward, backward = np.count_nonzero(moving_m_s > 0.0), np.count_nonzero(moving_m_s < 0.0)
    if not moving_m_s.size or min(forward, backward) >= (1.0 - ONE_WAY) * moving_m_s.size:
        return 0
    return 1 if forward > backward else -1


def drive_cycles(velocity_m_s: Floats) -> list[slice]:
    """Split a record into drive cycles at the upward zero crossings of velocity.

    A crossing counts once the velocity has left a band of a quarter of its rms on both sides, so that noise at
    standstill makes no cycles. The pieces before the first and after the last crossing are left out.

    Returns an empty list where fewer than `LEAST_CYCLES` cycles are found or their lengths spread by more than 50 %
    (a drive that is not periodic).

    >>> t = np.arange(5000) / 1000
    >>> [c.stop - c.start for c in drive_cycles(np.sin(2 * np.pi * t - 1.0))]
    [1000, 1000, 1000, 1000]
    """
    band = 0.25 * float(np.sqrt(np.mean(np.square(velocity_m_s)))) if velocity_m_s.size else 0.0
    if not band > 0.0:
        return []
    side = np.sign(velocity_m_s) * (np.abs(velocity_m_s) > band)
    known = np.flatnonzero(side)
    rises = np.flatnonzero((side[known][:-1] < 0) & (side[known][1:] > 0))
    starts = []
    for rise in rises:
        first, last = known[rise], known[rise + 1]
        starts.append(int(first + 1 + np.argmax(velocity_m_s[first + 1 : last + 1] >= 0.0)))
    lengths = np.diff(starts)
    if lengths.size < LEAST_CYCLES or np.std(lengths) > 0.5 * np.mean(lengths):
        return []
    return [slice(a, b) for a, b in pairwise(starts)]


def cycles_or_tenths(velocity_m_s: Floats, starts: Sequence[int] = (0,)) -> list[slice]:
    """Return the drive cycles of each recording in turn; of one without, its tenths.

    Parameters
    ----------
    velocity_m_s : (n,). starts : where a recording begins; cycles are sought in each on its own, in this order.
    """
    out = []
    for first, end in pairwise([*starts, velocity_m_s.size]):
        parts = drive_cycles(velocity_m_s[first:end])
        if not parts:
            edges = np.linspace(0, end - first, 11).astype(int)
            parts = [slice(a, b) for a, b in pairwise(edges) if b > a]
        out += [slice(first + part.start, first + part.stop) for part in parts]
    return out


def by_cycle(measured: Floats, predicted: Floats, velocity_m_s: Floats, starts: Sequence[int] = (0,)) -> list[float]:
    """Return the error rms of each drive cycle over the std of the whole record (tenths where there is no cycle).

    Parameters
    ----------
    measured, predicted, velocity_m_s : (n,), N and m/s. starts : see `cycles_or_tenths`.
    """
    scale = spread(measured)
    if not scale > 0.0:
        return []
    error = (measured - predicted) / scale
    return [float(np.sqrt(np.mean(np.square(error[part])))) for part in cycles_or_tenths(velocity_m_s, starts)]


def settled(restart: Bools, memory: int) -> Bools:
    """Return where a model's delay lines hold measured samples only, (n,).

    A restart fills them with the row of its own sample: there, and at the samples that follow until `memory` rows have
    come, what the model predicts is right for a motion that did not change before.

    >>> settled(np.array([True, False, False, True, False, False]), 2).tolist()
    [False, False, True, False, False, True]
    """
    place = np.arange(restart.size)
    last = np.maximum.accumulate(np.where(restart, place, -memory))
    return np.asarray(place - last >= memory, np.bool_)
