"""Sudden changes with time."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import SLOW, Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import chosen
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.trace import Trace

CHANGE_POINTS = 24
EDGE = 0.005
"""Of the recording: a step so near to an end changes too few samples to be one."""


ENDS = 0.02
"""Share of the record that must lie before and after a step."""


class Step(Effect):
    """A jump at the time `at`."""

    acts = SLOW
    size_key = "step"
    refined = ("at",)
    steps = ("at",)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Change points evenly over the recording."""
        return chosen(context.duration_s * np.arange(1, CHANGE_POINTS) / CHANGE_POINTS, "at")

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """The jump and its time."""
        return {"step": (float(weights[0]), cls.keys[0].unit), "at": (params["at"], "s")}

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """To the neighbouring change points; a step at the very start is a bias, one at the very end a few samples."""
        reach = context.duration_s / CHANGE_POINTS
        edge = EDGE * context.duration_s
        return (min(max(edge, value - reach), value), max(min(context.duration_s - edge, value + reach), value))

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Change points evenly over the samples, which a pause holds none of, and closer to both ends."""
        edge = np.array([0.25, 0.5]) / CHANGE_POINTS
        parts = np.concatenate([edge, np.arange(1, CHANGE_POINTS) / CHANGE_POINTS, 1.0 - edge[::-1]])
        return chosen(features.time_s[(parts * (features.size - 1)).astype(np.int64)], "at")

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Not at the very start or end, where a step is a bias or another curve of the first strokes."""
        at = params["at"]
        if ENDS * context.duration_s <= at <= (1.0 - ENDS) * context.duration_s:
            return None
        return f"a step {at:.3g} s into a record of {context.duration_s:.3g} s has no length before or after it"


@effect
class BiasStep(Step):
    """A zero of the force sensor that jumps.

    Formula::

        f = F + step 1(t >= at)
    """

    name = "bias_step"
    family = "slow_bias"
    stage = "sensor"
    keys = (
        Key("step", "N", 0.3, -1e6, 1e6, "jump of the zero"),
        Key("at", "s", 30.0, 0.0, 1e9, "time of the jump"),
        form_key("over half a second instead of at once"),
    )
    systematic: ClassVar[Mapping[str, float]] = {"step": 0.01, "at": 0.005}
    words = Words(
        "the zero of the {force} sensor jumped (it was re-zeroed or knocked)",
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
    def columns(cls, params: Params) -> Columns:
        """Return 1(t > t0)."""
        return Columns(lambda f, _r, _s: (f.time_s >= params["at"]).astype(np.float64))


@effect
class GainStep(Step):
    """Friction that jumps as a whole.

    Formula::

        f = F (1 + step 1(t >= at))
    """

    name = "gain_step"
    family = "gain"
    stage = "mechanics"
    keys = (
        Key("step", "", 0.1, -0.9, 10.0, "relative jump of the friction"),
        Key("at", "s", 30.0, 0.0, 1e9, "time of the jump"),
        form_key("over half a second instead of at once"),
    )
    turns = True
    systematic: ClassVar[Mapping[str, float]] = {"step": 0.02, "at": 0.005}
    words = Words(
        "friction jumped as a whole (something damaged, sensor's gain changed)",
        "the amplitude of the cycles jumps once",
        {
            "wear": "a longer recording: a step happens once",
            "pressure_dependence": "return to the first pressure: what is damaged does not recover",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Scale after the jump."""
        return trace.with_friction(trace.friction_N * (1.0 + self["step"] * _after(trace, self["at"], self["form"])))

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return F 1(t > t0)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            return f.force_N * (f.time_s >= params["at"])

        return Columns(compute, of_force=True)


def _after(trace: Trace, at: float, form: float) -> Floats:
    if form >= 0.5:
        return np.clip((trace.time_s - at) / 0.5 + 0.5, 0.0, 1.0)
    return (trace.time_s >= at).astype(np.float64)
