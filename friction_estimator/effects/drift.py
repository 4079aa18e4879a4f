"""Slow and sudden changes with time and distance."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import SLOW, Effect, Key, Params, Words, chosen, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import STRAIGHT
from friction_estimator.effects.reference import BOUNDARY, VISCOUS, Reference
from friction_estimator.effects.trace import Trace

CHANGE_POINTS = 24
EDGE = 0.005
"""Of the recording: a step so near to an end changes too few samples to be one."""


@effect
class SensorDrift(Effect):
    """b(t) slow."""

    name = "sensor_drift"
    family = "slow_bias"
    stage = "sensor"
    acts = SLOW
    keys = (
        Key("total", "N", 0.3, -1e6, 1e6, "drift over the whole recording"),
        form_key("fast at first: as 1 - exp(-3 t / duration)"),
    )
    size_key = "total"
    systematic: ClassVar[Mapping[str, float]] = {"total": 0.04}
    words = Words(
        "the zero of the force sensor drifts",
        "the mean residual of each cycle moves slowly with time",
        {
            "bias_step": "rest periods: read the zero in each of them",
            "viscosity_drift": "rest periods: a drifting zero shows there, a warming oil does not",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the drift."""
        part = trace.time_s / trace.time_s[-1]
        if self["form"] >= 0.5:
            part = (1.0 - np.exp(-3.0 * part)) / (1.0 - np.exp(-3.0))
        return trace.with_friction(trace.friction_N + self["total"] * part)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """A cubic in time over the recording."""
        return chosen([context.duration_s], "duration")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return powers of t / duration."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            part = f.time_s / params["duration"]
            return np.column_stack([part, part**2, part**3])

        return Columns(compute, 3)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Total drift in N."""
        return {"total": (float(np.sum(weights)), "N")}

    signs = (0, 0, 0)


@effect
class ViscosityDrift(Effect):
    """Oil warms, the viscous part falls."""

    name = "viscosity_drift"
    family = "slow_gain"
    stage = "lubrication"
    acts = SLOW
    keys = (
        Key("drop", "", 0.2, 0.0, 0.95, "share of the viscosity that is lost in the end"),
        Key("time_constant", "s", 40.0, 0.01, 1e6, "time constant of warming"),
        form_key("two time constants, 0.6 and 1.4 of it"),
    )
    size_key = "drop"
    turns = True
    linear = False
    systematic: ClassVar[Mapping[str, float]] = {"drop": 0.04, "time_constant": 0.1}
    words = Words(
        "the oil warms and its viscosity falls",
        "the slope of friction at high speed falls with time",
        {
            "wear": "distance instead of time: run the same distance slower; after rest a warm oil recovers",
            "gain_step": "compare low and high speed: only the viscous part falls",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Lower the viscosity."""
        rise = trace.time_s / self["time_constant"]
        done = _settled(rise, self["form"])
        return replace(trace, viscosity_factor=trace.viscosity_factor * (1.0 - self["drop"] * done))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Time constants from a twelfth of the recording to twice its length."""
        return chosen(context.duration_s * np.array([1 / 12, 1 / 6, 1 / 3, 2 / 3, 2.0]), "time_constant")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -dF/dln(viscosity) (1 - exp(-t / tau))."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            done = 1.0 - np.exp(-f.time_s / params["time_constant"])
            return -done * r.part(VISCOUS, f.velocity_m_s, f.pressure_Pa)

        return Columns(compute, filtered=True)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Drop and time constant."""
        return {"drop": (1.0 - float(np.exp(-weights[0])), ""), "time_constant": (params["time_constant"], "s")}

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never beyond twice the recording: a longer one is a straight line, and so is that."""
        return (value / 2.5, min(value * 2.5, STRAIGHT * context.duration_s))

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Beyond twice the recording only its start is seen, and its end is invented."""
        if params["time_constant"] > STRAIGHT * context.duration_s * (1.0 + 1e-6):
            return f"its time constant of {params['time_constant']:.3g} s is beyond twice the recording"
        return None

    signs = (1,)
    refined = ("time_constant",)


