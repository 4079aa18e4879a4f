"""In which order the recorded pressures come, and whether they are held: what a dependence on them is told by."""

import numpy as np

from friction_estimator.core.sample import Floats, Ints
from friction_estimator.diagnosis.record import LEAST_RANGE, Record, pressure_range
from friction_estimator.effects.features import Features

APART = 0.1
"""Share of the pressures' range by which two pressures differ."""

BRIEF = 0.05
"""Share of the record up to which a pressure is not one of its levels: the chamber is vented at the end."""

CELLS, MOST_CELLS, LEAST_IN_CELL = 100, 0.5, 0.002
"""Parts of the pressures' range, the share of them beyond which a record goes through all pressures and holds none, and
the share of the samples from which a part counts."""


def recorded_steps(features: Features) -> Floats:
    """Return the recorded time to the sample before, s, (n,): pauses are in it; 0 where a recording begins."""
    same = np.diff(features.recording, prepend=-1) == 0
    return np.where(same, np.diff(features.time_s, prepend=features.time_s[0]), 0.0)


def pressure_levels(record: Record) -> list[float]:
    """Return the pressures of the record in the order in which they were set, Pa; runs of one level count once.

    Where they stand apart each of them is one, though it leaks; else one begins where the last one has been left.
    """
    p = record.features.pressure_Pa
    means = np.array([float(np.median(p[record.block == b])) for b in range(record.blocks)])
    span = float(np.ptp(means))
    if span < LEAST_RANGE * max(float(np.abs(means).max()), 1.0):
        return []
    ranked = np.sort(means)
    above = ranked[1:][np.diff(ranked) > APART * span]
    if above.size:
        return _runs(means, np.searchsorted(above, means, side="right"))
    order = [float(means[0])]
    for value in means[1:]:
        if abs(value - order[-1]) > APART * span:
            order.append(float(value))
    return order


def _runs(means: Floats, level: Ints) -> list[float]:
    """Return the mean pressure of each run of blocks at one level, in their order, without the brief ones."""
    held = np.bincount(level) > BRIEF * level.size
    if np.count_nonzero(held) > 1:
        means, level = means[held[level]], level[held[level]]
    at = {one: float(np.median(means[level == one])) for one in np.unique(level)}
    return [at[one] for i, one in enumerate(level) if i == 0 or one != level[i - 1]]


def pressure_order(record: Record) -> str:
    """Return a warning where each pressure occurs once, in one order; empty where pressures come back."""
    order = pressure_levels(record)
    if len(order) < 2:
        return ""
    steps = np.sign(np.diff(order))
    if len(set(steps.tolist())) > 1:
        return ""
    return (
        "each pressure occurs once, in one order: pressure cannot be told from drift or a step in time; "
        "randomise the order and come back to the first"
    )


def pressures_held(record: Record) -> bool:
    """Return whether pressures are held, so that something may go on at one of them; a ramp holds none."""
    pressure_Pa = record.features.pressure_Pa
    samples, _ = np.histogram(pressure_Pa, CELLS, pressure_range(pressure_Pa))
    return int(np.count_nonzero(samples > LEAST_IN_CELL * pressure_Pa.size)) <= MOST_CELLS * CELLS
