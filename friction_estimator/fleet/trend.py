"""What a rig's recordings show one after the other: since when, and how it grows.

A parameter grows by the slope of a straight line through its values, weighted by their intervals. Where the values
scatter more than their intervals say, the slope's interval is widened by the ratio (Birge, Phys. Rev. 40 (1932) 207):
what differs from recording to recording beside time is then part of the noise.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.sample import NS_PER_S

NORMAL_95 = 1.959963984540054

FEWEST = 3
"""Recordings that a slope is told of: through two, any line goes."""

DAY_S, HOUR_S = 86_400.0, 3_600.0
DAY, HOUR, RECORDING = "day", "hour", "recording"

UNDECIDABLE = "undecidable"


@dataclass(frozen=True)
class Entry:
    """A recording that was diagnosed: its rig, its name, and the row (`diagnosed.row_of`)."""

    rig: str
    bag: str
    row: Mapping[str, Any]


def date(row: Mapping[str, Any], form: str = "%Y-%m-%d %H:%M") -> str | None:
    """Return when a recording began, UTC; None where its clock does not say."""
    start = row["start_ns"]
    return None if start is None else datetime.fromtimestamp(start // NS_PER_S, UTC).strftime(form)


@dataclass(frozen=True)
class Growth:
    """Change of a parameter with its 95 % interval, per `DAY`, `HOUR` or `RECORDING`; told where the interval has one
    sign."""

    value: float
    low: float
    high: float
    per: str

    @property
    def told(self) -> bool:
        """Whether it grows, or shrinks, beyond noise."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True)
class Course:
    """A parameter over the recordings that show the effect: unit, first and last value, growth where it is known."""

    name: str
    unit: str
    first: float
    last: float
    growth: Growth | None


@dataclass(frozen=True)
class Trend:
    """An effect, or a fault of the data, over the recordings of a rig.

    Attributes
    ----------
    name, what : its id, and what it is in words. recordings, of : how many show it, of how many that could be decided.
    since : the first that shows it. before : the last one before it, which does not; None where it is the first.
    gain_percent : median of what naming it takes off the held-out error; None where there is none.
    """

    rig: str
    name: str
    what: str
    recordings: int
    of: int
    since: Entry
    before: Entry | None
    gain_percent: float | None
    courses: tuple[Course, ...]


def trends(entries: Sequence[Entry]) -> list[Trend]:
    """Return the trends of all rigs: by rig, then what most recordings show.

    Parameters
    ----------
    entries : in the order in which the recordings were given; those of a rig are put in order of time where all have
        a date.
    """
    out = []
    for rig in dict.fromkeys(entry.rig for entry in entries):
        own = in_order([entry for entry in entries if entry.rig == rig and entry.row["verdict"] != UNDECIDABLE])
        names = list(dict.fromkeys(found["name"] for entry in own for found in findings(entry.row)))
        rows = [_trend(rig, name, own) for name in names]
        out += sorted(rows, key=lambda trend: (-trend.recordings, trend.name))
    return out


def in_order(entries: Sequence[Entry]) -> list[Entry]:
    """Return recordings in order of time, as given where one has no date."""
    if any(entry.row["start_ns"] is None for entry in entries):
        return list(entries)
    return sorted(entries, key=lambda entry: int(entry.row["start_ns"]))


def findings(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return effects and faults of a row."""
    return [*row["effects"], *row["faults"]]


def _trend(rig: str, name: str, entries: Sequence[Entry]) -> Trend:
    places = [k for k, entry in enumerate(entries) if any(one["name"] == name for one in findings(entry.row))]
    shown = [next(one for one in findings(entries[k].row) if one["name"] == name) for k in places]
    gains = [one["gain"]["reduction_percent"] for one in shown if one.get("gain")]
    time, per = _times([entries[k] for k in places], places)
    parameters = list(dict.fromkeys(key for one in shown for key in one["parameters"]))
    return Trend(
        rig=rig,
        name=name,
        what=str(shown[0]["what"]),
        recordings=len(places),
        of=len(entries),
        since=entries[places[0]],
        before=entries[places[0] - 1] if places[0] else None,
        gain_percent=float(np.median(gains)) if gains else None,
        courses=tuple(_course(key, [one["parameters"].get(key) for one in shown], time, per) for key in parameters),
    )


def _times(entries: Sequence[Entry], places: Sequence[int]) -> tuple[list[float], str]:
    """Return when recordings were made, and in what that counts."""
    starts = [entry.row["start_ns"] for entry in entries]
    if any(start is None for start in starts) or len(set(starts)) < len(starts):
        return [float(place) for place in places], RECORDING
    seconds = [(start - starts[0]) / 1e9 for start in starts]
    unit, per = (DAY_S, DAY) if seconds[-1] >= 2.0 * DAY_S else (HOUR_S, HOUR)
    return [value / unit for value in seconds], per


def _course(name: str, values: Sequence[Mapping[str, Any] | None], time: Sequence[float], per: str) -> Course:
    known = [(t, one) for t, one in zip(time, values, strict=True) if one is not None and one["value"] is not None]
    at = np.array([t for t, _ in known])
    value = np.array([one["value"] for _, one in known], np.float64)
    ends = [[math.nan if end is None else end for end in one["ci95"]] for _, one in known]
    error = np.array([(high - low) / (2.0 * NORMAL_95) for low, high in ends])
    return Course(
        name=name,
        unit=next((one["unit"] for _, one in known), ""),
        first=float(value[0]) if value.size else math.nan,
        last=float(value[-1]) if value.size else math.nan,
        growth=_growth(at, value, error, per),
    )


def _growth(time: Any, value: Any, error: Any, per: str) -> Growth | None:
    """Return the slope of value over time; arrays (n,), `error` standard errors, equal weights where one is none."""
    if value.size < FEWEST or not np.ptp(time) > 0.0:
        return None
    is_weighed = bool(np.all(np.isfinite(error) & (error > 0.0)))
    weight = 1.0 / np.square(error) if is_weighed else np.ones(value.size)
    centre = float((weight * time).sum() / weight.sum())
    power = float((weight * np.square(time - centre)).sum())
    slope = float((weight * (time - centre) * value).sum() / power)
    left = value - float((weight * value).sum() / weight.sum()) - slope * (time - centre)
    scatter = float((weight * np.square(left)).sum() / (value.size - 2))
    reach = float(scipy.special.stdtrit(value.size - 2, 0.975)) * math.sqrt(
        (max(1.0, scatter) if is_weighed else scatter) / power
    )
    return Growth(slope, slope - reach, slope + reach, per)
