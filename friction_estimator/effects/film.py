"""The lubricating film takes its time."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import REVERSAL, Effect, Film, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import below, beyond_time, chosen, times
from friction_estimator.effects.kernels import DELAY_LINE, LEAST_FILM, delayed, film_speed, film_way, on_film
from friction_estimator.effects.reference import FORCE, THEORY, Reference
from friction_estimator.effects.trace import Trace

ALIKE = 4.0
"""Times the top speed of the drive: a film squeezed up to this speed acts at all of its speeds alike, to 6 %."""


@effect
class SqueezeFilm(Effect):
    """A film that is squeezed out and drawn in late.

    Formula::

        f = F - amplitude a / (1 + (v / speed)^2)
    """

    name = "squeeze_film"
    family = "film"
    stage = "friction"
    acts = REVERSAL
    keys = (
        Key("amplitude", "kg", 0.5, 0.0, 1e6, "A: {force} per acceleration at standstill"),
        Key("speed", "m/s", 0.01, 1e-6, 1e3, "v_f: speed at which it has fallen to a half"),
        form_key("Gaussian in speed: exp(-ln 2 (v / v_f)^2)"),
    )
    size_key = "amplitude"
    reveals = "acceleration_m_s2"
    systematic: ClassVar[Mapping[str, float]] = {"amplitude": 0.13, "speed": 0.32}
    words = Words(
        "the film is squeezed out and drawn in with a lag: friction falls while the shaft accelerates at low speed",
        "the residual follows the acceleration at low speed only",
        {
            "inertia": "the same acceleration at another speed: inertia stays and has the other sign",
            "frictional_lag": "the same speed at another acceleration",
            "sensor_lowpass": "a second period",
            "breakaway": "vary the dwell at the reversal",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the term."""
        ratio = np.square(trace.velocity_m_s / self["speed"])
        share = _gaussian(ratio) if self["form"] >= 0.5 else _rational(ratio)
        return trace.with_friction(trace.friction_N - self["amplitude"] * trace.acceleration_m_s2 * share)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Speeds from a sixtieth of the largest to a third of it."""
        return chosen(context.top_speed_m_s / np.array([60.0, 30.0, 15.0, 8.0, 4.0]), "speed")

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never far above the top speed: from there on it acts at every speed alike."""
        return below(value, ALIKE * context.top_speed_m_s)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -a / (1 + (v / v_f)^2), and where both shapes are asked for that with a Gaussian of the speed."""
        both = params.get("both", 0.0) >= 0.5

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            ratio = np.square(f.velocity_m_s / params["speed"])
            shares = [_rational(ratio), _gaussian(ratio)] if both else [_rational(ratio)]
            return -f.acceleration_m_s2[:, None] * np.column_stack(shares)

        return Columns(compute, 2 if both else 1)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A film that is gone sooner at high speed: what its tail gets wrong would look like inertia."""
        return [dict(params) | {"both": 1.0}]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:
        """Amplitude and speed; a speed above the largest of the drive is not told: it may be any."""
        told = {"amplitude": (float(np.sum(weights)), "kg")}
        return told if params["speed"] > context.top_speed_m_s else told | {"speed": (params["speed"], "m/s")}

    signs = (1,)
    positive = ("amplitude",)
    refined = ("speed",)


def _rational(ratio: Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + ratio))


def _gaussian(ratio: Floats) -> Floats:
    return np.asarray(np.exp(-np.log(2.0) * ratio))


