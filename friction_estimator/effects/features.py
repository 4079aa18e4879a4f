"""What regressors see of a recording, computed causally: batch and sample by sample give the same numbers."""

from dataclasses import dataclass, fields, replace

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.intake.kinks import KINK
from friction_estimator.core.intake.strokes import reaches
from friction_estimator.core.sample import Floats, Ints, Samples


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
    top_speed_m_s : largest speed, m/s. slow_share : of it, which a hundredth of the moving samples do not reach.
    force_rms_N : rms of the measured friction, N.
    force_top_N : largest force of the fitted base model, N.
    pressure_mean_Pa, pressure_span_Pa : mean and range of gauge pressure, Pa.
    sign_velocity_m_s : v_s of the smooth sign.
    pressure_levels : number of tenths of that range in which at least 2 % of the samples lie.
    periods_s : periods of the drive found, s.
    channels : recorded channels beyond velocity and friction.
    longest_piece_s : longest time without a gap, s; 0 where it is not known.
    motion : "linear" or "rotary"; "" where it is not known.
    held : for each recording its samples in use, forward and backward; empty where it is not known.
    theory_told : whether the record tells the theory's parts of the friction from the rest.
    blurred_m : way that the noise of the velocity makes in a sample, m; 0 where the velocity is not noisy.
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
    longest_piece_s: float = 0.0
    motion: str = ""
    held: tuple[tuple[int, int], ...] = ()
    theory_told: bool = True
    blurred_m: float = 0.0
    slow_share: float = 0.0


