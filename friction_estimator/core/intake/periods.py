"""Periods of a drive by autocorrelation: of stretches that repeat, on recorded time, wherever in the record they lie.

A trajectory that comes again after 22 s has that period, however often it reverses within; a record of 1 s and 5 s
cycles has both. The record is looked at as a whole, then in ever shorter stretches, until what repeats is explained.
"""

from itertools import pairwise

import numpy as np

from friction_estimator.core.sample import Bools, Floats

POINTS = 4096
"""Points of a stretch at the most; a period must hold `LEAST_POINTS` of them."""

LEAST_POINTS = 16

SHORTEST_STRETCH = 64
"""Samples of a stretch at least, and part of the record: shorter ones say nothing of the drive."""

SHRINK = 0.7
"""Length of a stretch over that of the next longer."""

FEWEST_CYCLES = 2.0
"""Cycles that a stretch holds at least: fewer repeat nothing."""

ALIKE = 0.98
"""Correlation of a stretch with itself one period later: 2 sum(v v') / sum(v^2 + v'^2)."""

AS_GOOD = 0.01
"""A shorter lag whose correlation is lower by no more than this is the period; the longer ones are its multiples."""

SAME = 0.02
"""Relative difference of periods that are one."""

LEAST_SHARE, FEWEST_IN_ALL = 1.0 / 12.0, 3.0
"""Share of the recorded time, and cycles, that a period must explain."""

MOST_PEAKS = 128
"""Lags of a stretch that are looked at."""

PARTS, ROUGHLY, LEAST_POWER = 8, 0.2, 1e-3
"""Parts of a stretch that repeat each, the relative error at which a part still does (a lag is rounded to the grid, and
noise weighs more where it is slow), and the share of the mean power below which a part only stands."""

EXPLAINED = 0.5
"""Share of a stretch that one period explains, beyond which only a shorter one is of interest: where cycles of 1 s and
5 s follow each other, the whole repeats after 5 s."""

SHORTER = 0.9
"""Ratio of two periods below which the one is shorter than the other."""

BRIDGED = 20.0
"""Gaps of up to this many sample periods are bridged: lost messages do not end a trajectory, pauses do."""

HIGHEST_HARMONIC = 40
"""Orders up to which the drive's own lines are told from others: beyond, some multiple is near to any frequency."""


def drive_periods(time_s: Floats, velocity_m_s: Floats, restart: Bools) -> tuple[float, ...]:
    """Return the periods of the drive, s, longest first; empty where nothing repeats.

    Parameters
    ----------
    time_s, velocity_m_s, restart : (n,), recorded time; pauses and other recordings begin where `restart` is True.

    >>> t = np.arange(6000) / 200
    >>> v = np.sin(2 * np.pi * t) + np.sin(2 * np.pi * t / 5.0 + 1.0)
    >>> [round(period, 2) for period in drive_periods(t, v, t == 0.0)]
    [5.0]
    """
    pieces = _pieces(time_s, restart)
    whole = sum(float(time_s[stop - 1] - time_s[start]) for start, stop in pieces)
    found: list[tuple[float, float]] = []  # period, time that it explains
    for start, stop in pieces:
        found += _piece_periods(time_s[start:stop], velocity_m_s[start:stop], whole)
    merged: list[list[float]] = []
    for period, span in sorted(found, reverse=True):
        if merged and abs(merged[-1][0] - period) < SAME * period:
            total = merged[-1][1] + span
            merged[-1] = [(merged[-1][0] * merged[-1][1] + period * span) / total, total]
        else:
            merged.append([period, span])
    return tuple(period for period, span in merged if span >= LEAST_SHARE * whole and span >= FEWEST_IN_ALL * period)


def is_harmonic(
    frequency_hz: float, periods_s: tuple[float, ...], duration_s: float, highest: int = HIGHEST_HARMONIC
) -> bool:
    """Return whether a line may be the trajectory's own: a multiple of 1 / period, to the resolution 1 / duration.

    >>> is_harmonic(2 / 22.13, (22.13,), 180.0), is_harmonic(0.11, (22.13,), 180.0), is_harmonic(50.0, (22.13,), 180.0)
    (True, False, False)
    """
    for period in periods_s:
        order = round(frequency_hz * period)
        if 1 <= order <= highest and abs(frequency_hz - order / period) <= 1.0 / duration_s:
            return True
    return False


def _pieces(time_s: Floats, restart: Bools) -> list[tuple[int, int]]:
    """Return stretches of recorded time without pauses, as (start, stop)."""
    if time_s.size < 2:
        return []
    step = np.diff(time_s)
    usual = float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0
    broken = np.flatnonzero(restart[1:] & ((step <= 0.0) | (step > BRIDGED * usual))) + 1
    edges = [0, *broken.tolist(), time_s.size]
    return [(a, b) for a, b in pairwise(edges) if b - a >= SHORTEST_STRETCH]


