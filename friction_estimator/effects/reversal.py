"""What happens at and after a reversal: breakaway, presliding, backlash."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import REVERSAL, Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import beyond_length, chosen, lengths
from friction_estimator.effects.kernels import hysteron, play, rest_spike, slip_chain
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.trace import Trace

GAP_RATIO = 1.8
"""Of neighbouring gaps in the grid: a box must overlap the true one by more than a half."""

SPREAD = (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Lengths of several bristles over that of the one which fits best."""

UNSCREENED_RATIO = 64.0
"""Of lengths at which bristles of several lengths are begun: they go over as much (`SPREAD`), and walk by octaves."""

DWELL_POWERS = (0.25, 0.5)
"""Exponents with which a breakaway force grows with the dwell."""

REST_SPEEDS = (0.2, 5.0)
"""Times the width of the theory's sign, which is taken for the speed of rest: slower than this may be rest as well."""


def relative_level(features: Features, reference: Reference) -> Floats:
    """Return the level that bristles carry in steady sliding, (n,), over the size of that at rest and medium pressure.

    Where no turn shows it, it may be less than nothing in a round of a fit: it turns no force of the bristles round.
    """
    usual = abs(reference.at_rest_N)
    return reference.level(features.velocity_m_s, features.pressure_Pa) / (usual if usual > 0.0 else 1.0)


