"""Long signals for a screen: the lowest and the highest value of each few samples, and some pieces in full.

A line over a million samples shows no more than one over the extremes of every pixel's samples. The page gets the
finest table of extremes that its size allows, makes the coarser ones from it, and draws the one that suits the time
that is looked at (templates/page.js); pieces that are looked at closely are there sample by sample.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core import series, sums
from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.core.series import Series

FINEST = 40_000
"""Rows of the finest table: sixteen times as many as a wide screen has pixels, and 1 MB."""

WHOLE = 60_000
"""Recordings of at most so many samples are kept sample by sample."""

MOST_BREAKS = 4_000
"""Places where a line is interrupted; where there are more, only the longest gaps are."""

LEVELS = 32_000
"""Steps in which a value is kept: a screen shows a tenth of them."""

MISSING = -32_768
"""Stands for no value."""

SURE = 20.0
"""Values beyond this many times the usual size (of a diverged estimate) are cut there: the rest must stay readable."""


@dataclass(frozen=True)
class Table:
    """Rows over time.

    Attributes
    ----------
    columns : name -> (rows,): `time_s`, `gap` (1 where the row follows a gap), and for each signal x either `x`
        or `x_low` and `x_high`, as integers of `steps`, or as they are.
    steps : signal -> (value of zero, size of one step); signals that are not in it are floats.
    samples_per_row : at the most.
    """

    columns: Mapping[str, NDArray[np.generic]]
    steps: Mapping[str, tuple[float, float]]
    samples_per_row: int


def piece(time_s: Series, signals: Mapping[str, Series], gap: Bools, part: slice) -> Table:
    """Return samples as they are, as single-precision floats."""
    columns: dict[str, NDArray[np.generic]] = {"time_s": time_s[part], "gap": gap[part].astype(np.uint8)}
    for name, values in signals.items():
        columns[name] = values[part].astype(np.float32)
    return Table(columns, {}, 1)


def table(time_s: Series, signals: Mapping[str, Series], gap: Bools, rows: int = FINEST) -> Table:
    """Return the extremes of a recording's signals in about `rows` rows, none of which reaches over a gap.

    Parameters
    ----------
    time_s : (n,), increasing. signals : name -> (n,), NaN where there is no value. gap : (n,), True where a sample
        follows a gap.

    >>> t = np.arange(6.0)
    >>> out = table(t, {"x": np.array([0.0, 5.0, 1.0, -3.0, 2.0, 2.0])}, np.zeros(6, bool), rows=2)
    >>> zero, step = out.steps["x"]
    >>> low, high = (zero + step * out.columns[name] for name in ("x_low", "x_high"))
    >>> np.allclose(low, [0.0, -3.0], atol=1e-3), np.allclose(high, [5.0, 2.0], atol=1e-3)
    (True, True)
    """
    count = -(-time_s.size // rows)
    edges = np.union1d(np.arange(0, time_s.size, count), np.flatnonzero(gap))
    columns: dict[str, NDArray[np.generic]] = {"time_s": series.at(time_s, edges), "gap": gap[edges].astype(np.uint8)}
    steps = {}
    for name, values in signals.items():
        low, high = _extremes(values, edges)
        zero, step = _steps(low, high)
        steps[name] = (zero, step)
        columns[f"{name}_low"] = _stepped(low, zero, step, np.floor)
        columns[f"{name}_high"] = _stepped(high, zero, step, np.ceil)
    return Table(columns, steps, count)


def _extremes(values: Series, edges: Ints) -> tuple[Floats, Floats]:
    """Return the lowest and the highest value from each edge to the next, and from the last to the end."""
    low, high = np.empty(edges.size), np.empty(edges.size)
    first = 0
    while first < edges.size:
        # As many rows as come in a block of samples, and one at the least.
        last = max(first + 1, int(np.searchsorted(edges, edges[first] + sums.BLOCK)))
        end = int(edges[last]) if last < edges.size else values.size
        part, rows = values[int(edges[first]) : end], edges[first:last] - edges[first]
        low[first:last], high[first:last] = np.fmin.reduceat(part, rows), np.fmax.reduceat(part, rows)
        first = last
    return low, high


def _steps(low: Floats, high: Floats) -> tuple[float, float]:
    ends = np.concatenate([low[np.isfinite(low)], high[np.isfinite(high)]])
    if not ends.size:
        return 0.0, 1.0
    first, last = float(ends.min()), float(ends.max())
    return 0.5 * (first + last), max((last - first) / (2 * LEVELS), 1e-300)


def _stepped(values: Floats, zero: float, step: float, rounded: "np.ufunc") -> NDArray[np.int16]:
    finite = np.isfinite(values)
    whole = np.clip(rounded((np.where(finite, values, 0.0) - zero) / step - 1e-9), -LEVELS - 1, LEVELS + 1)
    return np.where(finite, whole, MISSING).astype(np.int16)


def gaps(time_s: Series, restart: Bools) -> Bools:
    """Return where a line must be interrupted, (n,): at restarts; at the longest gaps only where there are too many."""
    places: Ints = np.flatnonzero(restart)
    if places.size > MOST_BREAKS:
        step = series.at(time_s, places) - series.at(time_s, np.maximum(places - 1, 0))
        places = places[np.argsort(-step, kind="stable")[:MOST_BREAKS]]
    out = np.zeros(time_s.size, np.bool_)
    out[places] = True
    return out


def readable(values: Floats, usual: float) -> Floats:
    """Return values with what is not finite as NaN, and cut where they run away from the usual size."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(values), np.clip(values, -SURE * usual, SURE * usual), np.nan)


def pieces_of(length: int, parts: Sequence[slice], most: int) -> list[slice]:
    """Return the parts within `length` samples, each once and cut to the `most` samples at its middle."""
    out = []
    # The first cycle is often the worst one, too.
    for start, stop, _ in dict.fromkeys(part.indices(length) for part in parts):
        spare = max(0, (stop - start) - most) // 2
        out.append(slice(start + spare, min(stop, start + spare + most)))
    return out