@dataclass(frozen=True, eq=False)
class Features:
    """Samples as regressors take them, arrays of one length. What is made of them may be kept by them, weakly.

    Attributes
    ----------
    time_s : recorded time since the first sample of all; gaps and pauses are in it.
    step_s : time to the previous sample; 0 where the delay lines restart.
    velocity_m_s, previous_m_s : velocity at this sample and at the one before.
    acceleration_m_s2 : slope at the sample of the parabola through it and the two before, whatever their steps; after a
        kink of the velocity that of the line through it and the one before.
    pressure_Pa : gauge pressure. temperature_degC : degree Celsius.
    position_m : recorded, else the integral of the velocity.
    distance_m : distance run since the first sample.
    since_reversal_m, since_reversal_s : distance and time since the last reversal, noise about zero not counted as one.
    direction : -1, 0 (not moved yet) or 1.
    force_N : force of the fitted base model, its FIR included, in a joint fit that of other effects, too; zeros until a
        reference is known.
    active_time_s : running time, in which a gap or pause counts as one sample period.
    piece : number of the gap-free piece, from 0. recording : number of the recording, from 0; each may have an origin
        of position and of phase of its own. A live node has one recording.
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
    active_time_s: Floats
    piece: Ints
    recording: Ints

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(self.time_s.size)

    def with_force(self, force_N: Floats) -> "Features":
        """Return the features with the force of a base model."""
        return replace(self, force_N=force_N)

    def __getitem__(self, part: slice) -> "Features":
        return Features(*(getattr(self, f.name)[part] for f in fields(self)))


(
    BEFORE,
    BEFORE_THAT,
    STAMP,
    POSITION,
    DISTANCE,
    RUN_M,
    RUN_S,
    WAY,
    SAMPLES,
    SIDE,
    NEW_M,
    NEW_S,
    ACTIVE,
    USUAL_STEP,
    PIECES,
    BENT,
    BENT_BEFORE,
) = range(17)
"""Places in the state: the last two velocities, the last stamp, position, distance, distance and time since the last
reversal, direction now, samples since a restart, direction of the stroke, distance and time since what may be a
reversal, running time, the last step, pieces, and the last two curvatures."""

STATE = 17


@njit(cache=True)
def _features(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    stamp_s,
    velocity,
    restart,
    level,
    state,
    step,
    previous,
    acceleration,
    position,
    distance,
    run_m,
    run_s,
    way,
    active,
    piece,
):
    """Fill the features.

    A change of sign may be a reversal or noise. Until the velocity reaches `level` on the new side both counts go
    on, and each sample shows that of the side it is on: so the first samples of a stroke are known at once, and
    nothing is forgotten where velocity goes back.
    """
    for k in range(velocity.size):
        v = velocity[k]
        if restart[k] or state[SAMPLES] == 0.0:
            state[BEFORE] = v
            state[BEFORE_THAT] = v
            state[STAMP] = stamp_s[k]
            state[SAMPLES] = 0.0
            if state[SIDE] == 0.0:
                state[RUN_M] = np.inf
                state[RUN_S] = np.inf
            if state[PIECES] > 0.0:
                state[ACTIVE] += state[USUAL_STEP]
            state[PIECES] += 1.0
        dt = stamp_s[k] - state[STAMP]
        v1 = state[BEFORE]
        if dt > 0.0:
            if state[SAMPLES] >= 2.0:
                last = state[USUAL_STEP]
                slope, slope_before = (v - v1) / dt, (v1 - state[BEFORE_THAT]) / last
                bent = (slope - slope_before) / (dt + last)
                acceleration[k] = slope
                # A parabola that reaches over a kink would overshoot by half of it.
                if state[SAMPLES] < 4.0 or abs(bent) <= KINK * abs(state[BENT_BEFORE]):
                    acceleration[k] += dt * bent
                state[BENT_BEFORE] = state[BENT]
                state[BENT] = bent
            else:
                acceleration[k] = (v - v1) / dt
            state[ACTIVE] += dt
            state[USUAL_STEP] = dt
        else:
            acceleration[k] = 0.0
        step[k] = dt
        previous[k] = v1
        turned = v != 0.0 and state[WAY] != 0.0 and (v > 0.0) != (state[WAY] > 0.0)
        if v1 * v < 0.0:
            part = v1 / (v1 - v)
            before = 0.5 * abs(v1) * dt * part
            after_m, after_s = 0.5 * abs(v) * dt * (1.0 - part), dt * (1.0 - part)
            moved = before + after_m
        else:
            moved = 0.5 * abs(v1 + v) * dt
            after_m, after_s = moved, dt
        state[DISTANCE] += moved
        state[RUN_M] += moved
        state[RUN_S] += dt
        if v > 0.0:
            state[WAY] = 1.0
        elif v < 0.0:
            state[WAY] = -1.0
        told = dt > 0.0 and reaches(v1, v, level)
        if state[SIDE] != 0.0 and state[WAY] != state[SIDE]:
            if turned:
                state[NEW_M], state[NEW_S] = after_m, after_s
            else:
                state[NEW_M] += moved
                state[NEW_S] += dt
            if told:
                state[SIDE], state[RUN_M], state[RUN_S] = state[WAY], state[NEW_M], state[NEW_S]
            run_m[k], run_s[k] = state[NEW_M], state[NEW_S]
        else:
            if told:
                state[SIDE] = state[WAY]
            run_m[k], run_s[k] = state[RUN_M], state[RUN_S]
        state[POSITION] += 0.5 * (v1 + v) * dt
        position[k] = state[POSITION]
        distance[k] = state[DISTANCE]
        way[k] = state[WAY]
        active[k] = state[ACTIVE]
        piece[k] = np.int64(state[PIECES]) - 1
        state[BEFORE_THAT] = v1
        state[BEFORE] = v
        state[STAMP] = stamp_s[k]
        state[SAMPLES] += 1.0


class FeatureMaker:
    """Make features of consecutive pieces of a recording.

    Parameters
    ----------
    ambient_pressure, default_pressure : Pa; taken off the recorded absolute pressure, and the gauge pressure that holds
        where none is recorded.
    default_temperature : degree Celsius.
    reversal_speed : speed that both strokes about a reversal reach (see `core.intake.strokes`), m/s.
    """

    def __init__(
        self, ambient_pressure: float, default_pressure: float, default_temperature: float, reversal_speed: float = 0.0
    ) -> None:
        self._ambient = ambient_pressure
        self._pressure = default_pressure
        self._temperature = default_temperature
        self._reversal_speed = reversal_speed
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
        step, previous, acceleration, position, distance, run_m, run_s, way, active = (np.zeros(n) for _ in range(9))
        piece = np.zeros(n, np.int64)
        _features(
            time,
            samples.velocity_m_s,
            samples.restart,
            self._reversal_speed,
            self._state,
            step,
            previous,
            acceleration,
            position,
            distance,
            run_m,
            run_s,
            way,
            active,
            piece,
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
            active,
            piece,
            np.zeros(n, np.int64),
        )


def _held(values: Floats | None, n: int, default: float) -> Floats:
    if values is None:
        return np.full(n, default)
    return np.asarray(np.where(np.isfinite(values), values, default))


def stroke_ends(position_m: Floats, recording: Ints) -> tuple[float, float]:
    """Return the ends of the longest stroke of a recording, m: encoders may have another origin in each.

    `recording` : (n,), number of the recording of each sample, increasing.
    """
    first = np.flatnonzero(np.diff(recording, prepend=-1))
    low, high = np.minimum.reduceat(position_m, first), np.maximum.reduceat(position_m, first)
    longest = int(np.argmax(high - low))
    return float(low[longest]), float(high[longest])