@effect
class Wear(Effect):
    """Boundary level changes with distance run."""

    name = "wear"
    family = "slow_gain"
    stage = "lubrication"
    acts = SLOW
    keys = (
        Key("change", "", 0.2, -0.9, 10.0, "relative change of the boundary friction coefficient in the end"),
        Key("length", "m", 2.0, 1e-6, 1e9, "distance over which it happens"),
        form_key("two lengths, 0.6 and 1.4 of it"),
    )
    size_key = "change"
    turns = True
    reveals = "distance_m"
    systematic: ClassVar[Mapping[str, float]] = {"change": 0.12, "length": 0.5}
    words = Words(
        "the seal wears or runs in: the boundary (Coulomb) level changes with the distance run",
        "the low-speed plateau moves with distance, not with time, and stays after rest",
        {
            "viscosity_drift": "run the same time slower: wear follows the distance and stays after rest",
            "gain_step": "a longer recording: wear goes on, a step does not",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Change the boundary coefficient."""
        run = trace.distance_m / self["length"]
        done = _settled(run, self["form"])
        return replace(trace, boundary_factor=trace.boundary_factor * (1.0 + self["change"] * done))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Lengths from a twelfth of the distance run to twice it."""
        return chosen(context.distance_m * np.array([1 / 12, 1 / 6, 1 / 3, 2 / 3, 2.0]), "length")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return dF/dln(mu_b) (1 - exp(-s / L))."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            done = 1.0 - np.exp(-f.distance_m / params["length"])
            return done * r.part(BOUNDARY, f.velocity_m_s, f.pressure_Pa)

        return Columns(compute, filtered=True)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Relative change and length."""
        return {"change": (float(weights[0]), ""), "length": (params["length"], "m")}

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never beyond twice the distance run: a longer one is a straight line, and so is that."""
        return (value / 2.5, min(value * 2.5, STRAIGHT * context.distance_m))

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Beyond twice the distance run only its start is seen, and its end is invented."""
        if params["length"] > STRAIGHT * context.distance_m * (1.0 + 1e-6):
            return f"its length of {params['length']:.3g} m is beyond twice the distance run"
        return None

    refined = ("length",)


@effect
class BiasStep(Effect):
    """b 1(t > t0)."""

    name = "bias_step"
    family = "slow_bias"
    stage = "sensor"
    acts = SLOW
    keys = (
        Key("step", "N", 0.3, -1e6, 1e6, "jump of the zero"),
        Key("at", "s", 30.0, 0.0, 1e9, "time of the jump"),
        form_key("over half a second instead of at once"),
    )
    size_key = "step"
    systematic: ClassVar[Mapping[str, float]] = {"step": 0.01, "at": 0.005}
    words = Words(
        "the zero of the force sensor jumped (it was re-zeroed or knocked)",
        "the mean residual of the cycles jumps once",
        {
            "sensor_drift": "the change point: look at single cycles around it",
            "sensor_bias": "record before the sensor was touched",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the jump."""
        return trace.with_friction(trace.friction_N + self["step"] * _after(trace, self["at"], self["form"]))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Change points evenly over the recording."""
        return chosen(_change_points(context), "at")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return 1(t > t0)."""
        return Columns(lambda f, _r, _s: (f.time_s >= params["at"]).astype(np.float64))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Step in N and its time."""
        return {"step": (float(weights[0]), "N"), "at": (params["at"], "s")}

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """To the neighbouring change points; a step at the very start is a bias, one at the very end a few samples."""
        return _about(value, context)

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Change points evenly over the samples, which a pause holds none of, and closer to both ends."""
        return chosen(_recorded_change_points(features), "at")

    refined = ("at",)
    steps = ("at",)


@effect
class GainStep(Effect):
    """F (1 + g 1(t > t0))."""

    name = "gain_step"
    family = "gain"
    stage = "mechanics"
    acts = SLOW
    keys = (
        Key("step", "", 0.1, -0.9, 10.0, "relative jump of the friction"),
        Key("at", "s", 30.0, 0.0, 1e9, "time of the jump"),
        form_key("over half a second instead of at once"),
    )
    size_key = "step"
    turns = True
    systematic: ClassVar[Mapping[str, float]] = {"step": 0.02, "at": 0.005}
    words = Words(
        "friction jumped as a whole (seal damaged, sensor's gain changed)",
        "the amplitude of the cycles jumps once",
        {
            "wear": "a longer recording: a step happens once",
            "pressure_dependence": "return to the first pressure: a damaged seal does not recover",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Scale after the jump."""
        return trace.with_friction(trace.friction_N * (1.0 + self["step"] * _after(trace, self["at"], self["form"])))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Change points evenly over the recording."""
        return chosen(_change_points(context), "at")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return F 1(t > t0)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            return f.force_N * (f.time_s >= params["at"])

        return Columns(compute)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Relative step and its time."""
        return {"step": (float(weights[0]), ""), "at": (params["at"], "s")}

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """To the neighbouring change points; a step at the very start is a bias, one at the very end a few samples."""
        return _about(value, context)

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Change points evenly over the samples, which a pause holds none of, and closer to both ends."""
        return chosen(_recorded_change_points(features), "at")

    refined = ("at",)
    steps = ("at",)


def _change_points(context: Context) -> Floats:
    return np.asarray(context.duration_s * np.arange(1, CHANGE_POINTS) / CHANGE_POINTS)


def _recorded_change_points(features: Features) -> Floats:
    """Return the times of samples that part the record evenly, finer in the first and last part."""
    edge = np.array([0.25, 0.5]) / CHANGE_POINTS
    parts = np.concatenate([edge, np.arange(1, CHANGE_POINTS) / CHANGE_POINTS, 1.0 - edge[::-1]])
    return np.asarray(features.time_s[(parts * (features.size - 1)).astype(np.int64)])


def _about(value: float, context: Context) -> tuple[float, float]:
    """Return the range in which the time of a step is sought."""
    reach = context.duration_s / CHANGE_POINTS
    edge = EDGE * context.duration_s
    return (min(max(edge, value - reach), value), max(min(context.duration_s - edge, value + reach), value))


def _after(trace: Trace, at: float, form: float) -> Floats:
    if form >= 0.5:
        return np.clip((trace.time_s - at) / 0.5 + 0.5, 0.0, 1.0)
    return (trace.time_s >= at).astype(np.float64)


def _settled(ratio: Floats, form: float) -> Floats:
    """Return 1 - exp(-ratio), or the mean of it for 0.6 and 1.4 of the constant."""
    if form >= 0.5:
        return np.asarray(1.0 - 0.5 * (np.exp(-ratio / 0.6) + np.exp(-ratio / 1.4)))
    return np.asarray(1.0 - np.exp(-ratio))
