"""Scattered measurements become a table: sweeps at some pressures and temperatures, with noise on everything.

A measured table is no grid: velocity, pressure and temperature differ a little from row to row, and the same condition
comes many times. Its rows are fitted by a multilinear function on a coarse grid of its own, by least squares,

    sum_i rho(f_i - g(x_i)) + sum_axes w_axis sum (g_j+1 - g_j)^2,

differences between neighbours of the grid (Eilers and Marx 1996, "Flexible smoothing with B-splines and penalties",
with hats for splines), rho Huber's, so that a wild row counts little. Where there are rows, they
decide; where there are none, the nearest conditions are carried on, and nothing leaves the range of what was measured.
The curve is then evaluated as any other table.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from friction_estimator.core.banded import diagonal, differences, identity
from friction_estimator.core.model.theory_table import Grid
from friction_estimator.core.sample import Bools, Floats

LEAST_ROWS = 30
"""Fewer rows are no measured curve."""

_KNOTS = 24
"""Velocities of the grid on each side of rest; they lie closer towards rest, where friction bends."""

_REST = 0.005
"""Share of the top speed below which the sign of a measured velocity is noise: where friction jumps at rest, such rows
are left out, and the grid goes straight through rest."""

_ROWS_PER_KNOT = 6
"""Rows between two velocities of the grid at least, at each condition."""

_SIDE = 0.05
"""Top speed of a direction over that of the other, below which it is noise around rest."""

_CONDITIONS = 12
"""Pressures, and temperatures, of the grid at most where the rows lie around so many; else `_EVEN`, evenly spaced."""

_EVEN = 7

_CLUSTER_GAP = 0.05
"""Share of an axis without rows that separates two conditions."""

_ONE_PRESSURE_PA, _ONE_TEMPERATURE_K = 2e3, 5.0
"""Rows within so much were measured at one pressure, at one temperature."""

_ALONG_VELOCITY, _ALONG_CONDITIONS = 0.3, 0.03
"""Weights of the differences along an axis, in rows."""

_PASSES, _HUBER = 4, 1.345
"""Refits with the weights of Huber's rho, and its bend in standard deviations (95 % efficient for normal noise)."""


@dataclass(frozen=True)
class Rows:
    """Measured rows, each (n,) float64: m/s, gauge Pa, degC, N."""

    velocity_m_s: Floats
    gauge_pressure_Pa: Floats
    temperature_degC: Floats
    friction_N: Floats

    def __getitem__(self, chosen: Bools) -> "Rows":
        return Rows(
            self.velocity_m_s[chosen],
            self.gauge_pressure_Pa[chosen],
            self.temperature_degC[chosen],
            self.friction_N[chosen],
        )


def smoothed(rows: Rows) -> Grid:
    """Return the grid that fits scattered rows (at least `LEAST_ROWS`, more than one velocity) best.

    Where one direction was measured, the grid begins at rest: half of an odd curve (see `TableCurve`).

    >>> v = 0.1 * np.sin(0.1 * np.arange(500))
    >>> grid = smoothed(Rows(v, np.full(500, 2e5), np.full(500, 25.0), 3.0 * np.sign(v) + 20.0 * v))
    >>> grid.friction_N.shape[1:], round(float(np.interp(0.05, grid.velocity_m_s, grid.friction_N[:, 0, 0])), 1)
    ((1, 1), 4.0)
    """
    v = rows.velocity_m_s
    top, bottom = float(v.max()), float(-v.min())
    if bottom > 0.0 and top < _SIDE * bottom:  # one direction, and that the negative one
        rows = Rows(-v, rows.gauge_pressure_Pa, rows.temperature_degC, -rows.friction_N)
        top, bottom = bottom, top
    if bottom < _SIDE * top:
        rows = rows[rows.velocity_m_s >= 0.0]
    else:
        rows = rows[np.abs(rows.velocity_m_s) >= _REST * min(top, bottom)]
    pressures = _conditions(rows.gauge_pressure_Pa, _ONE_PRESSURE_PA)
    temperatures = _conditions(rows.temperature_degC, _ONE_TEMPERATURE_K)
    least = _ROWS_PER_KNOT * max(pressures.size, temperatures.size)
    moving = rows.velocity_m_s
    slow = [0.0] if bottom < _SIDE * top else -_knots(-moving[moving < 0.0], least)[::-1]
    axes = np.concatenate([slow, _knots(moving[moving > 0.0], least)]), pressures, temperatures
    friction = _fitted(axes, rows)
    return Grid(*axes, np.clip(friction, rows.friction_N.min(), rows.friction_N.max()))


