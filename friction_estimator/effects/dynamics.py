"""Inertia, springs and relaxation."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.model.load import LOADS
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import below, chosen, geometric, longest_relaxation_s
from friction_estimator.effects.kernels import maxwell
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.trace import Trace

SHORTEST_RELAXATION = 2.0
"""Sample periods: in less a spring in series with a damper only takes away mass, as a film that is squeezed does."""


@effect
class Inertia(Effect):
    """A mass between the force sensor and the friction.

    Formula::

        f = F + mass a
    """

    name = "inertia"
    family = "inertia"
    stage = "mechanics"
    keys = (Key("mass", "kg", 1.0, 0.0, 1e6, "{mass} between the sensor and the friction"),)
    size_key = "mass"
    reveals = "acceleration_m_s2"
    words = Words(
        "the {force} sensor also accelerates a {mass}",
        "the residual is proportional to the acceleration, so it falls with the square of the period",
        {
            "side_spring": "a second period or stroke: inertia grows with 1/T^2, a spring does not change",
            "squeeze_film": "the same acceleration at another speed",
            "viscoelastic_relaxation": "a second period",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add m a."""
        return trace.with_friction(trace.friction_N + self["mass"] * trace.acceleration_m_s2)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """One column."""
        return [{}]

    @classmethod
    def columns(cls, params: Params) -> Columns:  # noqa: ARG003
        """Return a."""
        load = LOADS["inertia"]
        return Columns(lambda f, _r, _s: load.columns(f, load.keys))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Mass in kg."""
        return {"mass": (float(weights[0]), "kg")}

    signs = (1,)


@effect
class SideSpring(Effect):
    """Something elastic beside the friction.

    Formula::

        f = F + stiffness (x - x0)

    x0 is the middle of the stroke.
    """

    name = "side_spring"
    family = "spring"
    stage = "mechanics"
    keys = (
        Key(
            "stiffness",
            "N/m",
            10.0,
            -1e9,
            1e9,
            "stiffness about the middle of the stroke, below 0 for a toggle",
        ),
        form_key("hardening: k x (0.85 + 0.2 (x / half stroke)^2)"),
    )
    size_key = "stiffness"
    reveals = "position_m"
    systematic: ClassVar[Mapping[str, float]] = {"stiffness": 0.01}
    words = Words(
        "something beside the friction is elastic (cable, hose, bellows), or pushes away from the middle "
        "(magnet, toggle)",
        "the residual is proportional to the position, the same at every period",
        {
            "inertia": "a second period or stroke: a spring does not change, inertia grows with 1/T^2",
            "viscoelastic_relaxation": "stop and hold: a spring keeps its {force}",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the spring's force."""
        low, high = float(trace.position_m.min()), float(trace.position_m.max())
        x = trace.position_m - 0.5 * (low + high)
        if self["form"] >= 0.5 and high > low:
            x = x * (0.85 + 0.2 * np.square(2.0 * x / (high - low)))
        return trace.with_friction(trace.friction_N + self["stiffness"] * x)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """One column, about the middle of the stroke."""
        return chosen([context.centre_m], "centre")

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """The middle of each recording's own stroke, where there are several: encoders may have other origins."""
        numbers = np.unique(features.recording)
        if numbers.size < 2:
            return []
        strokes = [features.position_m[features.recording == number] for number in numbers]
        middles = [0.5 * float(x.min() + x.max()) for x in strokes]
        return [{"centre": middles[0]} | {f"centre{k}": middle for k, middle in enumerate(middles) if k}]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return x - centre; a recording beyond those that were fitted has the last centre."""
        load = LOADS["spring"]
        centres = np.array(
            [
                params["centre"],
                *(params[f"centre{k}"] for k in range(1, sum(name.startswith("centre") for name in params))),
            ]
        )

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            about_zero = load.columns(f, load.keys)[:, 0]
            return np.asarray(about_zero - centres[np.minimum(f.recording, centres.size - 1)])

        return Columns(compute)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Stiffness."""
        return {"stiffness": (float(weights[0]), "N/m")}


@effect
class ViscoelasticRelaxation(Effect):
    """A Maxwell element beside the friction: a spring in series with a damper.

    Formula::

        f = F + stiffness z,    dz/dt = v - z / time_constant
    """

    name = "viscoelastic_relaxation"
    family = "spring"
    stage = "mechanics"
    keys = (
        Key("stiffness", "N/m", 20.0, 0.0, 1e9, "stiffness of the element"),
        Key("time_constant", "s", 0.4, 1e-4, 1e5, "its relaxation time"),
        form_key("two elements, relaxing in 0.7 and 1.3 of the time"),
    )
    size_key = "stiffness"
    reveals = "position_m"
    systematic: ClassVar[Mapping[str, float]] = {"stiffness": 0.05, "time_constant": 0.08}
    words = Words(
        "the material relaxes (Maxwell element): an elastic {force} that fades",
        "a {force} with a phase lead over position that depends on the period",
        {
            "side_spring": "stop and hold: a relaxing {force} fades",
            "inertia": "a second period",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the element's force."""
        step = np.full(trace.time_s.size, trace.step_s)
        step[0] = 0.0
        before = np.concatenate([trace.velocity_m_s[:1], trace.velocity_m_s[:-1]])
        factors = (0.7, 1.3) if self["form"] >= 0.5 else (1.0,)
        force = np.zeros(step.size)
        for factor in factors:
            out = np.empty(step.size)
            maxwell(step, before, trace.velocity_m_s, factor * self["time_constant"], np.zeros(1), out)
            force += out / len(factors)
        return trace.with_friction(trace.friction_N + self["stiffness"] * force)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Time constants from two samples to what the record can show, at most ten of the longest period."""
        low = SHORTEST_RELAXATION * context.step_s
        longest = min(10.0 * max(context.periods_s, default=np.inf), longest_relaxation_s(context))
        return chosen(geometric(low, max(longest, 2.0 * low), 2.2), "time_constant")

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never beyond what the record can show: a longer one is a spring."""
        return below(value, longest_relaxation_s(context))

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A spring beyond what the record goes through several times; below two samples it only takes away mass."""
        if params["time_constant"] < SHORTEST_RELAXATION * context.step_s:
            return f"its time constant of {params['time_constant']:.3g} s is below two sample periods"
        if params["time_constant"] > longest_relaxation_s(context) * (1.0 + 1e-6):
            return (
                f"its time constant of {params['time_constant']:.3g} s is beyond a fifth of the record, or beyond its "
                "longest piece without a gap"
            )
        return None

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return z."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty(f.size)
            maxwell(f.step_s, f.previous_m_s, f.velocity_m_s, params["time_constant"], s, out)
            return out

        return Columns(compute, state=1)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Stiffness and time constant."""
        return {"stiffness": (float(weights[0]), "N/m"), "time_constant": (params["time_constant"], "s")}

    signs = (1,)
    refined = ("time_constant",)
