"""One time of the whole force: what a delay or a filter makes of the columns of a static curve, exactly.

A delay of the whole force lies nearly in the span of the FIR of a base model. So it is no column beside the base but a
change of the base itself: its static columns are evaluated at the velocity of another time, or filtered, and everything
else is fitted anew. Columns come from tables over velocity and pressure; velocity is linear between samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats
from friction_estimator.effects.axis import REACH, VelocityAxis
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import cell, place, substeps

VELOCITIES = 1601

VANISHED = 1e-150
"""What is left of a column below which it is nothing: a spline's tail decays on to denormal numbers, with which a
processor is ten times slower."""


@dataclass(frozen=True)
class StaticTables:
    """Columns of a static curve, tabulated.

    Attributes
    ----------
    values : (pressures, VELOCITIES, m), N per unit coefficient. pressures_Pa : (pressures,), increasing.
    axis : the velocities.
    """

    values: Floats
    pressures_Pa: Floats
    axis: VelocityAxis

    @classmethod
    def of(
        cls, columns: Callable[[Floats, Floats], Floats], axis: VelocityAxis, pressures_Pa: Floats
    ) -> "StaticTables":
        """Tabulate `columns(velocity, pressure)` -> (n, m) over `VELOCITIES` of the axis."""
        velocity = axis.velocities(VELOCITIES)
        values = np.array([columns(velocity, np.full(velocity.size, p)) for p in pressures_Pa])
        return cls(values, np.asarray(pressures_Pa, np.float64), axis)

    def delayed(self, features: Features, delay_s: float) -> Floats:
        """Return the columns at velocity and pressure of `delay_s` earlier, (n, m).

        Within each gap-free piece; before its first sample and after its last that sample's values hold.
        """
        moved = (shifted(values, features, delay_s) for values in (features.velocity_m_s, features.pressure_Pa))
        return self.at(*moved)

    def at(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return the columns at the given points, (n, m)."""
        out = np.empty((velocity_m_s.size, self.values.shape[2]))
        _columns(self.axis.shares(velocity_m_s), pressure_Pa, self.values, self.pressures_Pa, out)
        return out

    def lagged(self, features: Features, time_constant_s: float, twice: bool = False) -> Floats:
        """Return the first-order lag of the columns, or two equal ones in series, (n, m).

        Each piece starts in equilibrium.
        """
        out = np.empty((features.size, self.values.shape[2]))
        args = (self.values, self.pressures_Pa, self.axis.bend_m_s, REACH)
        f = features
        _lagged(f.step_s, f.previous_m_s, f.velocity_m_s, f.pressure_Pa, time_constant_s, twice, *args, out)
        return out


def shifted(values: Floats, features: Features, late_s: float) -> Floats:
    """Return values (n,) of `late_s` earlier (later where it is negative), linear between samples.

    Within each gap-free piece, beyond whose ends its last values hold.
    """
    out = np.empty(features.size)
    _shifted(features.step_s, values, late_s, out)
    return out


def unfiltered(values: Floats, features: Features, time_constant_s: float) -> Floats:
    """Return what a first-order filter has made values (n,) of: y + T dy/dt, (n,), by a parabola through three samples.

    At the ends of a gap-free piece the slope is that of the line through two.
    """
    out = np.empty(features.size)
    _unfiltered(features.step_s, values, time_constant_s, out)
    return out


class FirstOrder:
    """The first-order lag of columns, or two equal ones in series; each gap-free piece starts in equilibrium.

    Parameters
    ----------
    time_constant_s : of the lag. twice : two of them.
    """

    def __init__(self, time_constant_s: float, twice: bool = False) -> None:
        self._constants = time_constant_s, twice
        self._state: Floats | None = None

    def __call__(self, parts: Sequence[Floats], step_s: Floats) -> Floats:
        """Return the lag of the next samples' columns, (n, c); it goes on where the last ones ended.

        Parameters
        ----------
        parts : the columns, (n, c) each, at moments that divide the time to the sample before evenly, of which the last
            one is that of the sample; linear between them.
        step_s : (n,), time to the sample before; 0 where a piece begins.
        """
        out = np.empty_like(parts[-1])
        begins = self._state is None
        if self._state is None:
            self._state = np.zeros((3, out.shape[1]))
        _first_order(step_s, np.array(parts), *self._constants, begins, self._state, out)
        return out


