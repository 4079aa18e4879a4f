"""A theoretical curve's table as a CSV file: a full grid, or scattered measurements."""

import csv
import io
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.model.oil import KELVIN, checked_temperature
from friction_estimator.core.model.theory_seal import LOWEST_GAUGE_PRESSURE_PA
from friction_estimator.core.model.theory_table import Grid
from friction_estimator.core.regular_file import read_regular
from friction_estimator.core.text import LONGEST_NAME, shown

COLUMNS = ("velocity_m_s", "pressure_Pa", "temperature_K", "friction_N")

LARGEST_BYTES, MOST_ROWS = 16 << 20, 200_000
"""A curve needs thousands of rows, not millions."""

_FULL = 0.5
"""Share of its grid that a table fills from which on it is a grid; with less, its rows are scattered measurements."""

_LARGEST = 1e15

_SHOWN_POINTS = 3


def read_table(path: str | os.PathLike[str]) -> Grid:
    """Read a CSV of `velocity_m_s,pressure_Pa,temperature_K,friction_N` (gauge pressure) in any order of rows.

    Other columns are passed over. Rows that fill at least half of the grid of all velocities (at least two), pressures
    and temperatures that occur are taken for a grid, and must fill all of it, each point once. Others are scattered
    measurements, at least 30, repeated or not: see `theory_scatter`.

    Raises
    ------
    ConfigError
        Naming the file and, where there is one, the row (as numbered by an editor, the header being row 1): it
        cannot be read, a column is missing, an entry is no finite number, a temperature lies outside -40 to
        150 degC or a gauge pressure below vacuum, a point of a grid occurs twice or not at all.
    """
    # scipy's sparse solvers take 0.1 s, and few runs read a table
    from friction_estimator.core.model.theory_scatter import LEAST_ROWS, Rows, smoothed  # noqa: PLC0415

    source = Path(path)
    try:
        text = read_regular(source, LARGEST_BYTES).decode("utf-8-sig")
        rows = _read_rows(csv.reader(io.StringIO(text, newline="")), source)
    except ConfigError:
        raise
    except InputError as error:
        raise ConfigError(f"theory.table: {error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"theory.table: {source} is no CSV text: {error}") from error
    points = {point: friction for _, point, friction in rows}
    axes = [np.unique([point[i] for point in points]) for i in range(3)]
    if axes[0].size < 2:
        raise ConfigError(f"theory.table: {source} has {axes[0].size} velocities: a curve needs at least two")
    size = math.prod(axis.size for axis in axes)
    if len(points) < _FULL * size and len(rows) >= LEAST_ROWS:
        measured = np.array([(*point, friction) for _, point, friction in rows])
        return smoothed(Rows(measured[:, 0], measured[:, 1], measured[:, 2] - KELVIN, measured[:, 3]))
    if len(points) < len(rows):
        first: dict[tuple[float, float, float], int] = {}
        for number, point, _ in rows:
            if point in first:
                raise ConfigError(
                    f"theory.table: {source} row {number} repeats the velocity, pressure and temperature of row "
                    f"{first[point]}: leave one of them out"
                )
            first[point] = number
    if len(points) < size:
        grid = itertools.product(*(axis.tolist() for axis in axes))
        missing = list(itertools.islice((point for point in grid if point not in points), _SHOWN_POINTS))
        some = "; ".join(f"({v:g} m/s, {p:g} Pa, {t:g} K)" for v, p, t in missing)
        more = ", ..." if size - len(points) > _SHOWN_POINTS else ""
        few = "" if len(points) >= _FULL * size else f"; scattered measurements are taken from {LEAST_ROWS} rows on"
        raise ConfigError(
            f"theory.table: {source} lacks {size - len(points)} of the {size} points of its grid of "
            f"{axes[0].size} velocities, {axes[1].size} pressures and {axes[2].size} temperatures: {some}{more}{few}"
        )
    wanted = itertools.product(*(axis.tolist() for axis in axes))
    friction = np.array([points[point] for point in wanted], np.float64)
    return Grid(axes[0], axes[1], axes[2] - KELVIN, friction.reshape([axis.size for axis in axes]))


_Row = tuple[int, tuple[float, float, float], float]


def _read_rows(reader: Iterator[list[str]], source: Path) -> list[_Row]:
    header = [name.strip() for name in next(reader, [])]
    lacking = [name for name in COLUMNS if name not in header]
    if lacking:
        found = ", ".join(header) or "nothing"
        raise ConfigError(
            f"theory.table: {source} row 1 lacks the column {lacking[0]}: the header needs "
            f"{','.join(COLUMNS)} and has {shown(found, LONGEST_NAME)}"
        )
    places = [header.index(name) for name in COLUMNS]
    rows: list[_Row] = []
    for number, cells in enumerate(reader, start=2):
        if not any(cell.strip() for cell in cells):
            continue
        if len(rows) == MOST_ROWS:
            raise ConfigError(f"theory.table: {source} has more than {MOST_ROWS} rows: thin them out")
        where = f"theory.table: {source} row {number}"
        values = []
        for name, place in zip(COLUMNS, places, strict=True):
            text = cells[place].strip() if place < len(cells) else ""
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise ConfigError(f"{where}: {name} is {shown(repr(text), LONGEST_NAME)}, not a finite number")
            if abs(value) > _LARGEST:
                raise ConfigError(f"{where}: {name} is {value:g}, which no {name.partition('_')[0]} is")
            values.append(value)
        velocity, pressure, temperature, friction = values
        checked_temperature(temperature - KELVIN, f"{where}: temperature_K {temperature:g} K")
        if pressure < LOWEST_GAUGE_PRESSURE_PA:
            raise ConfigError(f"{where}: pressure_Pa is {pressure:g}, a gauge pressure below vacuum")
        rows.append((number, (velocity, pressure, temperature), friction))
    if not rows:
        raise ConfigError(f"theory.table: {source} has no row below the header")
    return rows