def _piece_periods(time_s: Floats, velocity_m_s: Floats, whole_s: float) -> list[tuple[float, float]]:
    """Return (period, time that it explains) of the stretches of one piece that repeat."""
    begin, end = float(time_s[0]), float(time_s[-1])
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (velocity_m_s[1:] + velocity_m_s[:-1]) * np.diff(time_s))])
    explained: list[tuple[float, float, float]] = []
    found = []
    length, shortest = end - begin, max(whole_s / SHORTEST_STRETCH, SHORTEST_STRETCH * (end - begin) / time_s.size)
    while length >= shortest:
        count = max(1, int(np.ceil(2.0 * (end - begin) / length)) - 1)
        for start in np.linspace(begin, end - length, count):
            stop = start + length
            overlaps = [(min(stop, b) - max(start, a), p) for a, b, p in explained]
            known = min((p for share, p in overlaps if share > EXPLAINED * length), default=np.inf)
            if length < FEWEST_CYCLES * known < np.inf:
                continue
            first, last = np.searchsorted(time_s, [start, stop])
            inside = slice(max(0, int(first) - 1), int(last) + 1)
            period = _period(time_s[inside], travelled[inside], start, stop)
            if 0.0 < period < SHORTER * known:
                explained.append((start, stop, period))
                again = max((share for share, p in overlaps if abs(p - period) < SAME * period), default=0.0)
                found.append((period, length - max(0.0, again)))
        length *= SHRINK
    return found


def _period(time_s: Floats, travelled_m: Floats, start: float, stop: float) -> float:
    """Return the period of one stretch, s, or 0; `travelled_m` is the integral of velocity."""
    grid = np.linspace(start, stop, min(POINTS, time_s.size - 1))
    if grid.size < SHORTEST_STRETCH:
        return 0.0
    v = _averaged(time_s, travelled_m, grid)
    likeness = self_likeness(v)
    low = np.flatnonzero(likeness < 0.5 * (1.0 + float(likeness.min())))
    if not low.size:
        return 0.0
    # Beyond the main lobe.
    inner = likeness[1:-1]
    peaks = 1 + np.flatnonzero((inner > likeness[:-2]) & (inner >= likeness[2:]))
    peaks = peaks[(peaks > low[0]) & (peaks >= LEAST_POINTS)]
    if not peaks.size:
        return 0.0
    # A parabola through each peak: on a coarse grid its height and place lie between the points.
    before, at, after = likeness[peaks - 1], likeness[peaks], likeness[peaks + 1]
    bend = np.minimum(before - 2.0 * at + after, -1e-12)
    shift, height = 0.5 * (before - after) / bend, at - np.square(before - after) / (8.0 * bend)
    order = [k for k in np.flatnonzero(height >= ALIKE)[:MOST_PEAKS].tolist() if _repeats_throughout(v, int(peaks[k]))]
    if not order:
        return 0.0
    good = max(float(height[k]) for k in order) - AS_GOOD
    best = next(k for k in order if height[k] >= good)
    return float((peaks[best] + shift[best]) * (grid[1] - grid[0]))


def _repeats_throughout(values: Floats, lag: int) -> bool:
    """Return whether each part of a stretch repeats after `lag`, however slow it is there.

    Cycles of 1 s at speed and of 5 s at a fifth of it have, as one, nearly all their power in the first.
    """
    change, size = np.square(values[lag:] - values[:-lag]), np.square(values[lag:]) + np.square(values[:-lag])
    least = LEAST_POWER * float(size.mean())
    for part, power in zip(np.array_split(change, PARTS), np.array_split(size, PARTS), strict=True):
        if power.mean() > least and part.mean() > ROUGHLY * power.mean():
            return False
    return True


def _averaged(time_s: Floats, travelled_m: Floats, grid: Floats) -> Floats:
    """Return velocity on an even grid, each value the mean over its step: what is faster must not fold back."""
    step = float(grid[1] - grid[0])
    edges = np.append(grid - 0.5 * step, grid[-1] + 0.5 * step)
    inside = np.clip(edges, time_s[0], time_s[-1])
    width = np.maximum(np.diff(inside), 1e-12 * step)
    return np.asarray(np.diff(np.interp(inside, time_s, travelled_m)) / width)


def self_likeness(values: Floats) -> Floats:
    """Return 2 sum(v[i] v[i+k]) / sum(v[i]^2 + v[i+k]^2) for lags k of up to half the record, (n // 2,).

    It is 1 at a lag exactly where the record repeats after it, whatever the part that overlaps (the mean is kept: a
    drive that always moves one way repeats too where its speed does).
    """
    n = values.size
    v = values - values.mean()
    spectrum = np.fft.rfft(v, 1 << int(2 * n - 1).bit_length())
    product = np.fft.irfft(np.square(np.abs(spectrum)))[: n // 2]
    energy = np.concatenate([[0.0], np.cumsum(np.square(v))])
    lag = np.arange(n // 2)
    both = energy[n - lag] + energy[n] - energy[lag]
    return np.asarray(2.0 * product / np.maximum(both, 1e-300 + 1e-12 * float(energy[-1])))
