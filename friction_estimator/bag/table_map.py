"""The map of a table: which rows count, and what time and inputs are in them, by arithmetic over the columns."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.column_units import Kind
from friction_estimator.bag.columns import Columns, TableFile, empty, numbers
from friction_estimator.bag.expression import Expression, Value
from friction_estimator.bag.messages import INPUTS
from friction_estimator.bag.topics import REQUIRED
from friction_estimator.core.errors import InputError
from friction_estimator.core.intake.derivative import derivative
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints

RESTART_PERIODS = 10
GAP_PERIODS = 20
RESTART_GAP_S = 1.0

LATEST_S = 2**31 - 1
"""Largest stamp that a ROS message can carry, s."""


@dataclass(frozen=True)
class TableSpec:
    """What to take from a table.

    Attributes
    ----------
    time : time in seconds, an expression over the columns (`t_ms*1e-3`, `t[ms]`).
    inputs : expression by input; friction is needed, and velocity or a position to make it of. SI units, absolute
        pressure.
    where : (column, value) pairs that a row must all match; numbers are compared as numbers.
    segment : column whose change starts a new piece.
    rate_hz : sample rate wanted; 0: that of the table. See `resample`.
    """

    time: str
    inputs: Mapping[str, str]
    where: Sequence[tuple[str, str]] = ()
    segment: str | None = None
    rate_hz: float = 0.0


@dataclass(frozen=True)
class MappedRows:
    """The rows that match, and what is to be computed of them.

    Attributes
    ----------
    rows : in the file. columns : those used, (n,) each, of the rows that match. label : their segment, (n,).
    expressions : by input, time among them.
    """

    rows: int
    columns: Columns
    label: NDArray[Any]
    expressions: Mapping[str, Expression]

    @classmethod
    def of(cls, table: TableFile, spec: TableSpec) -> "MappedRows":
        """Read what the spec wants. Raises InputError."""
        given = _with_velocity(spec.inputs)
        names = table.names
        expressions = {"time": _expression("time", spec.time, names)}
        for name, text in given.items():
            others = {other for other, its in given.items() if other != name and its.strip() != other}
            expressions[name] = _expression(name, text, names, others)
        filters = [(_column(name, names), value) for name, value in spec.where]
        segment = None if spec.segment is None else _column(spec.segment, names)
        used = {column for expression in expressions.values() for column in expression.columns}
        used |= {name for name, _ in filters} | ({segment} if segment else set())
        columns = table.read([name for name in names if name in used])
        rows = _common_length(columns)
        matching = np.ones(rows, np.bool_)
        for name, value in filters:
            matching &= _equal(columns[name], name, value)
            if not matching.any():
                raise InputError(f"no row matches {name}={value}; the column holds {_some_values(columns[name])}")
        count = int(np.count_nonzero(matching))
        if count < rows:
            columns = {name: cells[matching] for name, cells in columns.items()}
        label = np.zeros(count) if segment is None else columns[segment]
        return cls(rows, columns, label, expressions)

    @property
    def units(self) -> dict[str, str]:
        """Unit by column, where the column's own name says it."""
        return {name: unit.symbol for each in self.expressions.values() for name, unit in each.own_units.items()}

    def values(self) -> tuple[dict[str, Floats], str]:
        """Return time and inputs in SI units, and the motion that their units tell of; "" where they tell of none."""
        time_s = self._value("time", self.expressions["time"].value(self._numbers))

        def rate(values: Floats) -> Floats:
            return self._rate(time_s, values)

        found: dict[str, Value] = {}

        def value_of(name: str, through: tuple[str, ...] = ()) -> Value:
            if name in through:
                raise InputError(f"--map: {name} refers to itself: {' -> '.join((*through, name))}")
            if name not in found:
                with _named(name):
                    found[name] = self.expressions[name].value(
                        self._numbers, lambda other: value_of(other, (*through, name)), rate
                    )
            return found[name]

        values = {"time": time_s} | {
            name: self._value(name, value_of(name)) for name in self.expressions if name != "time"
        }
        return values, _motion({name: value.kind for name, value in found.items()})

    def _rate(self, time_s: Floats, values: Floats) -> Floats:
        """Return the derivative of values by time, (n,): of the rows that are later than all before in their piece."""
        out = np.full(values.size, np.nan)
        rows = np.flatnonzero(np.abs(time_s) < LATEST_S)
        if not rows.size:
            return out
        piece = pieces(time_s[rows], self.label[rows])
        moved = continuous(time_s[rows], piece)
        later = moved > np.concatenate([[-np.inf], np.maximum.accumulate(moved)[:-1]])
        rows, piece, moved = rows[later], piece[later], moved[later]
        stamps = np.rint((moved - moved[0]) * NS_PER_S).astype(np.int64) + NS_PER_S
        out[rows] = derivative(stamps, values[rows], np.diff(piece, prepend=-1) != 0)
        return out

    def _numbers(self, name: str) -> Floats:
        return numbers(self.columns[name], name)

    def _value(self, name: str, value: Value) -> Floats:
        text = self.expressions[name].text
        option = f"--time {text}" if name == "time" else f"--map {name}={text}"
        if value.kind is not None and not value.kind.fits(name):
            raise InputError(f"{option} is {value.kind}, where {Kind.wanted(name)} is needed")
        if value.is_number:
            if name in ("time", *REQUIRED):
                raise InputError(f"{option} names no column")
            return np.full(self.label.size, float(value.data))
        return np.asarray(value.data, np.float64)


