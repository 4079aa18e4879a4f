"""Tables to samples: which column is what, which rows count, and where time breaks.

Rows are taken in the order of the file. A new piece of the recording starts where the segment column changes, and
where time steps back by more than ten sample periods. A piece starts at least twenty sample periods after the end of
the one before, and at least one second after it where time restarts; where its own time is earlier, it and all that
follow are shifted later. So every boundary is a gap for the estimator, which restarts its delay lines there. Inside a
piece, a row with the time of an earlier row (duplicate) or a slightly earlier time (backward) is left out. Rows
without time, velocity or friction are left out as missing samples, and so are rows where one of them is infinite or
larger than any sensor reads, as the arithmetic of the map may make them.

Stamps are the table's own time; where that begins before 1 s, it is shifted to begin at 1 s, because a stamp of zero
means "no stamp" in ROS.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from friction_estimator.bag.columns import TableFile
from friction_estimator.bag.messages import INPUTS
from friction_estimator.bag.resample import resampled
from friction_estimator.bag.table_files import open_table
from friction_estimator.bag.table_map import LATEST_S, MappedRows, TableSpec, continuous, pieces
from friction_estimator.bag.topics import REQUIRED
from friction_estimator.core.errors import InputError, UnanswerableError, about
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.quantities import LINEAR, ROTARY, Quantities
from friction_estimator.core.sample import NS_PER_S, Samples

FIRST_STAMP_S = 1.0

FASTEST = {LINEAR: 20.0, ROTARY: 5000.0}
"""Speeds beyond which the unit is doubted, m/s and rad/s."""

_LONGEST = float(np.finfo(np.float64).max)
"""Time cells beyond it are infinite; how far a finite one may go, a stamp decides."""


@dataclass(frozen=True)
class TableReport:
    """What was found in a table.

    Attributes
    ----------
    rows, selected : in the file; matching `where`.
    missing : rows left out, by the input (or "time") whose cell is empty; a row counts once, for the first.
    infinite : rows left out, by the input (or "time") whose cell is infinite or beyond `LARGEST_VALUE`.
    not_held : empty or infinite cells of held channels, whose last value stays.
    duplicate, backward : rows left out for their time.
    pieces : pieces, one more than the gaps made.
    shift_s : by how much the first stamp is later than the table's time, s.
    motion : linear or rotary, by the units of velocity, friction and position; linear where they say nothing.
    units : unit by column, where the column's own name says it.
    """

    rows: int
    selected: int
    missing: Mapping[str, int]
    infinite: Mapping[str, int]
    not_held: Mapping[str, int]
    duplicate: int
    backward: int
    pieces: int
    shift_s: float
    motion: str = LINEAR
    units: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def read_table(path: str | PathLike[str], spec: TableSpec) -> tuple[Samples, TableReport]:
    """Read samples from a CSV, .mat, .npz or .parquet table.

    Raises
    ------
    InputError for an unreadable file, an unknown column, a cell that is no number;
    UnanswerableError where no usable row is left.
    """
    source = Path(path)
    with about(source), open_table(source) as table:
        return _samples(table, spec)


def _samples(table: TableFile, spec: TableSpec) -> tuple[Samples, TableReport]:
    read = MappedRows.of(table, spec)
    label = read.label
    values, motion = read.values()
    complete = np.ones(label.size, np.bool_)
    missing: dict[str, int] = {}
    infinite: dict[str, int] = {}
    for name, given in values.items():
        beyond = np.abs(given) > (_LONGEST if name == "time" else LARGEST_VALUE)
        values[name] = np.where(beyond, np.nan, given)
        if name in ("time", *REQUIRED):
            for counts, lost in ((infinite, complete & beyond), (missing, complete & np.isnan(given))):
                if lost.any():
                    counts[name] = int(np.count_nonzero(lost))
                complete &= ~lost
    if not complete.any():
        told = [f"{count} without {name}" for name, count in missing.items()]
        told += [f"{count} with infinite {name}" for name, count in infinite.items()]
        raise UnanswerableError(f"no usable row: {', '.join(told) or 'the table is empty'}")
    earliest, latest_s = float(np.nanmin(values["time"])), float(np.nanmax(values["time"]))
    if latest_s - min(earliest, 0.0) >= LATEST_S:
        raise _too_long(spec, earliest, latest_s)

    # Pieces are found on all rows that have a time: a boundary may fall on a row that is left out. Gaps are made
    # between rows that are kept, or a stretch of pieces without one would grow by a gap for each.
    timed = ~np.isnan(values["time"])
    piece = pieces(values["time"][timed], label[timed])[complete[timed]]
    time_s = continuous(values["time"][complete], piece)
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(time_s)[:-1]])
    later, repeated = time_s > latest, time_s == latest
    shift_s = max(0.0, FIRST_STAMP_S - float(time_s[0]))
    if not time_s[-1] + shift_s < LATEST_S:
        raise _too_long(spec, float(time_s[0]), float(time_s[-1]))
    kept = {name: value[complete][later] for name, value in values.items()}
    piece = piece[later]
    samples = Samples(
        stamp_ns=np.rint((time_s[later] + shift_s) * NS_PER_S).astype(np.int64),
        velocity_m_s=kept["velocity"],
        friction_N=kept["friction"],
        restart=np.diff(piece, prepend=piece[0] - 1) != 0,
        pressure_Pa=kept.get("pressure"),
        temperature_degC=kept.get("temperature"),
        position_m=kept.get("position"),
    )
    not_held = {name: int(np.count_nonzero(np.isnan(kept[name]))) for name in INPUTS[2:] if name in kept}
    if spec.rate_hz:
        samples = resampled(samples, spec.rate_hz)
    report = TableReport(
        rows=read.rows,
        selected=label.size,
        missing=missing,
        infinite=infinite,
        not_held={name: count for name, count in not_held.items() if count},
        duplicate=int(np.count_nonzero(repeated)),
        backward=int(np.count_nonzero(~later & ~repeated)),
        pieces=int(np.count_nonzero(samples.restart)),
        shift_s=shift_s,
        motion=motion or LINEAR,
        units=read.units,
        warnings=tuple(_doubts(samples, motion or LINEAR)),
    )
    return samples, report


def _too_long(spec: TableSpec, earliest_s: float, latest_s: float) -> InputError:
    return InputError(
        f"--time {spec.time} runs from {earliest_s:.6g} to {latest_s:.6g} s, beyond what a stamp can hold; "
        "is it in seconds? *1e-3 takes milliseconds, *1e-9 nanoseconds"
    )


def _doubts(samples: Samples, motion: str) -> list[str]:
    """Return warnings about values that are unlikely in SI units."""
    doubts = []
    fastest = float(np.max(np.abs(samples.velocity_m_s)))
    if fastest > FASTEST[motion]:
        unit, other = Quantities(motion).velocity, "rpm" if motion == ROTARY else "mm/s"
        doubts.append(
            f"velocity reaches {fastest:.4g} {unit}; a column in {other} is mapped as velocity=COLUMN[{other}]"
        )
    if samples.pressure_Pa is not None and np.nanmin(samples.pressure_Pa, initial=np.inf) < 5e4:
        doubts.append(
            f"pressure falls to {np.nanmin(samples.pressure_Pa):.4g} Pa; recorded pressure is absolute: "
            "gauge pressure is mapped as pressure=COLUMN+101325"
        )
    return doubts
