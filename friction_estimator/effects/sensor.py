"""Faults of the force channel: bias, clipping, resolution, held values, spikes, filtering and delay."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import REVERSAL, Columns, Effect, Key, Params, Words, chosen, effect, form_key
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import beyond_time, times
from friction_estimator.effects.kernels import RING, force_delay, force_lag
from friction_estimator.effects.reference import FORCE, Reference
from friction_estimator.effects.trace import Trace


@effect
class SensorBias(Effect):
    """f + b."""

    name = "sensor_bias"
    family = "bias"
    stage = "sensor"
    keys = (Key("bias", "N", 0.2, -1e6, 1e6, "constant added to the force"),)
    size_key = "bias"
    reveals = "velocity_m_s"
    words = Words(
        "the force sensor reads a constant too much or too little (f + b)",
        "the mean residual is not zero, at standstill and at the reversals as well",
        {
            "direction_asymmetry": "look at the samples at standstill: a bias is there, an asymmetry is not",
            "bias_step": "record before and after re-zeroing the sensor: a bias is there from the first sample",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the bias."""
        return trace.with_friction(trace.friction_N + self["bias"])

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """One column."""
        return [{}]

    @classmethod
    def columns(cls, params: Params) -> Columns:  # noqa: ARG003
        """Return the constant 1."""
        return Columns(lambda f, _r, _s: np.ones(f.size))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Bias in N."""
        return {"bias": (float(weights[0]), "N")}


@effect
class Saturation(Effect):
    """Clipped at +-level."""

    name = "saturation"
    family = "range"
    stage = "sensor"
    detects_at = "force"
    figure = "histogram"
    keys = (
        Key("level", "N", 5.0, 1e-9, 1e9, "largest force that the channel shows"),
        form_key("soft: f (1 + (|f|/level)^8)^(-1/8), as an amplifier near its rail"),
    )
    size_key = "level"
    linear = False
    reveals = "force_N"
    systematic: ClassVar[Mapping[str, float]] = {"level": 0.25}
    words = Words(
        "the force channel clips: values beyond its range are cut",
        "a flat top in the force, values pile up at one level",
        {
            "pressure_dependence": "look at the histogram of the force: clipping piles values up at one level",
            "direction_asymmetry": "widen the sensor's range",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Clip."""
        force, level = trace.friction_N, self["level"]
        if self["form"] >= 0.5:
            return trace.with_friction(force / (1.0 + np.abs(force / level) ** 8) ** 0.125)
        return trace.with_friction(np.clip(force, -level, level))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Levels from half the largest force upwards."""
        return chosen(context.force_top_N * np.linspace(0.5, 0.98, 13), "level")

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A level that the force never reaches clips nothing."""
        if params["level"] > context.force_top_N:
            return f"its level of {params['level']:.3g} N is above every force of the model"
        return None

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -sgn(F) max(|F| - level, 0)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            force = f.force_N
            return -np.sign(force) * np.maximum(np.abs(force) - params["level"], 0.0)

        return Columns(compute)

    signs = (1,)
    refined = ("level",)