@effect
class FrictionalLag(Effect):
    """A film that follows an earlier speed.

    Formula::

        f = F(v; film of speed u),    lag du/dt = |v| - u

    Source: Hess and Soom, J. Tribology 112 (1990) 147.
    """

    name = "frictional_lag"
    family = "film"
    stage = "lubrication"
    acts = REVERSAL
    in_theory = True
    keys = (
        Key("lag", "s", 0.01, 0.0, 100.0, "time by which the film follows the speed"),
        form_key("a pure delay of the film instead of a first-order lag"),
    )
    size_key = "lag"
    linear = False
    reveals = "velocity_m_s"
    systematic: ClassVar[Mapping[str, float]] = {"lag": 0.1}
    words = Words(
        "the lubricating film needs time: friction follows an earlier speed",
        "a loop in friction over speed at low speed, wider at higher frequency",
        {
            "squeeze_film": "the same speed at another acceleration",
            "time_delay": "speed steps without reversal: the sign of friction is not late",
            "breakaway": "speed steps without reversal",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Let the film follow a lagged speed."""
        from friction_estimator.effects.timing import lagged_force  # noqa: PLC0415 - same filter

        lag, speed = self["lag"], trace.film_speed_m_s
        if lag <= 0.0:
            return trace
        if self["form"] >= 0.5:
            return replace(trace, film_speed_m_s=np.interp(trace.time_s - lag, trace.time_s, speed))
        return replace(trace, film_speed_m_s=np.maximum(lagged_force(speed, trace.step_s, lag), 0.0))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Lags from 0.02 samples to a quarter of the shortest period, of the theory's share alone and of all the curve.

        What stands beside it may leave the theory next to nothing of the force.
        """
        return [lag | {"rest": rest} for rest in (0.0, 1.0) for lag in chosen(times(context), "lag")]

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Neither far below a sample nor a good part of a stroke."""
        return beyond_time("lag", params["lag"], context)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return what friction changes on the film of the lagged speed: the theory's boundary and shear part.

        Of what the curve has beside the theory a share `rest` follows the film as well, as boundary friction does.
        """
        rest = params.get("rest", 0.0)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:
            return _more_on(film_of(f, r, params, s), f.velocity_m_s, f.pressure_Pa, rest, r)

        def of_theory(f: Features, r: Reference, s: Floats) -> Floats:
            return _more_on(film_of(f, r, params, s), f.velocity_m_s, f.pressure_Pa, 0.0, r)

        return Columns(compute, state=DELAY_LINE, filtered=True, of_theory=of_theory)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A pure delay of the film, which is thinnest one lag after the reversal, a first-order lag's sooner; a film
        that differs between the directions by the one in which it was built (decision 0199).
        """
        plain = {name: value for name, value in params.items() if name not in ("delayed", "turned")}
        return [form for form in (plain, plain | {"delayed": 1.0}, plain | {"turned": 1.0}) if form != params]

    @classmethod
    def film(cls, params: Params, features: Features, reference: Reference, state: Floats) -> Film | None:
        """Return the film, if a share of what the theory does not say follows it."""
        rest = params.get("rest", 0.0)
        if rest <= 0.0:
            return None
        speed = film_of(features, reference, params, state[:DELAY_LINE])
        if params.get("turned", 0.0) < 0.5:
            return Film(rest, speed)
        way = np.empty(features.size)
        steps = features.step_s, features.previous_m_s, features.velocity_m_s
        film_way(*steps, params["lag"], speed, state[DELAY_LINE:], way)
        return Film(rest, speed, way)

    @classmethod
    def level_on_film(cls, params: Params, features: Features, reference: Reference, state: Floats) -> Floats:
        """Return the level of friction on the film over that at the velocity, (n,)."""
        film = film_of(features, reference, params, state[:DELAY_LINE])
        moving = reference.moving(features.velocity_m_s)
        more = _more_on(film, moving, features.pressure_Pa, params.get("rest", 0.0), reference)
        stands = reference.force(moving, features.pressure_Pa)
        return 1.0 + np.divide(more, stands, out=np.zeros(more.size), where=stands != 0.0)

    signs = (1,)
    fixed_gain = True
    refined = ("lag", "rest")
    shares = ("rest",)


def film_of(features: Features, reference: Reference, params: Params, state: Floats) -> Floats:
    """Return the speed that has built a film that lags, (n,), m/s; `state` is carried from piece to piece."""
    f, r, out = features, reference, np.empty(features.size)
    if params.get("delayed", 0.0) >= 0.5:
        delayed(f.step_s, f.velocity_m_s, params["lag"], state, out)
        return np.maximum(np.abs(out), LEAST_FILM * r.sign_velocity_m_s)
    film_speed(f.step_s, f.previous_m_s, f.velocity_m_s, params["lag"], r.sign_velocity_m_s, r.bend_m_s, state, out)
    return out


def _more_on(film_m_s: Floats, velocity_m_s: Floats, pressure_Pa: Floats, rest: float, reference: Reference) -> Floats:
    """Return by how much friction on the film of another speed differs, (n,), N; see `kernels.on_film`."""
    r, slowest, out = reference, LEAST_FILM * reference.sign_velocity_m_s, np.empty(film_m_s.size)
    parts = (FORCE, *THEORY)
    there = r.once(film_m_s, pressure_Pa, *parts)
    here = tuple(r.part(part, velocity_m_s, pressure_Pa, slowest) for part in parts)
    on_film(velocity_m_s, film_m_s, r.sign_velocity_m_s, r.theory_width_m_s, rest, there, here, out)
    return out
