"""Slow changes with time and distance."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.quantities import quantity
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import SLOW, Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import STRAIGHT, chosen
from friction_estimator.effects.reference import BOUNDARY, THEORY, VISCOUS, Reference
from friction_estimator.effects.shapes import FREE, LOW_SPEED, SHAPES, free, free_at, is_free, low_speed
from friction_estimator.effects.trace import Trace

GROWS = 0.5
"""Of what a level leaves of a change: where a force that grows with the speed leaves less, it is no level's."""

SOONEST = 1.0 / 30.0
"""Of a record: what is over sooner is what it begins with, however long its strokes are."""


@effect
class SensorDrift(Effect):
    """A zero of the force sensor that moves slowly.

    Formula::

        f = F + total t / T

    T is the length of the recording.
    """

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
        "the zero of the {force} sensor drifts",
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
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Total drift in N."""
        return {"total": (float(np.sum(weights)), "N")}

    signs = (0, 0, 0)


class _SlowGain(Effect):
    """A part of the friction that changes slowly: the theory's own, or, in the free shape, any share at each speed.

    Attributes
    ----------
    along : what it goes on with: a field of the features. lasts : how much of that the record has: a field of the
        context; whole_record : that in words. way : sign of the change. own, other : part of the theory that changes,
        and the one that another cause changes. told_at : share of the top speed at which a change of the friction is
        stated, or where the record is slowest.
    """

    family = "slow_gain"
    stage = "lubrication"
    acts = SLOW
    turns = True
    along: ClassVar[str]
    lasts: ClassVar[str]
    whole_record: ClassVar[str]
    way: ClassVar[float]
    own: ClassVar[int]
    other: ClassVar[int]
    told_at: ClassVar[float]

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Constants from a twelfth of the record to twice it; of the free shape, two of them.

        Where a thinner film takes less of the load, friction rises as the oil warms: the plain form has no sign for it.
        """
        name, whole = cls.refined[0], cls._whole(context)
        plain = chosen(whole * np.array([1 / 12, 1 / 6, 1 / 3, 2 / 3, 2.0]), name)
        free = [dict(one) | {"shape": FREE} for one in chosen(whole * np.array([1 / 6, 2 / 3]), name)]
        return [*plain, *free]

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:
        """Never beyond twice the record, where a longer one is a straight line as well; nor over at once."""
        low, high = super().bracket(name, value, context)
        return (max(low, min(cls._soonest(context), value)), min(high, STRAIGHT * cls._whole(context)))

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """What is over at once is what a record begins with: a film that builds up, a filter that settles.

        Beyond twice the record only its start is seen, and its end is invented.
        """
        (name,) = cls.refined
        unit = next(key.unit for key in cls.keys if key.name == name)
        value = f"its {name.replace('_', ' ')} of {quantity(params[name], unit, '.3g')}"
        if params[name] <= cls._soonest(context) * (1.0 + 1e-6):
            return f"{value} is over where the record begins"
        if params[name] > STRAIGHT * cls._whole(context) * (1.0 + 1e-6):
            return f"{value} is beyond twice {cls.whole_record}"
        return None

    @classmethod
    def _soonest(cls, context: Context) -> float:
        """Return the constant that is a stroke long, in its unit; where strokes are long a small part of the record."""
        share = min(context.stroke_m / max(context.distance_m, 1e-300), SOONEST)
        return share * cls._whole(context)

    @classmethod
    def _whole(cls, context: Context) -> float:
        """Return how much the record has of what it goes on with, s or m."""
        return float(getattr(context, cls.lasts))

    @classmethod
    def _done(cls, params: Params, f: Features) -> Floats:
        """Return what has happened of the change, (n,), 0 to 1."""
        return np.asarray(1.0 - np.exp(-getattr(f, cls.along) / params[cls.refined[0]]))

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return the theory's part times 1 - exp(-x / constant); in the free shape F times `shapes.free` so."""
        shaped = is_free(params)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            done = cls.way * cls._done(params, f)
            if shaped:
                force = r.force(f.velocity_m_s, f.pressure_Pa)
                return np.asarray((done * force)[:, None] * free(f.velocity_m_s, r))
            return np.asarray(done * r.part(cls.own, f.velocity_m_s, f.pressure_Pa))

        return Columns(compute, SHAPES if shaped else 1, filtered=True, shapes=(SHAPES,) if shaped else ())

    @classmethod
    def told(cls, params: Params, weights: Floats, context: Context, reference: Reference) -> Stated:
        """At one pressure any share of the friction may be the theory's: told is a change of the friction."""
        if is_free(params) or context.theory_told:
            return cls.physical(params, weights, context)
        speed, pressure = max(cls.told_at, context.slow_share) * context.top_speed_m_s, context.pressure_mean_Pa
        (part,) = reference.once(np.array([speed]), np.array([pressure]), cls.own)
        share = float(part[0]) / reference.size_N(speed, pressure)
        alike = np.append(np.zeros(SHAPES - 1), share * weights[0])
        return cls.physical(dict(params) | {"shape": FREE}, alike, context)

    @classmethod
    def belied(cls, params: Params, part_N: Floats, f: Features, r: Reference, context: Context) -> bool:
        """A free shape that is nearer to a change of the theory's other part is that of another cause.

        By how much the theory's own shape is unlike the friction's its parts are, too, or more: what is nearer by less
        says nothing. At one pressure nothing tells which part of the friction is which; but no level grows with the
        speed.
        """
        if not is_free(params):
            return False
        v, done = f.velocity_m_s, cls._done(params, f)
        if context.theory_told:
            theory = np.sum([r.part(part, v, f.pressure_Pa) for part in THEORY], axis=0)
            own, other = (_angle(part_N, done * r.part(part, v, f.pressure_Pa)) for part in (cls.own, cls.other))
            return own - other > _angle(r.force(v, f.pressure_Pa), theory)
        return cls.own == BOUNDARY and _unlike(part_N, done * v) < GROWS * _unlike(part_N, done * np.sign(v))

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """Another share at each speed: where the theory's parts are wrong, time and distance still tell."""
        return [dict(params) | {"shape": FREE}]

    @classmethod
    def plainer(cls, params: Params) -> list[dict[str, float]]:
        """The theory's own share."""
        return [{n: v for n, v in params.items() if n != "shape"}] if is_free(params) else []


