"""Faults of the force channel: bias, clipping, resolution, held values, spikes."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from scipy.stats import binom

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.effects.base import Effect, Key, Params, Words, chosen, effect, form_key
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.detection import MASKED, NOT_REPAIRED, DataView, Fault
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.scatter import MAD, lattice_interval, local_scale, moving
from friction_estimator.effects.trace import Trace

LEAST_SHARE = 0.002
"""Of the error power: less is not worth a name."""

ROUNDING = 1e-12
"""Relative: what equal values differ by after a change of units."""

FEWEST_TIES, FEWEST_RUNS = 8, 4

COARSE = 0.5
"""Share of the error power beyond which a lattice conceals causes that make less."""

CUT = 1.0 / 6.0
"""Of a step: as near as that to half a step the mean error is the lattice's that cuts off instead of rounding."""

LONG_RUN = 5
"""Equal values in a row, one such run is enough among values that never recur."""

FINE_LATTICE = 0.98
"""Share of distinct values below which single repeats are natural."""

SPIKE = 4.8
"""Robust standard deviations of an innovation that count as a spike; white Gaussian noise has one in 600,000."""

SPIKE_CHANCE = 1.7e-6
FEWEST_SPIKES = 4


@effect
class SensorBias(Effect):
    """f + b."""

    name = "sensor_bias"
    family = "bias"
    stage = "sensor"
    keys = (Key("bias", "N", 0.2, -1e6, 1e6, "constant added to the force"),)
    size_key = "bias"
    reveals = "velocity_m_s"
    words = Words(
        "the force sensor reads a constant too much or too little (f + b)",
        "the mean residual is not zero, at standstill and at the reversals as well",
        {
            "direction_asymmetry": "look at the samples at standstill: a bias is there, an asymmetry is not",
            "bias_step": "record before and after re-zeroing the sensor: a bias is there from the first sample",
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
    def columns(cls, params: Params) -> Columns:  # noqa: ARG003
        """Return the constant 1."""
        return Columns(lambda f, _r, _s: np.ones(f.size))

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> dict[str, tuple[float, str]]:  # noqa: ARG003
        """Bias in N."""
        return {"bias": (float(weights[0]), "N")}


@effect
class Saturation(Effect):
    """Clipped at +-level."""

    name = "saturation"
    family = "range"
    stage = "sensor"
    detects_at = "force"
    figure = "histogram"
    keys = (
        Key("level", "N", 5.0, 1e-9, 1e9, "largest force that the channel shows"),
        form_key("soft: f (1 + (|f|/level)^8)^(-1/8), as an amplifier near its rail"),
    )
    size_key = "level"
    linear = False
    reveals = "force_N"
    systematic: ClassVar[Mapping[str, float]] = {"level": 0.25}
    words = Words(
        "the force channel clips: values beyond its range are cut",
        "a flat top in the force, values pile up at one level",
        {
            "pressure_dependence": "look at the histogram of the force: clipping piles values up at one level",
            "direction_asymmetry": "widen the sensor's range",
        },
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Clip."""
        force, level = trace.friction_N, self["level"]
        if self["form"] >= 0.5:
            return trace.with_friction(force / (1.0 + np.abs(force / level) ** 8) ** 0.125)
        return trace.with_friction(np.clip(force, -level, level))

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:
        """Levels from half the largest force upwards."""
        return chosen(context.force_top_N * np.linspace(0.5, 0.98, 13), "level")

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """A level that the force never reaches clips nothing."""
        if params["level"] > context.force_top_N:
            return f"its level of {params['level']:.3g} N is above every force of the model"
        return None

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return -sgn(F) max(|F| - level, 0)."""

        def compute(f: Features, r: Reference, s: Floats) -> Floats:  # noqa: ARG001
            force = f.force_N
            return -np.sign(force) * np.maximum(np.abs(force) - params["level"], 0.0)

        return Columns(compute)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find values piled up at the largest force while the shaft moves: far more than at the levels below."""
        force = view.force_N
        on = view.used & moving(view)
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
                    f"{int(at.sum())} samples lie exactly at the largest force, {level:.4g} N",
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


@effect
class Quantization(Effect):
    """Values on a lattice."""

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
        "the force is recorded in coarse steps",
        "the force takes few distinct, equally spaced values",
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
        return Fault(
            cls.name,
            f"the force takes {np.unique(force).size} distinct values, {step:.4g} N apart",
            {"step": _with_unit(lattice_interval(force, step), "N")},
            NOT_REPAIRED,
            offset_N=float(np.sign(bias)) * 0.5 * step if cut else 0.0,
            power_N2=power,
            conceals_N2=power if power > COARSE * error else 0.0,
        )


@effect
class Dropout(Effect):
    """Held values."""

    name = "dropout"
    family = "transport"
    stage = "sensor"
    detects_at = "force"
    figure = "time"
    keys = (
        Key("fraction", "", 0.02, 0.0, 0.9, "share of samples that repeat the last good one"),
        Key("length", "samples", 5.0, 1.0, 1e4, "length of a dropout"),
        form_key("lengths geometrically distributed about the mean instead of fixed"),
    )
    size_key = "fraction"
    linear = False
    words = Words(
        "samples were lost and the last value was held",
        "runs of exactly equal force values while the velocity moves on",
        {"quantization": "count how long values repeat"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Hold the value before each dropout."""
        n, length = trace.time_s.size, self["length"]
        # Uniform positions drawn first: a larger fraction then only adds dropouts.
        draws = rng.random(n)
        sizes = rng.geometric(1.0 / length, n) if self["form"] >= 0.5 else np.full(n, round(length))
        force = trace.friction_N.copy()
        for start in np.flatnonzero(draws < self["fraction"] / length):
            if start > 0:
                force[start : start + sizes[start]] = force[start - 1]
        return trace.with_friction(force)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find runs of one repeated force value while the shaft moves on.

        On a lattice repeats are natural: there a run must be far longer than the lattice's own runs, and the force
        that the model expects must have moved by two steps in it.
        """
        force, step, n = view.force_N, view.lattice_N, view.force_N.size
        same = np.zeros(n, np.bool_)
        same[1:] = (force[1:] == force[:-1]) & ~view.restart[1:]
        same &= moving(view) & view.used
        if not same.any():
            return None
        start = np.flatnonzero(same & ~np.concatenate([[False], same[:-1]]))
        stop = np.flatnonzero(same & ~np.concatenate([same[1:], [False]])) + 1
        length = stop - start
        fewest = 1 if int(length.max()) >= LONG_RUN else 2
        if step > 0.0:
            natural = min(max(float(same.mean()), 1e-9), 0.999)
            keep = length > max(float(np.log(1e-4 / n) / np.log(natural)), 3.0)
            if view.residual_N is not None:
                expected = force - view.residual_N
                keep &= np.array([np.ptp(expected[a - 1 : b]) > 2.0 * step for a, b in zip(start, stop, strict=True)])
        else:
            # One repeat at the very top is rather a clipped sensor.
            keep = ~((np.abs(force[start]) >= np.abs(force).max()) & (length < 3))
            if np.unique(force).size < FINE_LATTICE * (n - int(same.sum())):
                keep &= length >= 3
                fewest = 8
        start, stop = start[keep], stop[keep]
        lost = int((stop - start).sum())
        # The longest run at the clipping level is no dropout.
        if start.size < fewest or lost < max(6, 1e-4 * n) or np.unique(force[start]).size < 0.5 * start.size:
            return None
        held = np.zeros(n, np.bool_)
        for a, b in zip(start, stop, strict=True):
            held[a:b] = True
        share = float(held.mean())
        reach = 2.0 * float(np.sqrt(np.square(stop - start).sum())) / n
        return Fault(
            cls.name,
            f"{start.size} runs of exactly equal force values while the shaft moves, {lost} samples in all",
            {
                "fraction": (share, "", max(0.0, share - reach), share + reach),
                "length": (lost / start.size, "samples", *_mean_interval(stop - start)),
            },
            MASKED,
            used=view.used & ~held,
        )


@effect
class Outliers(Effect):
    """Spikes."""

    name = "outliers"
    family = "spikes"
    stage = "sensor"
    scatters = True
    detects_at = "residual"
    figure = "time"
    keys = (
        Key("amplitude", "N", 5.0, 0.0, 1e9, "height of a spike"),
        Key("fraction", "", 0.0005, 0.0, 0.5, "share of samples hit"),
        form_key("one-sided, of exponentially distributed height"),
    )
    size_key = "amplitude"
    reveals = "time_s"
    words = Words(
        "single samples are far off (electrical interference)",
        "spikes in the residual: heavy tails",
        {"stick_slip": "spikes last one sample and fall anywhere; stick-slip follows the reversals"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Add the spikes."""
        n = trace.time_s.size
        count = max(1, round(self["fraction"] * n))
        place = rng.choice(n, count, replace=False)
        height = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        if self["form"] >= 0.5:
            height = 0.5 + 0.5 * rng.exponential(1.0, count)
        force = trace.friction_N.copy()
        force[place] += self["amplitude"] * height
        return trace.with_friction(force)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find isolated spikes among the innovations of an autoregression of order two, against the local scale."""
        residual, used = view.residual_N, view.used
        if residual is None or any(fault.conceals_N2 for fault in view.found):
            return None
        usual = MAD * float(np.median(np.abs(residual[used]))) + 1e-300
        calm = np.clip(residual, -2.5 * usual, 2.5 * usual)
        past = np.column_stack([calm[1:-1], calm[:-2]])
        weights = np.linalg.lstsq(past, calm[2:], rcond=None)[0]
        # Clipped neighbours: a spike must not make the sample after it look like one.
        innovation = np.concatenate([residual[:2], residual[2:] - past @ weights])
        size = np.abs(innovation) / local_scale(view.features, used, innovation)
        hit = (size > SPIKE) & used
        neighbours = np.zeros(hit.size)
        for shift in (1, 2, 3):
            neighbours[shift:] += size[:-shift] > np.maximum(3.5, 0.5 * size[shift:])
            neighbours[:-shift] += size[shift:] > np.maximum(3.5, 0.5 * size[:-shift])
        hit &= neighbours == 0
        count = int(hit.sum())
        if count >= FEWEST_SPIKES and _gathered(view, hit):
            return None
        power = float(np.square(innovation[hit]).sum()) / max(int(used.sum()), 1)
        total = float(np.mean(np.square(residual[used])))
        p_value = float(binom.sf(count - 1, residual.size, SPIKE_CHANCE))
        if count < FEWEST_SPIKES or p_value > 1e-4 or power < LEAST_SHARE * total:
            return None
        height = float(np.sqrt(np.mean(np.square(innovation[hit]))))
        reach = height * (0.02 + 2.0 * usual / height / np.sqrt(count)) + 0.5 * float(np.std(np.abs(innovation[hit])))
        share = count / residual.size
        spread = 2.0 * float(np.sqrt(count)) / residual.size
        return Fault(
            cls.name,
            f"{count} isolated spikes of about {height:.3g} N",
            {
                "amplitude": (height, "N", height - reach, height + reach),
                "fraction": (share, "", max(0.0, share - spread), share + spread),
            },
            MASKED,
            p_value=p_value,
            used=used & ~hit,
            power_N2=power,
        )


def _with_unit(interval: tuple[float, float, float], unit: str) -> tuple[float, str, float, float]:
    value, low, high = interval
    return value, unit, low, high


def _mean_interval(values: Ints) -> tuple[float, float]:
    mean = float(np.mean(values))
    reach = 2.0 * float(np.std(values)) / float(np.sqrt(len(values))) + 0.5
    return mean - reach, mean + reach


def _gathered(view: DataView, hit: Bools) -> bool:
    """Return whether hits gather at one place of the cycle: then they are a cause, not interference."""
    f = view.features
    since = np.where(np.isfinite(f.since_reversal_s), f.since_reversal_s, 1e9)
    for values in (since, f.velocity_m_s, f.position_m):
        edges = np.quantile(values, np.linspace(0.0, 1.0, 26)[1:-1])
        cell = np.searchsorted(edges, values[hit])
        if np.bincount(cell).max() > max(3.0, 0.3 * cell.size):
            return True
    return False
