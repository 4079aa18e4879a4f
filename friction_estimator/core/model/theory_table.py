"""A theoretical curve from a table of the user's own: multilinear interpolation on a full grid."""

import math
from dataclasses import dataclass

import numpy as np
from numba import types
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.model.oil import checked_temperature
from friction_estimator.core.sample import Floats, Ints


@dataclass(frozen=True)
class Grid:
    """Friction on a full grid.

    Attributes
    ----------
    velocity_m_s : (a,) float64, increasing, a >= 2.
    gauge_pressure_Pa : (b,) float64, increasing, b >= 1.
    temperature_degC : (c,) float64, increasing, c >= 1.
    friction_N : (a, b, c) float64.
    """

    velocity_m_s: Floats
    gauge_pressure_Pa: Floats
    temperature_degC: Floats
    friction_N: NDArray[np.float64]


@njit(cache=True)
def _bracket(axis, x):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return (i, j, t): x = (1 - t) axis[i] + t axis[j], x inside the axis; i = j and t = 0 on an axis of one."""
    if axis.size == 1:
        return 0, 0, 0.0
    i = min(np.searchsorted(axis, x, side="right"), axis.size - 1) - 1
    return i, i + 1, (x - axis[i]) / (axis[i + 1] - axis[i])


@njit(cache=True)
def _inside(axis, x):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    return min(max(x, axis[0]), axis[-1])


_READ = types.Array(types.float64, 1, "C", readonly=True)
_TABLE_LOOP_SIGNATURE = types.void(
    *(_READ,) * 6,
    types.Array(types.float64, 3, "C", readonly=True),
    _READ,
    types.int64[::1],
    types.float64[::1],
)


@njit(_TABLE_LOOP_SIGNATURE, cache=True, nogil=True)
def _table_loop(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    velocity, pressure, temperature, v_axis, p_axis, t_axis, table, default, counts, friction
):
    """Fill `friction`; see TableCurve. Additions and products only: the order of samples cannot matter."""
    mirrored = v_axis[0] >= 0.0
    for k in range(velocity.size):
        v, p, t = velocity[k], pressure[k], temperature[k]
        if math.isnan(p) or math.isnan(t):
            counts[0] += 1
            p = default[0] if math.isnan(p) else p
            t = default[1] if math.isnan(t) else t
        sign = 1.0
        if mirrored and v <= 0.0:
            sign = -1.0 if v < 0.0 else 0.0
            v = -v
        outside = math.isnan(v)
        if outside:
            v, sign = v_axis[0], 0.0
        held_v, held_p, held_t = _inside(v_axis, v), _inside(p_axis, p), _inside(t_axis, t)
        # An axis of one value says that the table does not depend on it: nothing is outside.
        if outside or held_v != v or (held_p != p and p_axis.size > 1) or (held_t != t and t_axis.size > 1):
            counts[1] += 1
        i0, i1, a = _bracket(v_axis, held_v)
        j0, j1, b = _bracket(p_axis, held_p)
        k0, k1, c = _bracket(t_axis, held_t)
        low = (1.0 - b) * ((1.0 - c) * table[i0, j0, k0] + c * table[i0, j0, k1])
        low += b * ((1.0 - c) * table[i0, j1, k0] + c * table[i0, j1, k1])
        high = (1.0 - b) * ((1.0 - c) * table[i1, j0, k0] + c * table[i1, j0, k1])
        high += b * ((1.0 - c) * table[i1, j1, k0] + c * table[i1, j1, k1])
        friction[k] = sign * ((1.0 - a) * low + a * high)


class TableCurve:
    """Multilinear interpolation of a user's table; outside the grid the value at its edge holds.

    A table whose velocities are all zero or positive is one half of an odd curve: d(-v) = -d(v) and d(0) = 0.

    Parameters
    ----------
    grid : the table, see `theory_table_file.read_table`.
    default_pressure_Pa : gauge pressure of samples without one, Pa.
    default_temperature_degC : temperature of samples without one, degC.

    >>> line = Grid(np.array([-1.0, 1.0]), np.zeros(1), np.array([20.0]), np.array([[[-3.0]], [[3.0]]]))
    >>> curve = TableCurve(line, 0.0, 20.0)
    >>> curve.evaluate(np.array([0.5, 2.0]), np.zeros(2), np.full(2, 20.0))
    array([1.5, 3. ])
    >>> curve.held
    1
    """

    def __init__(self, grid: Grid, default_pressure_Pa: float, default_temperature_degC: float) -> None:
        self.grid = grid
        self._default = np.array([default_pressure_Pa, checked_temperature(default_temperature_degC)], np.float64)
        self._counts: Ints = np.zeros(2, np.int64)

    @property
    def defaulted(self) -> int:
        """Samples so far whose pressure or temperature was NaN and was replaced by the default."""
        return int(self._counts[0])

    @property
    def held(self) -> int:
        """Samples so far outside the grid, held at its edge."""
        return int(self._counts[1])

    @property
    def sign_velocity_m_s(self) -> None:
        """What was measured has no formula for its sign."""
        return None

    def evaluate(self, velocity_m_s: Floats, gauge_pressure_Pa: Floats, temperature_degC: Floats) -> Floats:
        """Return the interpolated friction, (n,) N; see TheoryCurve.evaluate."""
        if not velocity_m_s.shape == gauge_pressure_Pa.shape == temperature_degC.shape:
            shapes = velocity_m_s.shape, gauge_pressure_Pa.shape, temperature_degC.shape
            raise ValueError(f"the inputs differ in shape: {shapes}")
        grid = self.grid
        friction = np.empty(velocity_m_s.shape, np.float64)
        _table_loop(
            np.ascontiguousarray(velocity_m_s),
            np.ascontiguousarray(gauge_pressure_Pa),
            np.ascontiguousarray(temperature_degC),
            grid.velocity_m_s,
            grid.gauge_pressure_Pa,
            grid.temperature_degC,
            grid.friction_N,
            self._default,
            self._counts,
            friction,
        )
        return friction
