"""What a recording can and cannot show."""

from dataclasses import dataclass

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.intake.encoder import wraps_undone
from friction_estimator.core.intake.kinks import at_kinks
from friction_estimator.core.online.shortcomings import ONE_DIRECTION
from friction_estimator.core.quantities import POSITION, VELOCITY, quantity
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.diagnosis.pressures import pressure_order
from friction_estimator.diagnosis.record import FEWEST_BLOCKS, Record
from friction_estimator.effects.features import Context

FEWEST_REVERSALS = 4
ONE_SPEED = 1.6
"""Speeds within this factor count as one."""

SEVERAL_STROKES = 1.6
"""Cycles of two strokes to a period above which a drive of one period is no plain to and fro."""

LEAST_STANDSTILL = 0.01
"""Share of the samples above which standstill is worth a note."""

LEAST_KINKED = 0.005
"""Share of the samples above which what is left out at kinks of the velocity is worth a note."""

JITTER = 0.1
"""Robust deviation of the sample period over itself, above which it is worth a note."""


@dataclass(frozen=True)
class Excitation:
    """Facts for the report.

    Attributes
    ----------
    cycles, reversals : counted. velocity_range : m/s. channels : recorded beyond the stamps.
    warnings : in words (see `Quantities.worded`). undecidable : True where no verdict can be given.
    notes : in words, what was repaired completely or set aside: it leaves the verdict alone.
    """

    cycles: int
    velocity_range: tuple[float, float]
    reversals: int
    channels: tuple[str, ...]
    warnings: tuple[str, ...]
    undecidable: bool
    notes: tuple[str, ...] = ()


def assess(record: Record, context: Context) -> Excitation:
    """Say what the drive excites."""
    v = record.features.velocity_m_s
    moving = v[~record.standstill]
    warnings: list[str] = []
    undecidable = record.reversals < FEWEST_REVERSALS or record.blocks < FEWEST_BLOCKS
    if undecidable:
        warnings.append(
            f"{record.reversals} reversals in {record.blocks} blocks are too few to tell causes apart: record at least "
            f"{FEWEST_BLOCKS} strokes"
        )
    if metrics.one_way([moving]):
        warnings.append(ONE_DIRECTION)
    levels = speed_levels(moving, record.recording[~record.standstill])
    if levels:
        shown = " and ".join(quantity(level, VELOCITY, "+.3g") for level in levels)
        warnings.append(
            f"the shaft runs at {len(levels)} speeds only ({shown}): two speeds do not identify the curve F(v)"
            if len(levels) == 2
            else f"the shaft runs at {len(levels)} speed only ({shown}): one speed does not identify the curve F(v)"
        )
    # A trajectory with several strokes to a period covers unlike distances in unlike times.
    cycles_s = record.features.active_time_s[-1] / max(record.cycles, 1)
    if len(context.periods_s) == 1 and context.periods_s[0] < SEVERAL_STROKES * cycles_s and not levels:
        warnings.append(
            f"one drive period only ({context.periods_s[0]:.3g} s): time and distance are hard to tell apart"
        )
    order = pressure_order(record)
    if order:
        warnings.append(order)
    return Excitation(
        cycles=record.cycles,
        velocity_range=(float(v.min()), float(v.max())),
        reversals=record.reversals,
        channels=("velocity", "friction", *context.channels),
        warnings=tuple(warnings),
        undecidable=undecidable,
        notes=tuple(notes(record)),
    )


def notes(record: Record) -> list[str]:
    """Say what was repaired completely or set aside before anything is fitted."""
    said: list[str] = []
    wraps = wraps_undone(record.samples)
    if wraps.count:
        said.append(
            f"the position's encoder wrapped {wraps.count} times by {quantity(wraps.modulus_m, POSITION)}; undone"
        )
    f = record.features
    step = np.diff(f.time_s)
    broken = step[record.restart[1:] & (record.recording[1:] == record.recording[:-1])]
    if broken.size:
        said.append(
            f"{broken.size} gaps or pauses of {np.abs(broken).sum():.4g} s in all: none of it counts as running time"
        )
    inside = f.step_s[f.step_s > 0.0]
    usual = float(np.median(inside))
    jitter = 1.4826 * float(np.median(np.abs(inside - usual)))
    if jitter > JITTER * usual:
        said.append(
            f"the sample period of {usual * 1e3:.3g} ms scatters by {jitter * 1e3:.3g} ms: stamps are taken as they are"
        )
    share = float(record.standstill.mean())
    if share > LEAST_STANDSTILL:
        said.append(
            f"the shaft stands for {100.0 * share:.3g} % of the samples: their {{force}} is below breakaway "
            "and no sample of F(v)"
        )
    kinks = at_kinks(record.samples.velocity_m_s, record.samples.restart)
    if kinks.mean() > LEAST_KINKED:
        said.append(
            f"{int(kinks.sum())} samples at kinks of the velocity are left out: which of two accelerations holds there "
            "lies between two samples"
        )
    return said


def speed_levels(velocity_m_s: Floats, recording: Ints) -> list[float]:
    """Return the speeds at which a shaft runs, one or two for each direction, where it runs at constant speed.

    A direction of a recording is at constant speed where the middle 70 % of its moving samples lie within a factor of
    `ONE_SPEED`; a sine spreads over a factor of three. Empty where any direction covers a range.
    """
    found: list[float] = []
    for number in np.unique(recording):
        mine = velocity_m_s[recording == number]
        for sign in (1.0, -1.0):
            speed = sign * mine[sign * mine > 0.0]
            speed = np.abs(speed)
            if speed.size < 0.1 * mine.size:
                continue
            speed = speed[speed > 0.25 * float(np.median(speed))]
            low, high = np.quantile(speed, [0.15, 0.85])
            if high > ONE_SPEED * low:
                return []
            found.append(sign * float(np.median(speed)))
    levels: list[float] = []
    for value in sorted(found):
        if not levels or value * levels[-1] < 0.0 or abs(value - levels[-1]) > 0.6 * abs(value):
            levels.append(value)
    return levels