@njit(cache=True, error_model="numpy")
def _first_order(step, parts, tau, twice, begins, states, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    count, width = parts.shape[0], parts.shape[2]
    state, second, last = states[0], states[1], states[2]  # they go on with the next samples
    dt, decay = 0.0, 1.0  # kept: samples are evenly spaced, nearly everywhere
    for k in range(parts.shape[1]):
        if (begins and k == 0) or step[k] <= 0.0:
            for c in range(width):
                state[c] = second[c] = last[c] = out[k, c] = parts[count - 1, k, c]
            continue
        if step[k] / count != dt:
            dt = step[k] / count
            decay = np.exp(-dt / tau)
        for s in range(count):
            _lag(state, second, last, parts[s, k], dt, tau, decay, twice)
        for c in range(width):
            out[k, c] = second[c] if twice else state[c]


@njit(cache=True, error_model="numpy", forceinline=True)
def _lag(state, second, last, now, dt, tau, decay, twice):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take the lags of columns that go straight from `last` to `now` a step on, and the lags of those if `twice`."""
    for c in range(state.size):
        slope = (now[c] - last[c]) / dt
        away = state[c] - last[c] + slope * tau
        if twice:
            behind = second[c] - last[c] + 2.0 * slope * tau + away * dt / tau
            second[c] = now[c] - 2.0 * slope * tau + behind * decay
            if abs(second[c]) < VANISHED:
                second[c] = 0.0
        state[c] = now[c] - slope * tau + away * decay
        if abs(state[c]) < VANISHED:
            state[c] = 0.0
        last[c] = now[c]


@njit(cache=True)
def _shifted(step, velocity, delay, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    n = velocity.size
    for k in range(n):
        left, j = delay, k
        if delay >= 0.0:
            while j > 0 and step[j] > 0.0 and left > step[j]:
                left -= step[j]
                j -= 1
            if j == 0 or step[j] <= 0.0:
                out[k] = velocity[j]
            else:
                out[k] = velocity[j] + (velocity[j - 1] - velocity[j]) * left / step[j]
        else:
            left = -delay
            while j < n - 1 and step[j + 1] > 0.0 and left > step[j + 1]:
                left -= step[j + 1]
                j += 1
            if j == n - 1 or step[j + 1] <= 0.0:
                out[k] = velocity[j]
            else:
                out[k] = velocity[j] + (velocity[j + 1] - velocity[j]) * left / step[j + 1]


@njit(cache=True)
def _unfiltered(step, values, tau, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    n = values.size
    for k in range(n):
        before = step[k] if k > 0 else 0.0
        after = step[k + 1] if k < n - 1 else 0.0
        slope = 0.0
        if before > 0.0 and after > 0.0:
            rise, fall = (values[k + 1] - values[k]) / after, (values[k] - values[k - 1]) / before
            slope = (rise * before + fall * after) / (before + after)
        elif before > 0.0:
            slope = (values[k] - values[k - 1]) / before
        elif after > 0.0:
            slope = (values[k + 1] - values[k]) / after
        out[k] = values[k] + tau * slope


@njit(cache=True, forceinline=True)
def _row(values, i, part, j, q, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    if q > 0.0:
        for c in range(out.size):
            below = values[j, i, c] * (1.0 - part) + values[j, i + 1, c] * part
            above = values[j + 1, i, c] * (1.0 - part) + values[j + 1, i + 1, c] * part
            out[c] = below + (above - below) * q
    else:
        for c in range(out.size):
            out[c] = values[j, i, c] * (1.0 - part) + values[j, i + 1, c] * part


@njit(cache=True)
def _columns(share, pressure, values, pressures, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    steps = values.shape[1] - 1
    for k in range(share.size):
        i, part, j, q = cell(share[k], steps, pressures, pressure[k])
        _row(values, i, part, j, q, out[k])


@njit(cache=True, error_model="numpy")
def _lagged(step, previous, velocity, pressure, tau, twice, values, pressures, bend, reach, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    steps, width = values.shape[1] - 1, values.shape[2]
    state, last, now, second = np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width)
    dt, decay = 0.0, 1.0
    for k in range(velocity.size):
        if k == 0 or step[k] <= 0.0:
            i, part, j, q = place(pressures, bend, reach, steps, velocity[k], pressure[k])
            _row(values, i, part, j, q, now)
            for c in range(width):
                state[c] = second[c] = last[c] = out[k, c] = now[c]
            continue
        count = substeps(previous[k], velocity[k], bend)
        if step[k] / count != dt:
            dt = step[k] / count
            decay = np.exp(-dt / tau)
        for s in range(1, count + 1):
            v = previous[k] + (velocity[k] - previous[k]) * s / count
            i, part, j, q = place(pressures, bend, reach, steps, v, pressure[k])
            _row(values, i, part, j, q, now)
            _lag(state, second, last, now, dt, tau, decay, twice)
        for c in range(width):
            out[k, c] = second[c] if twice else state[c]
