"""Faults of the force channel as a whole: bias, clipping, resolution."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.quantities import FORCE, quantity
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key, Params, Stated, Words, effect, form_key
from friction_estimator.effects.columns import Columns, per_recording, recordings, several
from friction_estimator.effects.detection import MASKED, NOT_REPAIRED, DataView, Fault
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import below
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.scatter import lattice_interval, moving
from friction_estimator.effects.trace import Trace

LEAST_SHARE = 0.002
"""Of the error power: less is not worth a name."""

ROUNDING = 1e-12
"""Relative: what equal values differ by after a change of units."""

FEWEST_TIES, FEWEST_RUNS = 8, 4

MOST_REPEATS = 0.3
"""Share of samples that repeat the one before them beyond which a lattice is coarse against the noise."""

COARSE = 0.5
"""Share of the error power beyond which a lattice conceals spikes and scatter."""

CUT = 1.0 / 6.0
"""Of a step: as near as that to half a step the mean error is the lattice's that cuts off instead of rounding."""


@effect
class SensorBias(Effect):
    """A constant in the force channel.

    Formula::

        f = F + bias
    """

    name = "sensor_bias"
    family = "zero"
    stage = "sensor"
    keys = (Key("bias", "N", 0.2, -1e6, 1e6, "constant added to the {force}"),)
    size_key = "bias"
    reveals = "velocity_m_s"
    words = Words(
        "the {force} sensor reads a constant too much or too little (f + b)",
        "the mean residual is not zero, at standstill and at the reversals as well",
        {
            "direction_asymmetry": "look at the samples at standstill: a bias is there, an asymmetry is not",
            "bias_step": "record before and after re-zeroing the sensor: a bias is there from the first sample",
            "sensor_drift": "rest periods at both ends of a recording: a bias is the same there, a drift is not",
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
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """A constant of each recording, where there are several: the zero may be another one in each."""
        own = several(features)
        return [own] if own else []

    @classmethod
    def plainer(cls, params: Params) -> list[dict[str, float]]:
        """The same constant in all recordings."""
        return [{}] if recordings(params) > 1 else []

    @classmethod
    def elsewhere(cls, params: Params, weights: Floats) -> tuple[dict[str, float], Floats]:  # noqa: ARG003
        """The mean of what was fitted: each recording may have a zero of its own."""
        return {}, np.array([weights.mean()])

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return the constant 1, for each recording where each has a zero of its own."""
        return Columns(lambda f, _r, _s: per_recording(np.ones((f.size, 1)), f, params), recordings(params))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Bias in N; where each recording has its own, that of the first, and then of the others by their number."""
        names = ["bias", *(f"bias_recording_{number}" for number in range(2, weights.size + 1))]
        return {name: (float(weight), "N") for name, weight in zip(names, weights, strict=True)}


SOFT_REACH = 1.3
"""Largest level of a soft rail, in largest forces: there it takes off 1.5 % of them."""

LEAST_LEVEL = 0.5
"""Smallest level, in largest forces of the model without it: that model follows what was read, and a channel that clips
shows no force much above its level."""

LEAST_CUT = 0.25
"""Share that clipping must take off the force beyond its level; a soft limit takes 0.4 and more, a wrong curve less."""


@effect
class Saturation(Effect):
    """A force channel that clips.

    Formula::

        f = F held within [-level, level]
    """

    name = "saturation"
    family = "range"
    stage = "sensor"
    detects_at = "force"
    figure = "histogram"
    keys = (
        Key("level", "N", 5.0, 1e-9, 1e9, "largest {force} that the channel shows"),
        form_key("soft: f (1 + (|f|/level)^8)^(-1/8), as an amplifier near its rail"),
    )
    size_key = "level"
    linear = False
    reveals = "force_N"
    systematic: ClassVar[Mapping[str, float]] = {"level": 0.25}
    words = Words(
        "the {force} channel clips: values beyond its range are cut",
        "a flat top in the {force}, values pile up at one level",
        {
            "pressure_dependence": "look at the histogram of the {force}: clipping piles values up at one level",
            "direction_asymmetry": "widen the sensor's range",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Clip."""
        force, level = trace.friction_N, self["level"]
        return trace.with_friction(_soft(force, level) if self["form"] >= 0.5 else np.clip(force, -level, level))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Levels from half the largest force upwards; soft ones beyond it, since they bend what lies below."""
        top = context.force_top_N
        hard, soft = np.linspace(LEAST_LEVEL, 0.98, 13), np.linspace(0.6, SOFT_REACH, 13)
        return [
            *({"level": level, "soft": 0.0} for level in top * hard),
            *({"level": level, "soft": 1.0} for level in top * soft),
        ]

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Never beyond where a soft rail still bends something: there its level and its share are one number."""
        return below(value, SOFT_REACH * context.force_top_N)

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:
        """A level that the force never reaches clips nothing, and what goes on rising beyond it is not clipped."""
        level, top = quantity(params["level"], FORCE, ".3g"), context.force_top_N
        if weights.size and weights[0] < LEAST_CUT:
            return f"beyond {level} the {{force}} rises by {1.0 - weights[0]:.2g} of what it would"
        if params["level"] > top * (SOFT_REACH * (1.0 + 1e-6) if _is_soft(params) else 1.0):
            return f"its level of {level} is above every {{force}} of the model"
        if params["level"] < LEAST_LEVEL * top:
            return f"the {{force}} goes on to {quantity(top, FORCE, '.3g')}, beyond its level of {level}"
        return None

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -sgn(F) max(|F| - level, 0); of a soft rail F (1 + (|F|/level)^8)^(-1/8) - F."""
        level, soft = params["level"], _is_soft(params)

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            force = f.force_N
            return (_soft(force, level) if soft else np.clip(force, -level, level)) - force

        return Columns(compute, of_force=True)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find values piled up at the largest force while the shaft moves: far more than at the levels below.

        Where the steps of a lattice are so coarse that values repeat, as many as that lie on each flat part of the
        curve, and more on one level than on the next tells nothing.
        """
        force = view.force_N
        on = view.used & moving(view)
        if view.lattice_N and float(np.mean(np.diff(force)[on[1:]] == 0.0)) > MOST_REPEATS:
            return None
        for sign in (1.0, -1.0):
            side = sign * force[on]
            level = float(side.max()) if side.size else 0.0
            if level <= 0.0:
                continue
            at = side >= level - ROUNDING * level
            runs = int((at & ~np.concatenate([[False], at[:-1]])).sum())
            width = view.lattice_N
            below = int(((side < level - 0.5 * width) & (side >= level - 1.5 * width)).sum()) if width else 0
            if at.sum() >= FEWEST_TIES and runs >= FEWEST_RUNS and at.sum() > 4 * below:
                return Fault(
                    cls.name,
                    f"{int(at.sum())} samples lie exactly at the largest {{force}}, {quantity(level, FORCE)}",
                    {"level": (level, "N", level * (1.0 - 1e-6) - width, level * (1.0 + 1e-6) + width)},
                    MASKED,
                    used=view.used & (np.abs(force) < level - ROUNDING * level),
                )
        return None

    @classmethod
    def repairing_term(cls, fault: Fault) -> dict[str, float] | None:
        """The clipped sensor goes on clipping: its level, with coefficient one."""
        return {"level": fault.parameters["level"][0]}

    signs = (1,)
    refined = ("level",)


def _is_soft(params: Params) -> bool:
    return params.get("soft", 0.0) >= 0.5


def _soft(force: Floats, level: float) -> Floats:
    """Return what an amplifier near its rail shows: f (1 + (|f|/level)^8)^(-1/8), whose largest value is the level.

    Beyond the level the ratio is turned over, so that no power overflows.
    """
    ratio = np.abs(force) / level
    least = np.minimum(ratio, 1.0 / np.maximum(ratio, 1.0))
    return np.sign(force) * level * np.minimum(ratio, 1.0) / (1.0 + least**8) ** 0.125


@effect
class Quantization(Effect):
    """A force channel with coarse steps.

    Formula::

        f = step round(F / step)
    """

    name = "quantization"
    family = "resolution"
    stage = "sensor"
    scatters = True
    detects_at = "force"
    figure = "lattice"
    keys = (
        Key("step", "N", 0.05, 1e-12, 1e6, "distance of neighbouring values"),
        form_key("truncation towards minus infinity instead of rounding"),
    )
    size_key = "step"
    linear = False
    reveals = "force_N"
    words = Words(
        "the {force} is recorded in coarse steps",
        "the {force} takes few distinct, equally spaced values",
        {"dropout": "count how long values repeat: a lattice repeats values, a dropout repeats the last one"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Round to the lattice."""
        snap = np.floor if self["form"] >= 0.5 else np.round
        return trace.with_friction(snap(trace.friction_N / self["step"]) * self["step"])

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find a lattice whose rounding error, step^2 / 12, is a share of the error power worth a name."""
        step, residual = view.lattice_N, view.residual_N
        if step == 0.0 or residual is None:
            return None
        power, error = step * step / 12.0, float(np.var(residual[view.used]))
        if power < LEAST_SHARE * error:
            return None
        force = view.force_N[view.used]
        # Cutting off shifts the mean by half a step; that much is the lattice's and no bias.
        bias = float(np.mean(residual[view.used]))
        cut = abs(abs(bias) - 0.5 * step) <= CUT * step
        seen = f"the {{force}} takes {np.unique(force).size} distinct values, {quantity(step, FORCE)} apart"
        if cut:
            seen += f"; its mean is off by {quantity(bias, FORCE, '.3g')}, as where they are cut off and not rounded: "
            seen += "half a step is taken off, and a zero of the sensor that is off by as much is not told from it"
        return Fault(
            cls.name,
            seen,
            {"step": _with_unit(lattice_interval(force, step), "N")},
            NOT_REPAIRED,
            offset_N=float(np.sign(bias)) * 0.5 * step if cut else 0.0,
            power_N2=power,
            lattice_N=step,
            conceals=power > COARSE * error,
        )


def _with_unit(interval: tuple[float, float, float], unit: str) -> tuple[float, str, float, float]:
    value, low, high = interval
    return value, unit, low, high
