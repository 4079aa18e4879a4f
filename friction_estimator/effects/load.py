"""Gravity, and friction that grows with the load: what a joint that turns a weight has (columns: `core.model.load`)."""

import math

import numpy as np

from friction_estimator.core.model.load import LOADS
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key, Params, Stated, Words, effect
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import chosen
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.trace import Trace

LEAST_TURN_RAD = 1.0
"""Range of the position below which neither is proposed: there gravity is a spring and a bias, and a linear rig, whose
position is in metres, has none."""

ANGLES = 8
"""Angles at which the weight may hang straight down, over half a turn."""

SIGN_SHARE = 60.0
"""The simulated friction turns its sign within the top speed over this, as in a record without a theory."""


def _turns(context: Context) -> bool:
    """Whether the shaft turns, and far enough."""
    return context.motion != LINEAR and context.stroke_m >= LEAST_TURN_RAD


@effect
class Gravity(Effect):
    """The weight of what a joint turns.

    Formula::

        f = F + torque sin(q - angle)

    q is the position in rad, and torque is mass times g times lever.
    """

    name = "gravity"
    family = "spring"
    stage = "mechanics"
    keys = (
        Key("torque", "N", 1.0, 0.0, 1e9, "largest torque of the weight, m g l"),
        Key("angle", "rad", 0.0, -math.pi, math.pi, "position at which the weight hangs straight down"),
    )
    size_key = "torque"
    rotary = True
    reveals = "position_m"
    words = Words(
        "the measured {force} also carries a weight whose share follows the position",
        "the residual follows the sine of the position, the same at every speed and in both directions",
        {
            "side_spring": "a larger stroke: a spring grows on, a weight does not",
            "sensor_bias": "a larger stroke: a bias is the same everywhere",
            "inertia": "a second period: inertia grows with 1/T^2, a weight does not change",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the weight's torque."""
        return trace.with_friction(trace.friction_N + self["torque"] * np.sin(trace.position_m - self["angle"]))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Sine and cosine, where the shaft turns far enough."""
        return [{}] if _turns(context) else []

    @classmethod
    def columns(cls, params: Params) -> Columns:  # noqa: ARG003
        """Return sin q and cos q."""
        load = LOADS["gravity"]
        return Columns(lambda f, _r, _s: load.columns(f, load.keys), len(load.parts))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Largest torque, and where the weight hangs."""
        sin, cos = (float(w) for w in weights)
        return {"torque": (math.hypot(sin, cos), "N"), "angle": (math.atan2(-cos, sin), "rad")}

    signs = (0, 0)


@effect
class LoadDependence(Effect):
    """Friction that grows with the load that a gear or bearing carries.

    Formula::

        f = F + friction |sin(q - angle)| S(v)

    S is a smooth sign of the velocity and q the position in rad.
    """

    name = "load_dependence"
    family = "load"
    stage = "friction"
    turns = True
    rotary = True
    keys = (
        Key("friction", "N", 0.1, 0.0, 1e9, "friction that the largest load adds"),
        Key("angle", "rad", 0.0, -math.pi, math.pi, "position at which the weight hangs straight down, without load"),
    )
    size_key = "friction"
    reveals = "position_m"
    refined = ("angle",)
    words = Words(
        "friction grows with the load that the gear or the bearing carries",
        "the residual in the direction of motion follows the size of the weight's {force} over position",
        {"position_dependence": "take the weight off: what is left belongs to the position"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add friction in proportion to the size of the load."""
        top = float(np.abs(trace.velocity_m_s).max()) or 1.0
        sign = np.tanh(trace.velocity_m_s / (top / SIGN_SHARE))
        load = np.abs(np.sin(trace.position_m - self["angle"]))
        return trace.with_friction(trace.friction_N + self["friction"] * load * sign)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Angles over half a turn, where the shaft turns far enough."""
        angles = np.pi * np.arange(ANGLES) / ANGLES
        return chosen(angles, "angle") if _turns(context) else []

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """To the neighbours of the grid."""
        return (value - np.pi / ANGLES, value + np.pi / ANGLES)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return |sin(q - angle)| S, the load by the columns of gravity."""
        load = LOADS["gravity"]
        turned = np.array([math.cos(params["angle"]), -math.sin(params["angle"])])

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            return np.asarray(np.abs(load.columns(f, load.keys) @ turned) * r.smooth_sign(f.velocity_m_s))

        return Columns(compute)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Friction added by the largest load, and where there is none."""
        return {"friction": (float(weights[0]), "N"), "angle": (params["angle"], "rad")}

    signs = (1,)
