"""Third functional forms of ten effects: what nature could do and no class of the package does.

They live here only, are not registered, and nothing in friction_estimator/ was tuned on them. Each keeps keys, stage
and id of its effect; only what it does to the signals differs.
"""
# ruff: noqa: ARG002 - apply has the arguments of Effect.apply

from dataclasses import replace

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.effects import EFFECTS, Effect, Trace
from friction_estimator.effects.kernels import maxwell, play, rest_spike


def _steps(trace: Trace):
    """Return the time steps (0 first) and the velocities before."""
    step = np.full(trace.time_s.size, trace.step_s)
    step[0] = 0.0
    return step, np.concatenate([trace.velocity_m_s[:1], trace.velocity_m_s[:-1]])


def _since_reversal(trace: Trace):
    """Return the distance run since the velocity last changed its sign, (n,), m; a long way before the first."""
    sign = np.sign(trace.velocity_m_s)
    moving = np.where(sign != 0.0, np.arange(sign.size), -1)
    last = np.maximum.accumulate(moving)
    held = np.where(last >= 0, sign[np.maximum(last, 0)], 0.0)
    turn = np.flatnonzero((held[1:] != held[:-1]) & (held[:-1] != 0.0)) + 1
    run = np.cumsum(np.abs(trace.velocity_m_s)) * trace.step_s
    start = np.full(sign.size, -1e9)
    start[turn] = run[turn - 1]
    return run - np.maximum.accumulate(start), held


class PowerLawPresliding(EFFECTS["presliding"]):
    """Friction builds up as a power of the distance: -2 sgn(v) / (1 + d_rev/L)^2."""

    def apply(self, trace: Trace, rng) -> Trace:
        distance, way = _since_reversal(trace)
        return trace.with_friction(
            trace.friction_N - 2.0 * self["amplitude"] * way / np.square(1.0 + distance / self["length"])
        )


class GaussianBreakaway(EFFECTS["breakaway"]):
    """The spike falls as a Gaussian of the distance and grows with the cube root of the dwell."""

    def apply(self, trace: Trace, rng) -> Trace:
        step, before = _steps(trace)
        height = np.empty(step.size)
        rest_spike(step, before, trace.velocity_m_s, 1e30, self["rest_speed"], 1.0 / 3.0, np.zeros(4), height)
        distance, _ = _since_reversal(trace)
        shape = np.exp(-np.square(distance / self["length"])) / 0.1 ** (1.0 / 3.0)
        return trace.with_friction(trace.friction_N + self["amplitude"] * height * shape)


class SpringyBacklash(EFFECTS["backlash"]):
    """The last four tenths of the gap are springy: friction comes back in a ramp."""

    def apply(self, trace: Trace, rng) -> Trace:
        step, before = _steps(trace)
        if self["gap"] <= 0.0:
            return trace
        lost = np.zeros(step.size)
        parts = np.linspace(0.6, 1.0, 9)
        for part in parts:
            out = np.empty(step.size)
            play(step, before, trace.velocity_m_s, part * self["gap"], np.zeros(2), out)
            lost += out / parts.size
        return trace.with_friction(trace.friction_N * (1.0 - lost))


class ButterworthLowpass(EFFECTS["sensor_lowpass"]):
    """A Butterworth filter of second order with the delay of the time constant at low frequency."""

    def apply(self, trace: Trace, rng) -> Trace:
        from scipy.signal import lfilter, lfilter_zi  # noqa: PLC0415 - slow to import

        tau = self["time_constant"]
        if tau <= 0.0:
            return trace
        # H = 1 / (1 + tau s + tau^2 s^2 / 2): its delay at rest is tau. Tustin: s = 2/dt (1 - z)/(1 + z).
        w = 2.0 * tau / trace.step_s
        a = np.array([1.0 + w + 0.5 * w * w, 2.0 - w * w, 1.0 - w + 0.5 * w * w])
        b = np.array([1.0, 2.0, 1.0]) / a[0]
        a = a / a[0]
        out, _ = lfilter(b, a, trace.friction_N, zi=lfilter_zi(b, a) * trace.friction_N[0])
        return trace.with_friction(out)


