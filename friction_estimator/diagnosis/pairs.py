"""Pairs of samples that a deterministic system would make equal: what differs between them does not repeat."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from friction_estimator.core.sample import Ints
from friction_estimator.effects.compose import rms
from friction_estimator.effects.features import stroke_ends

if TYPE_CHECKING:  # a record has its pairs
    from friction_estimator.diagnosis.record import Record

SAME_PERIOD = 0.01
SAME_PRESSURE = 0.03
APART_S = 0.5

LEAST_PAIRED = 0.4
"""Share of the samples that must find a partner in another cycle."""

SAME_SPEED = 0.05
"""Share of the rms speed by which the speeds of two samples one period apart may differ."""

SAME_MOTION, SAME_PLACE = 0.3, 0.1
"""Share of a cycle's rms speed, and of the stroke, by which the next cycle's speed (rms) and place (median) may differ:
a noisy velocity and a drift of its integral are within that."""

FAR_APART = 1e3
"""Distance of two recordings, in standard deviations of what else tells neighbours."""


def paired(record: Record) -> tuple[Ints, Ints]:
    """Return pairs of samples that a deterministic system would make equal, (m,), (m,).

    With a periodic drive: the same phase of neighbouring cycles of equal length and pressure. Otherwise: nearest
    neighbours in velocity, acceleration, position and pressure, at least half a second apart.
    """
    for found in (_cycle_pairs, _period_pairs):
        first, second = found(record)
        if first.size > LEAST_PAIRED * record.used.size:
            return first, second
    return _neighbours(record)


def _cycle_pairs(record: Record) -> tuple[Ints, Ints]:
    """Return each sample with that of its phase in the next cycle of two strokes, where that is the same motion.

    Of a trajectory with many strokes two neighbouring cycles may happen to take as long and be others altogether.
    """
    turns = record.turns
    time, pressure = record.features.time_s, record.features.pressure_Pa
    a: list[Ints] = []
    b: list[Ints] = []
    v, x = record.features.velocity_m_s, record.features.position_m
    low, high = stroke_ends(x, record.recording)

    def crossing(k: int) -> float:
        if k == 0 or v[k] == v[k - 1]:
            return float(time[k])
        return float(time[k] - v[k] * (time[k] - time[k - 1]) / (v[k] - v[k - 1]))

    for start, middle, stop in zip(turns[:-4:2], turns[2:-2:2], turns[4::2], strict=False):
        one, other = crossing(middle) - crossing(start), crossing(stop) - crossing(middle)
        level = pressure[middle]
        if abs(one - other) > SAME_PERIOD * one or record.restart[start:stop].any():
            continue
        if np.ptp(pressure[start:stop]) > SAME_PRESSURE * max(abs(level), 1.0):
            continue
        here = np.arange(start, middle)
        wanted = time[here] + one
        after: Ints = np.asarray(np.searchsorted(time, wanted), np.int64)
        early = np.abs(np.take(time, after - 1, mode="clip") - wanted)
        late = np.abs(np.take(time, after, mode="clip") - wanted)
        there = after - (early < late).astype(np.int64)
        keep = there < time.size
        here, there = here[keep], there[keep]
        if not here.size or rms(v[there] - v[here]) > SAME_MOTION * rms(v[here]):
            continue
        if float(np.median(np.abs(x[there] - x[here]))) > SAME_PLACE * (high - low):
            continue
        a.append(here)
        b.append(there)
    if not a:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return np.concatenate(a), np.concatenate(b)


def _period_pairs(record: Record) -> tuple[Ints, Ints]:
    """Return each sample with the one a period later, where velocity and pressure have come again.

    For trajectories with several strokes to a period, whose neighbouring cycles of two strokes are not alike.
    """
    f = record.features
    time, v, pressure, number = f.time_s, f.velocity_m_s, f.pressure_Pa, record.recording
    same_speed = SAME_SPEED * float(np.sqrt(np.mean(np.square(v))))
    here = np.arange(time.size)
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    left = np.ones(time.size, np.bool_)
    for period in sorted(record.periods_s):
        wanted = time + period
        after = np.clip(np.searchsorted(time, wanted), 1, time.size - 1)
        there = after - (wanted - time[after - 1] < time[after] - wanted)
        reach = np.maximum(f.step_s, f.step_s[there])
        again = left & (np.abs(time[there] - wanted) <= reach) & (number[there] == number)
        again &= np.abs(v[there] - v) < same_speed
        again &= np.abs(pressure[there] - pressure) <= SAME_PRESSURE * np.maximum(np.abs(pressure), 1.0)
        first.append(here[again])
        second.append(there[again])
        left &= ~again
    return np.concatenate(first), np.concatenate(second)


def _neighbours(record: Record) -> tuple[Ints, Ints]:
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and `info` needs records without their pairs

    f = record.features
    place = [f.velocity_m_s, f.acceleration_m_s2, f.position_m, f.pressure_Pa, np.sign(f.velocity_m_s)]
    # Positions of recordings with origins of their own are not comparable: neighbours are of one recording.
    points = np.column_stack([*(p / (np.std(p) or 1.0) for p in place), FAR_APART * record.recording])
    chosen = np.flatnonzero(record.used)
    chosen = chosen[:: max(1, chosen.size // 20000)]
    found: Ints = np.asarray(cKDTree(points[chosen]).query(points[chosen], k=12)[1], np.int64)
    apart = np.abs(f.time_s[chosen][found] - f.time_s[chosen][:, None]) > APART_S
    some = apart.any(axis=1)
    nearest: Ints = np.asarray(np.take_along_axis(found, np.argmax(apart, axis=1)[:, None], axis=1)[:, 0], np.int64)
    return chosen[some], chosen[nearest[some]]
