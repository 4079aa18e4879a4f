"""What the static curve hides: direction and pressure."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import chosen
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.shapes import FREE, SHAPES, TWICE, free, free_at, is_free, low_speed
from friction_estimator.effects.trace import Trace

RMS_SPEED = 2.0**-0.5
"""Share of the top speed of a sine that its rms speed is."""

SIGN_SHARE = 60.0
"""The simulated Coulomb level turns its sign within the top speed over this, as in a record without a theory."""


@effect
class DirectionAsymmetry(Effect):
    """Friction that differs between the directions.

    Formula::

        f = F (1 + asymmetry / 2 sgn v)
    """

    name = "direction_asymmetry"
    family = "bias"
    stage = "friction"
    even = True
    about_curve = True
    keys = (
        Key("asymmetry", "", 0.1, -1.9, 1.9, "relative difference of the friction between the directions"),
        form_key("only the viscous slope differs: proportional to |v| |F|"),
    )
    size_key = "asymmetry"
    reveals = "velocity_m_s"
    systematic: ClassVar[Mapping[str, float]] = {"asymmetry": 0.2}
    words = Words(
        "friction differs between extending and retracting",
        "the static curve has an even part that vanishes at standstill",
        {"sensor_bias": "look at the samples at standstill: an asymmetry vanishes there, a bias does not"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Scale the directions apart."""
        half = 0.5 * self["asymmetry"] * np.sign(trace.velocity_m_s)
        if self["form"] >= 0.5:
            half = half * np.sqrt(np.abs(trace.velocity_m_s) / np.abs(trace.velocity_m_s).max())
        return trace.with_friction(trace.friction_N * (1.0 + half))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Shapes: |F| alone, or with |v| S; S^2 with |v|."""
        return chosen([0.0, 1.0], "shape")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return |F| / 2, or that with |F| sqrt(|v|) / 2, or its level in a free shape.

        That is the level |F / S| times columns of the speed that vanish at standstill (`shapes.free`); in the one
        free twice an even part that does not change with the pressure stands beside it.
        """
        shape = params["shape"]

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            force = 0.5 * f.force_N * f.direction
            if shape >= FREE:
                stands = 0.5 * np.abs(r.level(f.velocity_m_s, f.pressure_Pa))[:, None]
                by_speed = free(f.velocity_m_s, r, first=1)
                made = [stands * by_speed, 0.5 * r.top_N * by_speed]
                return made[0] if shape < TWICE else np.column_stack(made)
            if shape < 0.5:
                return force
            return np.column_stack([force, force * np.sqrt(np.abs(f.velocity_m_s) / r.top_m_s)])

        if shape >= FREE:
            shapes = (SHAPES - 1,) * (2 if shape >= TWICE else 1)
            return Columns(compute, sum(shapes), shapes=shapes)
        return Columns(compute, 1 if shape < 0.5 else 2, of_force=True)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """Directions that differ by another share at each speed."""
        return [dict(params) | {"shape": FREE}, dict(params) | {"shape": TWICE}]

    @classmethod
    def plainer(cls, params: Params) -> list[dict[str, float]]:
        """One share at all speeds, or one that grows with the speed."""
        return chosen([0.0, 1.0], "shape") if is_free(params) else []

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Relative difference of the friction at the rms speed of a sine that reaches the top speed."""
        shape = np.array([1.0, RMS_SPEED**0.5])[: len(weights)]
        if len(weights) >= SHAPES - 1:
            shape = np.tile(free_at(RMS_SPEED, first=1), len(weights) // (SHAPES - 1))
        return {"asymmetry": (float(shape @ weights), "")}

    @classmethod
    def told(cls, params: Params, weights: Floats, context: Context, reference: Reference) -> Stated:
        """What does not change with the pressure is a share of the friction at the mean pressure."""
        if params["shape"] >= TWICE:
            share = reference.top_N / reference.size_N(RMS_SPEED * reference.top_m_s, context.pressure_mean_Pa)
            weights = weights * np.repeat([1.0, share], SHAPES - 1)
        return cls.physical(params, weights, context)

    signs = (0, 0)


@effect
class PressureDependence(Effect):
    """Friction that follows the pressure in another way than the theory.

    Formula::

        f = F + (p - pm) (boundary S(v) + viscous v) + curvature (p - pm)^2 S(v)

    S is a smooth sign of the velocity and pm the mean pressure.
    """

    name = "pressure_dependence"
    family = "pressure"
    stage = "friction"
    recorded = True
    about_curve = True
    channel = "pressure"
    keys = (
        Key("boundary", "N/Pa", 1e-6, -1e3, 1e3, "change of the Coulomb level per pressure"),
        Key("viscous", "N s/m/Pa", 0.0, -1e6, 1e6, "change of the viscous slope per pressure"),
        Key("curvature", "N/Pa^2", 0.0, -1e3, 1e3, "change of the Coulomb level per squared distance from the mean"),
        form_key("with the square root of the pressure, of the same range"),
    )
    size_key = "boundary"
    turns = True
    reveals = "pressure_Pa"
    systematic: ClassVar[Mapping[str, float]] = {"boundary": 0.05}
    words = Words(
        "friction depends on the sealed pressure in another way than the theory says",
        "recordings at different pressures are shifted against each other",
        {
            "gain_step": "randomise the order of the pressures, and come back to the first",
            "saturation": "look at the histogram of the {force}",
            "wear": "randomise the order of the pressures",
            "sensor_drift": "randomise the order of the pressures",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the term."""
        pressure = trace.pressure_Pa
        if self["form"] >= 0.5:
            root = np.sqrt(np.maximum(pressure, 0.0))
            pressure = root * (np.ptp(pressure) / max(float(np.ptp(root)), 1e-300))
        lift = pressure - pressure.mean()
        smooth = float(np.abs(trace.velocity_m_s).max()) / SIGN_SHARE or 1.0
        level = (self["boundary"] + self["curvature"] * lift) * np.tanh(trace.velocity_m_s / smooth)
        return trace.with_friction(trace.friction_N + lift * (level + self["viscous"] * trace.velocity_m_s))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """About the mean pressure; curved where more than two pressures were run."""
        if context.pressure_span_Pa <= 0.02 * max(abs(context.pressure_mean_Pa), 1.0):
            return []
        parts = [(0.0, 0.0), (1.0, 0.0)]
        if context.pressure_levels > 2:
            parts += [(0.0, 1.0), (1.0, 1.0)]
        return [{"mean": context.pressure_mean_Pa, "viscous": v, "curvature": c} for v, c in parts]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return (p - pm) S, and of (p - pm) v and (p - pm)^2 S those that the parameters ask for.

        In the free shape (p - pm) S is taken times columns of the speed (`shapes.free`).
        """
        viscous, curved = params["viscous"] >= 0.5, params.get("curvature", 0.0) >= 0.5
        shaped = is_free(params)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            lift = f.pressure_Pa - params["mean"]
            columns = [lift * r.smooth_sign(f.velocity_m_s)]
            if shaped:
                columns = list((columns[0][:, None] * free(f.velocity_m_s, r)).T)
            if viscous:
                columns.append(lift * f.velocity_m_s)
            if curved:
                columns.append(np.square(lift) * r.smooth_sign(f.velocity_m_s))
            return np.column_stack(columns)

        return Columns(compute, (SHAPES if shaped else 1) + viscous + curved, shapes=(SHAPES,) if shaped else ())

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A level that depends on the pressure by another share at each speed."""
        return [dict(params) | {"shape": FREE, "viscous": 0.0}]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:
        """Change of level, and of slope, per pressure; in the free shape that of the level at low speed."""
        if is_free(params):
            level = free_at(low_speed(context)) @ weights[:SHAPES]
            weights = np.concatenate([[level], weights[SHAPES:]])
        names = [("boundary", "N/Pa")]
        if params["viscous"] >= 0.5:
            names.append(("viscous", "N s/m/Pa"))
        if params.get("curvature", 0.0) >= 0.5:
            names.append(("curvature", "N/Pa^2"))
        return {name: (float(weight), unit) for (name, unit), weight in zip(names, weights, strict=True)}

    signs = (0, 0)
