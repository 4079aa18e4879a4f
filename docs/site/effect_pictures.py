"""A picture of each effect: the signal that it changes, and the change over what reveals it, as the rig has it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from friction_estimator.core.quantities import FORCE, LINEAR, POSITION, ROTARY, VELOCITY, Quantities
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.effects.base import EFFECTS, SLOW, Effect
from friction_estimator.effects.compose import compose
from friction_estimator.effects.features import FeatureMaker, Features
from friction_estimator.effects.trace import Trace
from friction_estimator.report import style
from friction_estimator.report.diagnosis_figures import Axis, axis_of
from friction_estimator.rig.drive import parse_schedule
from friction_estimator.rig.plant import PLANTS, Law
from friction_estimator.rig.plants_load import PendulumPlant
from friction_estimator.rig.profiles import Geometry
from friction_estimator.rig.sensors import as_samples
from friction_estimator.rig.simulate import Scenario, change_alone, clean_trace

SIZE = 0.1
"""Rms of the change over that of friction: several times what the diagnosis finds, to be seen in a small picture."""

MOTION = {"gravity": ROTARY, "load_dependence": ROTARY}
"""Effects of joints that turn; all others are drawn on the simulated seal."""

SHORT, LONG, PRESSURES = "2:50:4", "2:50:24", "2:50:4,2:200:4,2:125:4"
"""Schedules: two cycles; what changes slowly or once; three pressures."""

VALUES: Mapping[str, Mapping[str, float]] = {
    "viscosity_drift": {"time_constant": 8.0},
    "wear": {"length": 0.3},
    "bias_step": {"at": 12.0},
    "gain_step": {"at": 12.0},
    "clock_jump": {"at": 2.0},
    "periodic_disturbance": {"frequency": 5.0},
    "position_dependence": {"wavelength": 8e-3},
    "dropout": {"length": 60.0},
    "duplicate_stamps": {"fraction": 0.05},
}
"""Values with which an effect shows within the few cycles of a picture; all others are the defaults."""

REVERSALS = ("since_reversal_m", "since_reversal_s")
NEAR = 0.04
"""Share of a cycle that is drawn after a reversal."""


@dataclass(frozen=True)
class Shown:
    """One run, without and with the effect, at the recording's rate."""

    effect: Effect
    before: Trace
    after: Trace
    change: Floats
    quantities: Quantities


def draw(cls: type[Effect], folder: Path) -> Path:
    """Draw the picture of an effect into `folder`; return the file."""
    shown = _run(cls)
    figure = Figure(figsize=(8.0, 2.7))
    left, right = figure.subplots(1, 2)
    _signal(left, shown)
    _change(right, shown)
    return style.save(figure, folder, cls.name, ("svg",))


def _run(cls: type[Effect]) -> Shown:
    rotary = MOTION.get(cls.name, LINEAR) == ROTARY
    pressures = "pressure" in (cls.channel, cls.reveals.partition("_")[0])
    slow = cls.acts == SLOW
    scenario = Scenario(
        parse_schedule(PRESSURES if pressures else LONG if slow else SHORT),
        plant="clean",
        rate_hz=500.0,
        geometry=Geometry(1.2, 6.0) if rotary else Geometry(),
    )
    config = Config()
    law: Law = PLANTS["clean"](config.seal, scenario.rate_hz)
    if rotary:
        law = PendulumPlant(config.seal, scenario.rate_hz).friction
    clean = clean_trace(scenario, law)
    values: dict[str, object] = dict(VALUES.get(cls.name, {}))
    size = SIZE if cls.size_key and cls.size_key not in values else None
    before, _ = compose(clean, [], noise=0.0, every=scenario.every, seed=1)
    after, (effect,) = compose(clean, [cls(size=size, **values)], noise=0.0, every=scenario.every, seed=1)
    change = change_alone(effect, clean, scenario.every, np.random.default_rng(1))
    return Shown(effect, before, after, change, Quantities(ROTARY if rotary else LINEAR))