@effect
class ViscosityDrift(_SlowGain):
    """Oil that warms up: its viscosity, and with it the viscous part of friction, falls.

    Formula::

        f = F(v; viscosity (1 - drop (1 - exp(-t / time_constant))))
    """

    name = "viscosity_drift"
    keys = (
        Key("drop", "", 0.2, 0.0, 0.95, "share of the viscosity that is lost in the end"),
        Key("time_constant", "s", 40.0, 0.01, 1e6, "time constant of warming"),
        form_key("two time constants, 0.6 and 1.4 of it"),
    )
    size_key = "drop"
    linear = False
    systematic: ClassVar[Mapping[str, float]] = {"drop": 0.04, "friction_drop": 0.06, "time_constant": 0.1}
    words = Words(
        "the oil warms and its viscosity falls",
        "friction settles with time: it falls where the film is thick, and may rise where it is thin",
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
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Drop and time constant; in the free shape the drop of the friction at top speed, which is another thing.

        Where the theory's viscous part does not fit, nothing says how much of the friction is viscous.
        """
        # The plain form is the theory's derivative by the logarithm of the viscosity, the free one the friction itself.
        loss = float(weights[-1])
        drop = {"friction_drop": (loss, "")} if is_free(params) else {"drop": (1.0 - float(np.exp(-loss)), "")}
        return {**drop, "time_constant": (params["time_constant"], "s")}

    along, lasts, whole_record = "time_s", "duration_s", "the recording"
    way, own, other, told_at = -1.0, VISCOUS, BOUNDARY, 1.0
    signs = (1,)
    refined = ("time_constant",)


@effect
class Wear(_SlowGain):
    """A contact that wears or runs in: the boundary (Coulomb) level changes with the distance s run.

    Formula::

        f = F(v; mu_b (1 + change (1 - exp(-s / length))))
    """

    name = "wear"
    keys = (
        Key("change", "", 0.2, -0.9, 10.0, "relative change of the boundary friction coefficient in the end"),
        Key("length", "m", 2.0, 1e-6, 1e9, "distance over which it happens"),
        form_key("two lengths, 0.6 and 1.4 of it"),
    )
    size_key = "change"
    reveals = "distance_m"
    systematic: ClassVar[Mapping[str, float]] = {"change": 0.12, "friction_change": 0.12, "length": 0.5}
    words = Words(
        "the contact wears or runs in: the boundary (Coulomb) level changes with the distance run",
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
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:
        """Relative change and length; in the free shape the change of the friction at low speed."""
        shaped = is_free(params)
        change = free_at(low_speed(context)) @ weights if shaped else weights[0]
        return {"friction_change" if shaped else "change": (float(change), ""), "length": (params["length"], "m")}

    along, lasts, whole_record = "distance_m", "distance_m", "the distance run"
    way, own, other, told_at = 1.0, BOUNDARY, VISCOUS, LOW_SPEED
    refined = ("length",)


def _unlike(part_N: Floats, force: Floats) -> float:
    """Return the share of a change's power (n,) that a force (n,) does not make, of either sign.

    A theory without parts makes nothing.
    """
    along = float(part_N @ force) ** 2 / max(float(force @ force) * float(part_N @ part_N), 1e-300)
    return max(1.0 - along, 0.0)


def _angle(part_N: Floats, force: Floats) -> float:
    """Return the angle between a change (n,) and a force (n,), of either sign, rad."""
    return float(np.arcsin(np.sqrt(_unlike(part_N, force))))


def _settled(ratio: Floats, form: float) -> Floats:
    """Return 1 - exp(-ratio), or the mean of it for 0.6 and 1.4 of the constant."""
    if form >= 0.5:
        return np.asarray(1.0 - 0.5 * (np.exp(-ratio / 0.6) + np.exp(-ratio / 1.4)))
    return np.asarray(1.0 - np.exp(-ratio))