@effect
class Quantization(Effect):
    """Values on a lattice."""

    name = "quantization"
    family = "resolution"
    stage = "sensor"
    scatters = True
    detects_at = "force"
    figure = "histogram"
    keys = (
        Key("step", "N", 0.05, 1e-12, 1e6, "distance of neighbouring values"),
        form_key("truncation towards minus infinity instead of rounding"),
    )
    size_key = "step"
    linear = False
    reveals = "force_N"
    words = Words(
        "the force is recorded in coarse steps",
        "the force takes few distinct, equally spaced values",
        {"dropout": "count how long values repeat: a lattice repeats values, a dropout repeats the last one"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Round to the lattice."""
        snap = np.floor if self["form"] >= 0.5 else np.round
        return trace.with_friction(snap(trace.friction_N / self["step"]) * self["step"])


@effect
class Dropout(Effect):
    """Held values."""

    name = "dropout"
    family = "transport"
    stage = "sensor"
    detects_at = "force"
    figure = "time"
    keys = (
        Key("fraction", "", 0.02, 0.0, 0.9, "share of samples that repeat the last good one"),
        Key("length", "samples", 5.0, 1.0, 1e4, "length of a dropout"),
        form_key("lengths geometrically distributed about the mean instead of fixed"),
    )
    size_key = "fraction"
    linear = False
    words = Words(
        "samples were lost and the last value was held",
        "runs of exactly equal force values while the velocity moves on",
        {"quantization": "count how long values repeat"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Hold the value before each dropout."""
        n, length = trace.time_s.size, self["length"]
        # Uniform positions drawn first: a larger fraction then only adds dropouts.
        draws = rng.random(n)
        sizes = rng.geometric(1.0 / length, n) if self["form"] >= 0.5 else np.full(n, round(length))
        force = trace.friction_N.copy()
        for start in np.flatnonzero(draws < self["fraction"] / length):
            if start > 0:
                force[start : start + sizes[start]] = force[start - 1]
        return trace.with_friction(force)


@effect
class Outliers(Effect):
    """Spikes."""

    name = "outliers"
    family = "spikes"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "time"
    keys = (
        Key("amplitude", "N", 5.0, 0.0, 1e9, "height of a spike"),
        Key("fraction", "", 0.0005, 0.0, 0.5, "share of samples hit"),
        form_key("one-sided, of exponentially distributed height"),
    )
    size_key = "amplitude"
    reveals = "time_s"
    words = Words(
        "single samples are far off (electrical interference)",
        "spikes in the residual: heavy tails",
        {"stick_slip": "spikes last one sample and fall anywhere; stick-slip follows the reversals"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add the spikes."""
        n = trace.time_s.size
        count = max(1, round(self["fraction"] * n))
        place = rng.choice(n, count, replace=False)
        height = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        if self["form"] >= 0.5:
            height = 0.5 + 0.5 * rng.exponential(1.0, count)
        force = trace.friction_N.copy()
        force[place] += self["amplitude"] * height
        return trace.with_friction(force)


@effect
class TimeDelay(Effect):
    """f(t - D)."""

    name = "time_delay"
    family = "timing"
    stage = "transmission"
    acts = REVERSAL
    delays = True
    keys = (Key("delay", "s", 1e-3, 0.0, 1.0, "delay of the force behind the velocity"),)
    size_key = "delay"
    turns = True
    linear = False
    reveals = "since_reversal_s"
    systematic: ClassVar[Mapping[str, float]] = {"delay": 0.03}
    words = Words(
        "the force is late: delay of the channel, or stamps taken on arrival",
        "a spike after each reversal that lasts as long at every speed of the drive (e ~ df/dt)",
        {
            "sensor_lowpass": "a sharp step: a delay shifts it, a filter rounds it",
            "presliding": "two periods: a delay is the same time, presliding the same distance",
            "frictional_lag": "speed steps without reversal",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Interpolate cubically on the fine grid: a linear one would smear like a filter."""
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - only the simulation needs it

        when = np.maximum(trace.time_s - self["delay"], trace.time_s[0])
        return trace.with_friction(np.asarray(CubicSpline(trace.time_s, trace.friction_N)(when)))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Delays from 0.02 samples to a quarter of the shortest period."""
        return chosen(times(context), "delay")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return F(t - D) - F(t)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:
            out = np.empty(f.size)
            force_delay(
                f.step_s,
                f.velocity_m_s,
                f.pressure_Pa,
                params["delay"],
                r.tables[FORCE],
                r.pressures_Pa,
                r.bend_m_s,
                r.reach,
                s,
                out,
            )
            return out

        return Columns(compute, state=1 + 2 * RING, filtered=True)

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Neither far below a sample nor a good part of a stroke."""
        return beyond_time("delay", params["delay"], context)

    signs = (1,)
    fixed_gain = True
    refined = ("delay",)


@effect
class SensorLowpass(Effect):
    """Low-pass filtered force."""

    name = "sensor_lowpass"
    family = "timing"
    stage = "transmission"
    acts = REVERSAL
    delays = True
    keys = (
        Key("time_constant", "s", 1e-3, 0.0, 1.0, "time constant of the first-order filter"),
        form_key("two equal poles in series, together of the same delay"),
    )
    size_key = "time_constant"
    turns = True
    linear = False
    reveals = "since_reversal_s"
    systematic: ClassVar[Mapping[str, float]] = {"time_constant": 0.3}
    words = Words(
        "the force channel is low-pass filtered",
        "reversals are smeared over the same time at every speed of the drive",
        {
            "time_delay": "a sharp step: a filter rounds it, a delay shifts it",
            "presliding": "two periods: a filter is the same time, presliding the same distance",
            "squeeze_film": "a second period or stroke",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Filter; exact for a force linear between steps."""
        tau, force = self["time_constant"], trace.friction_N
        if tau <= 0.0:
            return trace
        if self["form"] >= 0.5:
            half = 0.5 * tau
            return trace.with_friction(_lag(_lag(force, trace.step_s, half), trace.step_s, half))
        return trace.with_friction(_lag(force, trace.step_s, tau))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Time constants from 0.02 samples to a quarter of the shortest period."""
        return chosen(times(context), "time_constant")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return LP(F) - F."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:
            out = np.empty(f.size)
            force_lag(
                f.step_s,
                f.previous_m_s,
                f.velocity_m_s,
                f.pressure_Pa,
                params["time_constant"],
                r.tables[FORCE],
                r.pressures_Pa,
                r.bend_m_s,
                r.reach,
                s,
                out,
            )
            return out

        return Columns(compute, state=3, filtered=True)

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Neither far below a sample nor a good part of a stroke."""
        return beyond_time("time constant", params["time_constant"], context)

    signs = (1,)
    fixed_gain = True
    refined = ("time_constant",)


def _lag(force: Floats, step_s: float, tau: float) -> Floats:
    """Return the first-order lag of a force that is linear between its samples, started in equilibrium."""
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to import, only the simulation needs it

    decay = np.exp(-step_s / tau)
    mean = tau / step_s * (1.0 - decay)
    # y[k] = decay y[k-1] + (mean - decay) f[k-1] + (1 - mean) f[k]
    start = np.array([force[0] - (1.0 - mean) * force[0]])
    return np.asarray(lfilter([1.0 - mean, mean - decay], [1.0, -decay], force, zi=start)[0])


@effect
class VelocityNoise(Effect):
    """Errors in v."""

    name = "velocity_noise"
    family = "velocity"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "smoothing"
    keys = (
        Key("deviation", "m/s", 1e-3, 0.0, 1e3, "standard deviation of the noise on the velocity channel"),
        form_key("correlated from sample to sample (moving average of two)"),
    )
    size_key = "deviation"
    linear = False
    reveals = "velocity_m_s"
    words = Words(
        "the velocity channel is noisy",
        "residual variance grows with the slope of the curve, dF/dv; slopes are fitted too flat",
        {"stick_slip": "third difference of the velocity: it is white where the channel is noisy"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add noise to the measured velocity; the force stays."""
        noise = rng.standard_normal(trace.time_s.size + 1)
        noise = (noise[1:] + noise[:-1]) / np.sqrt(2.0) if self["form"] >= 0.5 else noise[1:]
        return replace(trace, velocity_measured_m_s=trace.velocity_measured_m_s + self["deviation"] * noise)

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured velocity."""
        return seen_at(after, after.velocity_measured_m_s) - seen_at(before, before.velocity_measured_m_s)


def seen_at(trace: Trace, velocity_m_s: Floats) -> Floats:
    """Return the friction that the plant would have at another velocity."""
    moved = replace(trace, velocity_m_s=velocity_m_s, film_speed_m_s=np.abs(velocity_m_s))
    return trace.law(moved)