class UnevenFrictionalLag(EFFECTS["frictional_lag"]):
    """The film thickens in half the time and thins in one and a half."""

    def apply(self, trace: Trace, rng) -> Trace:
        if self["lag"] <= 0.0:
            return trace
        out = np.empty_like(trace.film_speed_m_s)
        _uneven_lag(trace.film_speed_m_s, trace.step_s / (0.5 * self["lag"]), trace.step_s / (1.5 * self["lag"]), out)
        return replace(trace, film_speed_m_s=out)


class CubicSqueezeFilm(EFFECTS["squeeze_film"]):
    """-A a / (1 + |v / v_f|^3)."""

    def apply(self, trace: Trace, rng) -> Trace:
        share = 1.0 / (1.0 + np.abs(trace.velocity_m_s / self["speed"]) ** 3)
        return trace.with_friction(trace.friction_N - self["amplitude"] * trace.acceleration_m_s2 * share)


class BroadRelaxation(EFFECTS["viscoelastic_relaxation"]):
    """A spectrum of three Maxwell elements over a factor of six in time."""

    def apply(self, trace: Trace, rng) -> Trace:
        step, before = _steps(trace)
        force = np.zeros(step.size)
        for factor, share in ((0.4, 0.3), (1.0, 0.4), (2.5, 0.3)):
            out = np.empty(step.size)
            maxwell(step, before, trace.velocity_m_s, factor * self["time_constant"], np.zeros(1), out)
            force += share * out
        return trace.with_friction(trace.friction_N + self["stiffness"] * force)


class HyperbolicWear(EFFECTS["wear"]):
    """The boundary coefficient changes as s / (s + L)."""

    def apply(self, trace: Trace, rng) -> Trace:
        run = trace.distance_m / self["length"]
        done = run / (1.0 + run)
        return replace(trace, boundary_factor=trace.boundary_factor * (1.0 + self["change"] * done))


class SlowingWarming(EFFECTS["viscosity_drift"]):
    """Warming that slows down as heat leaks: 1 - 1 / sqrt(1 + 2 t / tau)."""

    def apply(self, trace: Trace, rng) -> Trace:
        done = 1.0 - 1.0 / np.sqrt(1.0 + 2.0 * trace.time_s / self["time_constant"])
        return replace(trace, viscosity_factor=trace.viscosity_factor * (1.0 - self["drop"] * done))


class LowSpeedAsymmetry(EFFECTS["direction_asymmetry"]):
    """The directions differ at low speed only, as where one lip edge is worn."""

    def apply(self, trace: Trace, rng) -> Trace:
        speed = np.abs(trace.velocity_m_s)
        half = 0.5 * self["asymmetry"] * np.sign(trace.velocity_m_s) * np.exp(-speed / (0.3 * speed.max()))
        return trace.with_friction(trace.friction_N * (1.0 + half))


THIRD: dict[str, type[Effect]] = {
    cls.name: cls
    for cls in (
        PowerLawPresliding,
        GaussianBreakaway,
        SpringyBacklash,
        ButterworthLowpass,
        UnevenFrictionalLag,
        CubicSqueezeFilm,
        BroadRelaxation,
        HyperbolicWear,
        SlowingWarming,
        LowSpeedAsymmetry,
    )
}
"""Effect id -> its third form."""


@njit(cache=True)
def _uneven_lag(signal, rise, fall, out):
    """Fill `out`: y += share (x - y), the share that of rising or of falling, started in equilibrium."""
    up, down = 1.0 - np.exp(-rise), 1.0 - np.exp(-fall)
    y = signal[0]
    for k in range(signal.size):
        y += (up if signal[k] > y else down) * (signal[k] - y)
        out[k] = y
