"""Inertia, springs, lagging films, relaxation and outside disturbances."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import REVERSAL, Effect, Key, Params, Words, chosen, effect, form_key
from friction_estimator.effects.columns import RECORDINGS, Columns, amplitudes, own_phases, recording_of, several
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import beyond_time, geometric, longest_piece_s, longest_relaxation_s, times
from friction_estimator.effects.kernels import film_lag, maxwell
from friction_estimator.effects.reference import BOUNDARY, SHEAR, Reference
from friction_estimator.effects.spectrum import SLOWEST, spectral_lines
from friction_estimator.effects.trace import Trace


@effect
class Inertia(Effect):
    """m a on the load cell."""

    name = "inertia"
    family = "inertia"
    stage = "mechanics"
    keys = (Key("mass", "kg", 1.0, 0.0, 1e6, "mass between load cell and seal"),)
    size_key = "mass"
    reveals = "acceleration_m_s2"
    words = Words(
        "the load cell also accelerates a mass",
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
        return Columns(lambda f, _r, _s: f.acceleration_m_s2.copy())

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Mass in kg."""
        return {"mass": (float(weights[0]), "kg")}

    signs = (1,)


@effect
class SideSpring(Effect):
    """k x."""

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
        "something beside the seal is elastic (cable, hose, bellows), or pushes away from the middle (magnet, toggle)",
        "the residual is proportional to the position, the same at every period",
        {
            "inertia": "a second period or stroke: a spring does not change, inertia grows with 1/T^2",
            "viscoelastic_relaxation": "stop and hold: a spring keeps its force",
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
    def columns(cls, params: Params) -> Columns:
        """Return x - centre."""
        return Columns(lambda f, _r, _s: f.position_m - params["centre"])

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Stiffness."""
        return {"stiffness": (float(weights[0]), "N/m")}


@effect
class SqueezeFilm(Effect):
    """-A a / (1 + (v / v_f)^2)."""

    name = "squeeze_film"
    family = "film"
    stage = "friction"
    acts = REVERSAL
    keys = (
        Key("amplitude", "kg", 0.5, 0.0, 1e6, "A: force per acceleration at standstill"),
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
        share = np.exp(-np.log(2.0) * ratio) if self["form"] >= 0.5 else 1.0 / (1.0 + ratio)
        return trace.with_friction(trace.friction_N - self["amplitude"] * trace.acceleration_m_s2 * share)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Speeds from a sixtieth of the largest to a third of it."""
        return chosen(context.top_speed_m_s / np.array([60.0, 30.0, 15.0, 8.0, 4.0]), "speed")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -a / (1 + (v / v_f)^2)."""
        return Columns(lambda f, _r, _s: -f.acceleration_m_s2 / (1.0 + np.square(f.velocity_m_s / params["speed"])))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Amplitude and speed."""
        return {"amplitude": (float(weights[0]), "kg"), "speed": (params["speed"], "m/s")}

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Above the top speed it would act at every speed, and be inertia of the other sign."""
        if params["speed"] > context.top_speed_m_s:
            return f"its speed of {params['speed']:.3g} m/s is above the largest of the drive"
        return None

    signs = (1,)
    refined = ("speed",)


@effect
class FrictionalLag(Effect):
    """The Stribeck part follows a lagged speed."""

    name = "frictional_lag"
    family = "film"
    stage = "lubrication"
    acts = REVERSAL
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
        """Lags from 0.02 samples to a quarter of the shortest period."""
        return chosen(times(context), "lag")

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Neither far below a sample nor a good part of a stroke."""
        return beyond_time("lag", params["lag"], context)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return what the boundary and the shear part change on the film of the lagged speed."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:
            out = np.empty(f.size)
            film_lag(
                f.step_s,
                f.previous_m_s,
                f.velocity_m_s,
                f.pressure_Pa,
                params["lag"],
                r.sign_velocity_m_s,
                r.tables[BOUNDARY],
                r.tables[SHEAR],
                r.pressures_Pa,
                r.bend_m_s,
                r.reach,
                s,
                out,
            )
            return out

        return Columns(compute, state=2, filtered=True)

    signs = (1,)
    fixed_gain = True
    refined = ("lag",)


@effect
class PeriodicDisturbance(Effect):
    """sin(2 pi f t), not locked to the drive."""

    name = "periodic_disturbance"
    family = "periodic"
    stage = "mechanics"
    many = True
    keys = (
        Key("amplitude", "N", 0.2, 0.0, 1e6, "amplitude"),
        Key("frequency", "Hz", 13.7, 1e-3, 1e5, "frequency"),
        form_key("with a second harmonic of 40 %"),
    )
    size_key = "amplitude"
    reveals = "time_s"
    words = Words(
        "something else on the rig runs at its own frequency (mains, pump ripple)",
        "a line in the spectrum of the residual that is not locked to the drive",
        {"position_dependence": "change the drive's speed: the line stays, a position pattern moves"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add the wave at a random phase."""
        angle = 2.0 * np.pi * (self["frequency"] * trace.time_s + rng.random())
        wave = np.sin(angle)
        if self["form"] >= 0.5:
            wave = wave + 0.4 * np.sin(2.0 * angle + 1.0)
        return trace.with_friction(trace.friction_N + self["amplitude"] * wave)

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:
        """Lines of the residual's spectrum that are no harmonics of the drive."""
        number = recording_of(features)
        lines = spectral_lines(
            residual_N, features.time_s, context.step_s, periods_s=context.periods_s, recording=number
        )
        return [{"frequency": line} | several(features) for line in lines]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return cos and sin of 2 pi f t (and of its harmonics), for each recording."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            angle = 2.0 * np.pi * params["frequency"] * f.time_s
            order = range(1, count + 1)
            return own_phases(np.column_stack([wave(k * angle) for k in order for wave in (np.cos, np.sin)]), f, params)

        count = round(params.get("harmonics", 1.0))
        return Columns(compute, 2 * count * round(params.get(RECORDINGS, 1.0)))

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A periodic wave that is no sine: with three harmonics."""
        return [dict(params) | {"harmonics": 3.0}]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Amplitude and frequency."""
        return {
            "amplitude": (float(amplitudes(weights, params)[0]), "N"),
            "frequency": (params["frequency"], "Hz"),
        }

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Three cycles in a piece without a gap, and two samples in a cycle."""
        if params["frequency"] * longest_piece_s(context) < SLOWEST:
            return f"fewer than {SLOWEST:.0f} cycles of {params['frequency']:.3g} Hz fit into a piece without a gap"
        if params["frequency"] * context.step_s > 0.5:
            return f"{params['frequency']:.3g} Hz is above half the sample rate"
        return None

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Half a line's width to each side."""
        return (value - 0.4 / context.duration_s, value + 0.4 / context.duration_s)

    signs = (0, 0)
    refined = ("frequency",)


@effect
class ViscoelasticRelaxation(Effect):
    """Maxwell element z' = v - z / tau."""

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
        "the seal's material relaxes (Maxwell element): an elastic force that fades",
        "a force with a phase lead over position that depends on the period",
        {
            "side_spring": "stop and hold: a relaxing force fades",
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
        low = 2.0 * context.step_s
        longest = min(10.0 * max(context.periods_s, default=np.inf), longest_relaxation_s(context))
        return chosen(geometric(low, max(longest, 2.0 * low), 2.2), "time_constant")

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never beyond what the record can show: a longer one is a spring."""
        return (value / 2.5, max(min(value * 2.5, longest_relaxation_s(context)), value / 2.0))

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A time that the record does not go through several times is that of a spring."""
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
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Stiffness and time constant."""
        return {"stiffness": (float(weights[0]), "N/m"), "time_constant": (params["time_constant"], "s")}

    signs = (1,)
    refined = ("time_constant",)
