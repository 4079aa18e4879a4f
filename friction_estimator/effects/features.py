"""What regressors see of a recording, computed causally: batch and sample by sample give the same numbers."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numba import njit

from friction_estimator.core.sample import Floats, Samples


@dataclass(frozen=True)
class Context:
    """Facts about a set of recordings that grids and bounds depend on.

    Attributes
    ----------
    duration_s : length of all recordings together, s.
    step_s : sample period, s.
    distance_m : distance run, m.
    stroke_m : largest range of position, m.
    centre_m : middle of that range, m.
    top_speed_m_s : largest speed, m/s.
    force_rms_N : rms of the measured friction, N.
    force_top_N : largest force of the fitted base model, N.
    pressure_mean_Pa, pressure_span_Pa : mean and range of gauge pressure, Pa.
    sign_velocity_m_s : v_s of the smooth sign.
    pressure_levels : number of tenths of that range in which at least 2 % of the samples lie.
    periods_s : periods of the drive found, s.
    channels : recorded channels beyond velocity and friction.
    """

    duration_s: float
    step_s: float
    distance_m: float
    stroke_m: float
    centre_m: float
    top_speed_m_s: float
    force_rms_N: float
    force_top_N: float
    pressure_mean_Pa: float
    pressure_span_Pa: float
    sign_velocity_m_s: float
    pressure_levels: int = 1
    periods_s: tuple[float, ...] = ()
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Features:
    """Samples as regressors take them, arrays of one length.

    Attributes
    ----------
    time_s : since the first sample of all.
    step_s : time to the previous sample; 0 where the delay lines restart.
    velocity_m_s, previous_m_s : velocity at this sample and at the one before.
    acceleration_m_s2 : backward difference of second order, (3 v[k] - 4 v[k-1] + v[k-2]) / (2 dt).
    pressure_Pa : gauge pressure. temperature_degC : degree Celsius.
    position_m : recorded, else the integral of the velocity.
    distance_m : distance run since the first sample.
    since_reversal_m, since_reversal_s : distance and time since the last reversal.
    direction : -1, 0 (not moved yet) or 1.
    force_N : force of the fitted base model, its FIR included; zeros until a reference is known.
    """

    time_s: Floats
    step_s: Floats
    velocity_m_s: Floats
    previous_m_s: Floats
    acceleration_m_s2: Floats
    pressure_Pa: Floats
    temperature_degC: Floats
    position_m: Floats
    distance_m: Floats
    since_reversal_m: Floats
    since_reversal_s: Floats
    direction: Floats
    force_N: Floats

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time_s.size)

    def with_force(self, force_N: Floats) -> "Features":
        """Return the features with the force of a base model."""
        return replace(self, force_N=force_N)

    def __getitem__(self, part: slice) -> "Features":
        return Features(*(getattr(self, f.name)[part] for f in fields(self)))


STATE = 9


@njit(cache=True)
def _features(stamp_s, velocity, restart, state, step, previous, acceleration, position, distance, run_m, run_s, way):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill the features; state = [v1, v2, last stamp, position, distance, d_rev, t_rev, direction, samples]."""
    for k in range(velocity.size):
        v = velocity[k]
        if restart[k] or state[8] == 0.0:
            state[0] = v
            state[1] = v
            state[2] = stamp_s[k]
            state[8] = 0.0
            if state[7] == 0.0:
                state[5] = np.inf
                state[6] = np.inf
        dt = stamp_s[k] - state[2]
        v1 = state[0]
        if dt > 0.0:
            if state[8] >= 2.0:
                acceleration[k] = (3.0 * v - 4.0 * v1 + state[1]) / (2.0 * dt)
            else:
                acceleration[k] = (v - v1) / dt
        else:
            acceleration[k] = 0.0
        step[k] = dt
        previous[k] = v1
        if v1 * v < 0.0:
            part = v1 / (v1 - v)
            before = 0.5 * abs(v1) * dt * part
            after = 0.5 * abs(v) * dt * (1.0 - part)
            state[5] = after
            state[6] = dt * (1.0 - part)
            state[4] += before + after
        else:
            moved = 0.5 * abs(v1 + v) * dt
            if v != 0.0 and state[7] != 0.0 and (v > 0.0) != (state[7] > 0.0):
                state[5] = moved
                state[6] = dt
            else:
                state[5] += moved
                state[6] += dt
            state[4] += moved
        state[3] += 0.5 * (v1 + v) * dt
        if v > 0.0:
            state[7] = 1.0
        elif v < 0.0:
            state[7] = -1.0
        position[k] = state[3]
        distance[k] = state[4]
        run_m[k] = state[5]
        run_s[k] = state[6]
        way[k] = state[7]
        state[1] = v1
        state[0] = v
        state[2] = stamp_s[k]
        state[8] += 1.0


class FeatureMaker:
    """Make features of consecutive pieces of a recording.

    Parameters
    ----------
    ambient_pressure, default_pressure : Pa; taken off the recorded absolute pressure, and the gauge pressure that holds
        where none is recorded.
    default_temperature : degree Celsius.
    """

    def __init__(self, ambient_pressure: float, default_pressure: float, default_temperature: float) -> None:
        self._ambient = ambient_pressure
        self._pressure = default_pressure
        self._temperature = default_temperature
        self.restart()

    def restart(self) -> None:
        """Forget the past."""
        self._state = np.zeros(STATE)
        self._first_ns: int | None = None

    def __call__(self, samples: Samples) -> Features:
        """Return the features of the next samples."""
        n = len(samples)
        if self._first_ns is None and n:
            self._first_ns = int(samples.stamp_ns[0])
        # Whole nanoseconds are subtracted before they become floating point.
        time: Floats = np.asarray((samples.stamp_ns - (self._first_ns or 0)) * 1e-9, np.float64)
        step, previous, acceleration, position, distance, run_m, run_s, way = (np.zeros(n) for _ in range(8))
        _features(
            time,
            samples.velocity_m_s,
            samples.restart,
            self._state,
            step,
            previous,
            acceleration,
            position,
            distance,
            run_m,
            run_s,
            way,
        )
        pressure: Floats = np.asarray(_held(samples.pressure_Pa, n, self._pressure + self._ambient) - self._ambient)
        temperature = _held(samples.temperature_degC, n, self._temperature)
        if samples.position_m is not None:
            position = np.asarray(np.where(np.isfinite(samples.position_m), samples.position_m, position))
        return Features(
            time,
            step,
            samples.velocity_m_s,
            previous,
            acceleration,
            pressure,
            temperature,
            position,
            distance,
            run_m,
            run_s,
            way,
            np.zeros(n),
        )


def _held(values: Floats | None, n: int, default: float) -> Floats:
    if values is None:
        return np.full(n, default)
    return np.asarray(np.where(np.isfinite(values), values, default))