def _knots(speed: Floats, least: int) -> Floats:
    """Return speeds of the grid, increasing, with at least so many rows between neighbours.

    The lowest lies close to rest: friction jumps there, and a grid that began with the first rows would smear it.
    """
    candidates = float(speed.max()) * (_REST + (1.0 - _REST) * (np.arange(_KNOTS) / (_KNOTS - 1)) ** 2)
    ordered = np.sort(speed)
    kept = [candidates[-1]]
    for candidate in candidates[-2:0:-1]:
        below, above = np.searchsorted(ordered, [candidate, kept[-1]])
        if below >= least and above - below >= least:
            kept.append(candidate)
    kept.append(candidates[0])
    return np.array(kept[::-1])


def _conditions(value: Floats, one: float) -> Floats:
    """Return the values around which rows lie: the middle of each cluster, or evenly spaced ones."""
    ordered = np.sort(value)
    extent = float(ordered[-1] - ordered[0])
    if extent <= one:
        return np.array([np.median(ordered)])
    clusters = np.split(ordered, np.flatnonzero(np.diff(ordered) > _CLUSTER_GAP * extent) + 1)
    if 1 < len(clusters) <= _CONDITIONS:
        return np.array([np.median(cluster) for cluster in clusters])
    low, high = np.quantile(ordered, [0.02, 0.98])
    return np.linspace(low, high, _EVEN)


def _fitted(axes: tuple[Floats, Floats, Floats], rows: Rows) -> NDArray[np.float64]:
    """Return friction on the grid, (a, b, c)."""
    shape = tuple(axis.size for axis in axes)
    size = int(np.prod(shape))
    values = (rows.velocity_m_s, rows.gauge_pressure_Pa, rows.temperature_degC)
    n = rows.friction_N.size
    places, weights = np.zeros((n, 1), np.int64), np.ones((n, 1))
    for axis, value in zip(axes, values, strict=True):
        low, share = _hats(axis, value)
        near = np.stack([low, np.minimum(low + 1, axis.size - 1)], axis=1)
        part = np.stack([1.0 - share, share], axis=1)
        places = (places[:, :, None] * axis.size + near[:, None, :]).reshape(n, -1)
        weights = (weights[:, :, None] * part[:, None, :]).reshape(n, -1)
    index = np.repeat(np.arange(n), places.shape[1])
    design: Any = sparse.csr_array((weights.ravel(), (index, places.ravel())), shape=(n, size))
    penalty: Any = sparse.csr_array((size, size))
    for k, weight in enumerate((_ALONG_VELOCITY, _ALONG_CONDITIONS, _ALONG_CONDITIONS)):
        if shape[k] > 1:
            parts: list[Any] = [identity(length) for length in shape]
            along = differences(shape[k]).tocsr()
            parts[k] = along[~((axes[k][:-1] < 0.0) & (axes[k][1:] > 0.0))] if k == 0 else along  # it jumps at rest
            step: Any = sparse.kron(sparse.kron(parts[0], parts[1]), parts[2])
            penalty = penalty + weight * (step.T @ step)
    scale = float(np.abs(rows.friction_N).max()) or 1.0
    target, trust = rows.friction_N / scale, np.ones(n)
    for _ in range(1 + _PASSES):
        weighted: Any = diagonal(trust) @ design
        friction = np.asarray(spsolve(sparse.csc_array(weighted.T @ design + penalty), weighted.T @ target), np.float64)
        error = np.abs(target - design @ friction)
        deviation = 1.4826 * float(np.median(error))
        trust = np.minimum(1.0, _HUBER * deviation / np.maximum(error, np.finfo(float).tiny)) if deviation else trust
    return np.ascontiguousarray(scale * friction.reshape(shape))


def _hats(axis: Floats, value: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the interval of the axis that each value lies in, and how far into it, from 0 to 1; beyond it, its end."""
    if axis.size == 1:
        return np.zeros(value.size, np.int64), np.zeros(value.size)
    low = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    return low, np.clip((value - axis[low]) / (axis[low + 1] - axis[low]), 0.0, 1.0)