def _with_velocity(inputs: Mapping[str, str]) -> dict[str, str]:
    """Return the map, with the velocity as the derivative of the position where only that is mapped."""
    for name in inputs:
        if name not in INPUTS:
            near = difflib.get_close_matches(name, INPUTS, n=1)
            hint = f"nearest: {near[0]}" if near else f"choose from {', '.join(INPUTS)}"
            raise InputError(f"unknown input {name!r} in the map; {hint}")
    if "friction" not in inputs:
        raise InputError("the map has no friction: give velocity=COLUMN,friction=COLUMN")
    if "velocity" in inputs:
        return dict(inputs)
    if "position" not in inputs:
        raise InputError("the map has no velocity: give velocity=COLUMN, or velocity=d(COLUMN) of a position")
    return {**inputs, "velocity": f"d({inputs['position']})"}


def _expression(name: str, text: str, names: Sequence[str], inputs: Iterable[str] = ()) -> Expression:
    with _named(name):
        return Expression.parse(text, names, inputs)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the time, or the input of the map, in a failure; it says itself what it is about."""
    try:
        yield
    except InputError as error:
        if str(error).startswith("--"):
            raise
        raise InputError(f"{'--time' if name == 'time' else f'--map {name}'}: {error}") from None


def _column(name: str, names: Sequence[str]) -> str:
    """Return the column of this name, for `--where` and `--segment`."""
    if name in names:
        return name
    used = Expression.parse(name, names).columns
    if len(used) != 1:
        raise InputError(f"no column {name!r}")
    return used[0]


def _motion(kinds: Mapping[str, Kind | None]) -> str:
    """Return the motion that the units tell of; "" where they tell of none. Raises InputError where they disagree."""
    told = {name: kind.motion for name, kind in kinds.items() if kind is not None and kind.motion}
    if len(set(told.values())) > 1:
        words = " and ".join(f"{name} is {kinds[name]}" for name in told)
        raise InputError(f"--map: {words}: one drive is linear or rotary; convert one of them by its radius or pitch")
    return next(iter(told.values()), "")


def pieces(time_s: Floats, label: NDArray[Any]) -> Ints:
    """Return the piece of each row, (n,): a new one where the label changes or time restarts."""
    step = np.diff(time_s)
    new = _changes(label) | (step < -RESTART_PERIODS * _period(step))
    return np.concatenate([[0], np.cumsum(new)]).astype(np.int64)


def continuous(time_s: Floats, piece: Ints) -> Floats:
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
