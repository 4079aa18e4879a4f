"""Tables to samples: which column is what, which rows count, and where time breaks.

Rows are taken in the order of the file. A new piece of the recording starts where the segment column changes, and
where time steps back by more than ten sample periods. A piece starts at least twenty sample periods after the end of
the one before, and at least one second after it where time restarts; where its own time is earlier, it and all that
follow are shifted later. So every boundary is a gap for the estimator, which restarts its delay lines there. Inside a
piece, a row with the time of an earlier row (duplicate) or a slightly earlier time (backward) is left out. Rows
without time, velocity or friction are left out as missing samples, and so are rows where one of them is infinite or
larger than any sensor reads.

Stamps are the table's own time; where that begins before 1 s, it is shifted to begin at 1 s, because a stamp of zero
means "no stamp" in ROS.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.columns import Columns, TableFile, Term, empty
from friction_estimator.bag.messages import INPUTS
from friction_estimator.bag.table_files import open_table
from friction_estimator.bag.topics import REQUIRED
from friction_estimator.core.errors import InputError, UnanswerableError, about
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints, Samples

RESTART_PERIODS = 10
GAP_PERIODS = 20
RESTART_GAP_S = 1.0
FIRST_STAMP_S = 1.0

_LATEST_S = 2**31 - 1
"""Largest stamp that a ROS message can carry, s."""

_LONGEST = float(np.finfo(np.float64).max)
"""Time cells beyond it are infinite; how far a finite one may go, a stamp decides."""


@dataclass(frozen=True)
class TableSpec:
    """What to take from a table.

    Attributes
    ----------
    time : column of time in seconds, with scale and offset (`t_ms*1e-3`).
    inputs : column by input, with scale and offset; velocity and friction are needed. SI units, absolute pressure.
    where : (column, value) pairs that a row must all match; numbers are compared as numbers.
    segment : column whose change starts a new piece.
    """

    time: str
    inputs: Mapping[str, str]
    where: Sequence[tuple[str, str]] = ()
    segment: str | None = None


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
    warnings: tuple[str, ...] = field(default=())


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
    rows, values, label = _selected(table, spec)
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
    if latest_s - min(earliest, 0.0) >= _LATEST_S:
        raise _too_long(spec, earliest, latest_s)

    # Pieces are found on all rows that have a time: a boundary may fall on a row that is left out. Gaps are made
    # between rows that are kept, or a stretch of pieces without one would grow by a gap for each.
    timed = ~np.isnan(values["time"])
    piece = _pieces(values["time"][timed], label[timed])[complete[timed]]
    time_s = _continuous(values["time"][complete], piece)
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(time_s)[:-1]])
    later, repeated = time_s > latest, time_s == latest
    shift_s = max(0.0, FIRST_STAMP_S - float(time_s[0]))
    if not time_s[-1] + shift_s < _LATEST_S:
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
    report = TableReport(
        rows=rows,
        selected=label.size,
        missing=missing,
        infinite=infinite,
        not_held={name: count for name, count in not_held.items() if count},
        duplicate=int(np.count_nonzero(repeated)),
        backward=int(np.count_nonzero(~later & ~repeated)),
        pieces=int(np.count_nonzero(samples.restart)),
        shift_s=shift_s,
        warnings=tuple(_doubts(samples)),
    )
    return samples, report


def _too_long(spec: TableSpec, earliest_s: float, latest_s: float) -> InputError:
    return InputError(
        f"--time {spec.time} runs from {earliest_s:.6g} to {latest_s:.6g} s, beyond what a stamp can hold; "
        "is it in seconds? *1e-3 takes milliseconds, *1e-9 nanoseconds"
    )


def _selected(table: TableFile, spec: TableSpec) -> tuple[int, dict[str, Floats], NDArray[Any]]:
    """Return the number of rows, and time, inputs and segment label of those that match, in SI units."""
    for name in spec.inputs:
        if name not in INPUTS:
            raise InputError(f"unknown input {name!r} in the map: choose from {', '.join(INPUTS)}")
    for name in ("velocity", "friction"):
        if name not in spec.inputs:
            raise InputError(f"the map has no {name}: give velocity=COLUMN,friction=COLUMN")
    names = table.names
    terms = {"time": Term.parse(spec.time, names)}
    terms |= {name: Term.parse(text, names) for name, text in spec.inputs.items()}
    filters = [(Term.parse(name, names).column, value) for name, value in spec.where]
    segment = None if spec.segment is None else Term.parse(spec.segment, names).column
    used = {term.column for term in terms.values()} | {name for name, _ in filters} | ({segment} - {None})
    columns = table.read([name for name in names if name in used])
    rows = _common_length(columns)
    matching = np.ones(rows, np.bool_)
    for name, value in filters:
        matching &= _equal(columns[name], name, value)
        if not matching.any():
            raise InputError(f"no row matches {name}={value}; the column holds {_some_values(columns[name])}")
    values = {name: term.of(columns)[matching] for name, term in terms.items()}
    label = np.zeros(int(np.count_nonzero(matching))) if segment is None else columns[segment][matching]
    return rows, values, label


def _pieces(time_s: Floats, label: NDArray[Any]) -> Ints:
    """Return the piece of each row, (n,): a new one where the label changes or time restarts."""
    step = np.diff(time_s)
    new = _changes(label) | (step < -RESTART_PERIODS * _period(step))
    return np.concatenate([[0], np.cumsum(new)]).astype(np.int64)


def _continuous(time_s: Floats, piece: Ints) -> Floats:
    """Return time that never restarts, with a gap before each piece, (n,) (see the module's words)."""
    period = _period(np.diff(time_s))
    starts = np.concatenate([[0], np.flatnonzero(np.diff(piece)) + 1, [time_s.size]])
    moved = time_s.copy()
    end, shift = -np.inf, 0.0
    for begin, stop in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        gap = GAP_PERIODS * period
        if begin and time_s[begin] < time_s[begin - 1]:
            gap = max(gap, RESTART_GAP_S)
        shift = max(shift, end + gap - float(time_s[begin:stop].min()))
        moved[begin:stop] += shift
        end = float(moved[begin:stop].max())
    return moved


def _period(step: Floats) -> float:
    return float(np.median(step[step > 0])) if np.any(step > 0) else 0.0


def _changes(label: NDArray[Any]) -> Bools:
    """Return where a label differs from the one before; empty cells are alike."""
    if label.dtype.kind in "biu":
        return np.asarray(label[1:] != label[:-1])
    texts = np.array(["" if empty(cell) else str(cell) for cell in label.tolist()], dtype=object)
    return np.asarray(texts[1:] != texts[:-1], np.bool_)


def _equal(cells: NDArray[Any], name: str, value: str) -> Bools:
    """Return which cells equal a value given as text: as numbers where the column holds numbers."""
    if cells.dtype.kind in "biuf":
        try:
            return np.asarray(cells == float(value))
        except ValueError:
            raise InputError(
                f"--where {name}={value}: the column holds numbers ({_some_values(cells)}), {value!r} is none"
            ) from None
    return np.array([not empty(cell) and str(cell).strip() == value for cell in cells.tolist()], np.bool_)


def _some_values(cells: NDArray[Any]) -> str:
    different = list(dict.fromkeys(str(cell) for cell in cells.tolist()))
    return ", ".join(different[:8]) + (", ..." if len(different) > 8 else "")


def _common_length(columns: Columns) -> int:
    lengths = {name: cells.size for name, cells in columns.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {size}" for name, size in lengths.items())
        raise InputError(f"the columns differ in length: {told}")
    return next(iter(lengths.values()))


def _doubts(samples: Samples) -> list[str]:
    """Return warnings about values that are unlikely in SI units."""
    doubts = []
    fastest = float(np.max(np.abs(samples.velocity_m_s)))
    if fastest > 20.0:
        doubts.append(f"velocity reaches {fastest:.4g} m/s; a column in mm/s is mapped as velocity=COLUMN*1e-3")
    if samples.pressure_Pa is not None and np.nanmin(samples.pressure_Pa, initial=np.inf) < 5e4:
        doubts.append(
            f"pressure falls to {np.nanmin(samples.pressure_Pa):.4g} Pa; recorded pressure is absolute: "
            "gauge pressure is mapped as pressure=COLUMN+101325"
        )
    return doubts