def _signal(axes: Axes, shown: Shown) -> None:
    """Draw the first of the recorded signals that the effect changes."""
    before, after, q = shown.before, shown.after, shown.quantities
    time = before.time_s
    signals = (
        ("{force}", FORCE, 1.0, before.friction_N, after.friction_N),
        ("velocity", VELOCITY, 1.0, before.velocity_measured_m_s, after.velocity_measured_m_s),
        ("position", POSITION, 1.0, before.position_measured_m, after.position_measured_m),
        ("gauge pressure", "bar", 1e-5, before.pressure_Pa, after.pressure_Pa),
    )
    for name, unit, factor, without, with_it in signals:
        if not np.array_equal(without, with_it):
            up = Axis(q, name, unit, factor, without)
            part = _excerpt(shown, without, with_it)
            axes.plot(time[part], up(without[part]), color=style.MEASURED, lw=2.0, label="without")
            axes.plot(time[part], up(with_it[part]), color=style.PREDICTED, lw=0.9, label="with")
            axes.set(xlabel="time (s)", ylabel=up.label)
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=7, ncols=2)
            return
    between = np.any(after.friction_stamp_ns != after.stamp_ns)
    for trace, color, width, name in ((before, style.MEASURED, 2.0, "without"), (after, style.PREDICTED, 0.9, "with")):
        stamps = trace.friction_stamp_ns - trace.stamp_ns if between else np.diff(trace.friction_stamp_ns)
        axes.plot(time[time.size - stamps.size :], 1e-6 * stamps, color=color, lw=width, label=name)
    axes.set(xlabel="time (s)", ylabel="stamp of force - stamp of velocity (ms)" if between else "step of stamps (ms)")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=7, ncols=2)


def _excerpt(shown: Shown, without: Floats, with_it: Floats) -> slice:
    """Return what is drawn over time: all, or the time about a reversal where the effect acts there only."""
    if EFFECTS[shown.effect.name].reveals not in REVERSALS:
        return slice(None)
    step = shown.before.step_s
    turns = np.flatnonzero(np.diff(np.sign(shown.before.velocity_m_s)) != 0)
    near = round(NEAR * float(shown.before.period_s[0]) / step)
    middle = int(turns[turns.size // 2]) if turns.size else int(np.argmax(np.abs(with_it - without)))
    return slice(max(0, middle - near // 3), middle + near)


def _change(axes: Axes, shown: Shown) -> None:
    """Draw the change of the force over the variable that reveals the effect."""
    cls, before, after, q = type(shown.effect), shown.before, shown.after, shown.quantities
    if not np.any(shown.change):
        if np.array_equal(before.position_measured_m, after.position_measured_m):
            axes.plot(before.time_s, (after.stamp_ns - before.stamp_ns) * 1e-6, color=style.PREDICTED)
            axes.set(xlabel="time (s)", ylabel="change of the stamp (ms)")
            return
        across = Axis(q, "true position", POSITION, 1.0, before.position_m)
        axes.plot(across(before.position_m), across(after.position_measured_m), ".", ms=2, color=style.PREDICTED)
        axes.set(xlabel=across.label, ylabel=across.label.replace("true", "shown"))
        return
    features = _features(after)
    values = before.friction_N if cls.reveals == "force_N" else getattr(features, cls.reveals)
    used = np.isfinite(values)
    if cls.reveals in REVERSALS:
        used &= features.since_reversal_s <= NEAR * before.period_s[0]
    across = axis_of(cls.reveals, q, values[used])
    folded = np.sign(before.velocity_m_s) if cls.turns else np.ones(values.size)
    up = Axis(q, "change of the {force}" + (", in the direction of motion" if cls.turns else ""), FORCE)
    axes.plot(across(values[used]), up(shown.change * folded)[used], ".", ms=2, color=style.PREDICTED, rasterized=True)
    if np.ptp(shown.change) < 1e-6 * np.abs(shown.change).max():  # a constant
        axes.set_ylim(0.0, 2.0 * float(up(shown.change).max()))
    label = up.label.replace(", in the", ",\nin the")
    axes.set(xlabel=across.label.replace(" of the base model", ""), ylabel=label)


def _features(trace: Trace) -> Features:
    theory = Config().theory
    clean = replace(
        trace, velocity_measured_m_s=trace.velocity_m_s, position_measured_m=trace.position_m
    )  # over the true motion
    regular = replace(clean, stamp_ns=np.round(trace.time_s * 1e9).astype(np.int64))
    maker = FeatureMaker(theory.ambient_pressure, theory.default_pressure, theory.default_temperature)
    return maker(as_samples(regular))