@effect
class Breakaway(Effect):
    """A contact that sticks while it rests.

    Formula::

        f = F + amplitude sgn(v) sqrt(dwell / 0.1 s) exp(-s / length)

    dwell is the time spent below rest_speed before the reversal, s the distance run since it.
    """

    name = "breakaway"
    family = "reversal"
    stage = "friction"
    acts = REVERSAL
    keys = (
        Key("amplitude", "N", 2.0, 0.0, 1e6, "height of the spike after 0.1 s of rest"),
        Key("length", "m", 3e-5, 1e-12, 1.0, "distance over which it decays"),
        Key("rest_speed", "m/s", 2e-3, 1e-9, 1.0, "slower than this counts as rest"),
        form_key("grows with the logarithm of the dwell time instead of its square root"),
    )
    size_key = "amplitude"
    reveals = "since_reversal_m"
    turns = True
    systematic: ClassVar[Mapping[str, float]] = {"length": 0.1, "amplitude": 0.1}
    words = Words(
        "the contact sticks while it rests: breaking away costs more {force} than running",
        "a positive spike just after each reversal, higher after a longer rest",
        {
            "presliding": "the sign of the spike: breakaway adds {force}, presliding lacks it",
            "frictional_lag": "vary the dwell at the reversal: only a breakaway {force} grows with it",
            "squeeze_film": "vary the dwell at the reversal",
        },
        "let the shaft rest at its reversals, 0.1 s and longer: only that tells the {force} after a rest",
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Add the spike; its height is 1 at a dwell of 0.1 s."""
        step, before = _steps(trace)
        exponent = 1e-3 if self["form"] >= 0.5 else 0.5
        out = np.empty(step.size)
        rest_spike(step, before, trace.velocity_m_s, self["length"], self["rest_speed"], exponent, np.zeros(4), out)
        if self["form"] >= 0.5:
            # d^e = 1 + e ln d: the logarithm without a second machine.
            with np.errstate(divide="ignore", invalid="ignore"):
                decay = np.where(out == 0.0, 0.0, np.abs(out))
            dwell = np.empty(step.size)
            rest_spike(step, before, trace.velocity_m_s, 1e30, self["rest_speed"], 1.0, np.zeros(4), dwell)
            height = np.log1p(np.abs(dwell) / 0.02) / np.log1p(5.0)
            out = np.sign(out) * decay * height
        else:
            out = out / np.sqrt(0.1)
        return trace.with_friction(trace.friction_N + self["amplitude"] * out)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Lengths over the distances that the record resolves, growth with the dwell from slow to fast."""
        rest = context.sign_velocity_m_s
        return [
            {"length": float(length), "exponent": power, "rest_speed": rest}
            for length in lengths(context)
            for power in DWELL_POWERS
        ]

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """Another growth with the dwell: where no dwell is near 0.1 s, the height there is another one."""
        return [dict(params) | {"exponent": power} for power in DWELL_POWERS if power != params["exponent"]]

    @classmethod
    def untold(cls, params: Params) -> list[dict[str, float]]:
        """Other speeds of rest, with every growth.

        Where the shaft passes through rest at a steady acceleration, the dwell is in proportion to the speed of rest,
        and nothing but the height after 0.1 s hangs on it.
        """
        speeds = [by * params["rest_speed"] for by in REST_SPEEDS]
        return [dict(params) | {"exponent": power, "rest_speed": rest} for rest in speeds for power in DWELL_POWERS]

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return sgn(v) (dwell / 0.1 s)^exponent exp(-d_rev / L)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty(f.size)
            length, power = params["length"], params["exponent"]
            rest_spike(f.step_s, f.previous_m_s, f.velocity_m_s, length, params["rest_speed"], power, s, out)
            return np.asarray(out * 0.1**-power)

        return Columns(compute, state=4)

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Height after 0.1 s of rest, and length."""
        return {"amplitude": (float(weights[0]), "N"), "length": (params["length"], "m")}

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A length that takes much of the stroke is no matter of reversals."""
        return beyond_length("length", params["length"], context)

    signs = (1,)
    refined = ("length",)


@effect
class Presliding(Effect):
    """A contact that bends like bristles before it slides.

    Formula::

        f = F + amplitude (z - sgn v),    dz/dt = (v - |v| z) / length

    After a reversal z - sgn v = -2 sgn(v) exp(-s / length), s the distance run since it. Source: Dahl 1968.
    """

    name = "presliding"
    family = "reversal"
    stage = "friction"
    acts = REVERSAL
    keys = (
        Key("amplitude", "N", 1.0, 0.0, 1e6, "friction that the bristles carry"),
        Key("length", "m", 3e-5, 1e-12, 1.0, "bristle length: distance over which they bend"),
        form_key("elastic-slip (a straight ramp of the same area) instead of an exponential"),
    )
    size_key = "amplitude"
    reveals = "since_reversal_m"
    turns = True
    systematic: ClassVar[Mapping[str, float]] = {"length": 0.15, "amplitude": 0.05}
    words = Words(
        "the contact is elastic: after a reversal friction builds up over a small distance",
        "a negative spike after each reversal that decays over the same distance at every speed",
        {
            "backlash": "the shape: a gap gives a box, bristles an exponential",
            "time_delay": "two periods: presliding is the same distance, a delay the same time",
            "sensor_lowpass": "two periods: presliding is the same distance, a filter the same time",
            "squeeze_film": "two periods",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Take away what the bristles do not carry yet."""
        step, before = _steps(trace)
        out = np.empty(step.size)
        if self["form"] >= 0.5:
            slip_chain(step, before, trace.velocity_m_s, 2.0 * self["length"], np.zeros(2), out)
        else:
            hysteron(step, before, trace.velocity_m_s, self["length"], np.zeros(2), out)
        return trace.with_friction(trace.friction_N + self["amplitude"] * out)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Lengths over the distances that the record resolves."""
        return chosen(lengths(context), "length")

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return z - sgn(v); in the spread shape that of elasto-slip elements of several lengths; none pushes."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty(f.size)
            hysteron(f.step_s, f.previous_m_s, f.velocity_m_s, params["length"], s, out)
            return out

        def elements(f: Features, r: Reference, s: Floats) -> Floats:
            out = np.empty((len(SPREAD) + 1, f.size))
            for i, factor in enumerate(SPREAD):
                own = s[2 * i : 2 * i + 2]
                slip_chain(f.step_s, f.previous_m_s, f.velocity_m_s, 2.0 * factor * params["length"], own, out[i])
            # Where bristles carry everything, nothing is left of the static curve's smooth sign.
            out[-1] = f.direction - r.steady_sign(f.velocity_m_s, f.pressure_Pa)
            return out.T * relative_level(f, r)[:, None]

        if params.get("spread", 0.0) >= 0.5:
            return Columns(elements, len(SPREAD) + 1, state=2 * len(SPREAD), one_sided=len(SPREAD))
        return Columns(compute, state=2)

    @classmethod
    def carries(cls, params: Params) -> bool:
        """In the spread shape they carry a share of the level."""
        return params.get("spread", 0.0) >= 0.5

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """Bristles of several lengths: generalised Maxwell slip.

        One exponential is nearest to the short ones, or, where the first samples after a reversal show little of these,
        to the longest.
        """
        if cls.carries(params):
            return []
        return [dict(params) | {"spread": 1.0, "length": factor * params["length"]} for factor in (0.125, 1.0, 8.0)]

    @classmethod
    def wells(cls, params: Params) -> list[dict[str, float]]:
        """Lengths an octave away: those of several bristles are octaves apart and fit nearly as well one further."""
        if not cls.carries(params):
            return []
        return [dict(params) | {"length": factor * params["length"]} for factor in (0.5, 2.0)]

    @classmethod
    def unscreened(cls, context: Context) -> list[dict[str, float]]:
        """Bristles of several lengths, which carry the level, all that the drive shows."""
        points = lengths(context, UNSCREENED_RATIO)
        inner = points[1:-1] if points.size > 2 else np.sqrt(points[:1] * points[-1:])
        return [{"length": float(length), "spread": 1.0} for length in inner]

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Force of the bristles and their length, the mean one where they are several."""
        carried = weights[: len(SPREAD)]
        amplitude = float(np.sum(carried))
        length = params["length"]
        if len(weights) > 1 and amplitude > 0.0:
            length *= max(float(carried @ np.array(SPREAD)) / amplitude, min(SPREAD))
        return {"amplitude": (amplitude, "N"), "length": (length, "m")}

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:
        """A length that takes much of the stroke is no matter of reversals: what never slips is a spring."""
        return beyond_length("length", cls.physical(params, weights, context)["length"][0], context)

    signs = (1,)
    positive = ("amplitude",)
    refined = ("length",)


SOFT_CLOSING = np.linspace(0.9, 1.0, 5)
"""Shares of the gap at which parts of what rubs are taken along where it closes softly."""


@effect
class Backlash(Effect):
    """Play between the drive and what rubs, which stands until the play is used up.

    Formula::

        f = F - (F + drag sgn v) 1(s < gap)

    s is the distance run since the reversal.
    """

    name = "backlash"
    family = "reversal"
    stage = "mechanics"
    acts = REVERSAL
    keys = (
        Key("gap", "m", 2e-5, 0.0, 1.0, "play between drive and friction"),
        Key("drag", "N", 0.0, 0.0, 1e6, "{force} lost in the open gap beyond the friction itself"),
        form_key("the last tenth of the gap closes softly"),
    )
    size_key = "gap"
    linear = False
    reveals = "since_reversal_m"
    turns = True
    words = Words(
        "play between drive and friction: after a reversal what rubs stands until the gap is closed",
        "a box in the residual over a fixed distance after each reversal",
        {
            "presliding": "the shape: a gap gives a box, bristles an exponential",
            "time_delay": "two periods: a gap is the same distance, a delay the same time",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Take away the friction while the gap is open."""
        step, before = _steps(trace)
        gap, drag = self["gap"], self["drag"]
        if gap <= 0.0:
            return trace
        parts = SOFT_CLOSING if self["form"] >= 0.5 else np.array([1.0])
        open_ = np.zeros(step.size)
        for part in parts:
            out = np.empty(step.size)
            play(step, before, trace.velocity_m_s, part * gap, np.zeros(2), out)
            open_ += out / parts.size
        lost = trace.friction_N + drag * np.sign(trace.velocity_m_s)
        return trace.with_friction(trace.friction_N - lost * open_)

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Gaps over the distances that the record resolves."""
        return chosen(lengths(context, GAP_RATIO), "gap")

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A gap that takes much of the stroke is no play."""
        return beyond_length("gap", params["gap"], context)

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -F 1(d_rev < gap), or the mean of several such where the gap closes softly."""
        parts = SOFT_CLOSING if params.get("soft", 0.0) >= 0.5 else np.array([1.0])

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            out = np.empty((parts.size, f.size))
            for i, part in enumerate(parts):
                play(f.step_s, f.previous_m_s, f.velocity_m_s, part * params["gap"], s[2 * i : 2 * i + 2], out[i])
            return np.asarray(-out.mean(axis=0) * f.force_N)

        return Columns(compute, state=2 * parts.size, of_force=True)

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:
        """A gap that closes softly: a sample within its last tenth has a part of the force."""
        return [dict(params) | {"soft": 1.0}]

    signs = (1,)
    fixed_gain = True
    refined = ("gap",)
    steps = ("gap",)


def _steps(trace: Trace) -> tuple[Floats, Floats]:
    """Return the time steps (0 first) and the velocities before."""
    step = np.full(trace.time_s.size, trace.step_s)
    step[0] = 0.0
    return step, np.concatenate([trace.velocity_m_s[:1], trace.velocity_m_s[:-1]])
