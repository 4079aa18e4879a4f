"""Figures of a diagnosis: for each effect the residual against the variable that reveals it, before and after."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from friction_estimator.core.quantities import ACCELERATION, FORCE, POSITION, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.result import Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.effects.grids import first_distance_m
from friction_estimator.report import style

SHOWN = 5000

BINS, MOST_BINS = 60, 400
"""Bins of a mean: as many as the samples allow, since a ripple finer than the bins shows as one that is not there."""

IN_BIN = 40
"""Samples in a bin where there are more than the fewest bins."""

LEVELS = 8
"""A variable that stays at so few levels, pressures for one, is shown by the mean at each."""

AXES: dict[str, tuple[str, str, float]] = {
    "time_s": ("time", "s", 1.0),
    "velocity_m_s": ("velocity", VELOCITY, 1.0),
    "acceleration_m_s2": ("acceleration", ACCELERATION, 1.0),
    "position_m": ("position", POSITION, 1.0),
    "distance_m": ("distance run", POSITION, 1.0),
    "since_reversal_m": ("distance since the reversal", POSITION, 1.0),
    "since_reversal_s": ("time since the reversal", "ms", 1e3),
    "pressure_Pa": ("gauge pressure", "bar", 1e-5),
    "force_N": ("{force} of the base model", FORCE, 1.0),
}
"""Variable -> what an axis calls it, its unit on a linear drive, and the factor to that."""

FINER = ((0.1, "m", 1e3), (1e-3, "µ", 1e6))
"""Motion that the reader wants in SI units is shown in mm or mrad where it stays below 0.1, and in µm below 1e-3."""

NEAR = {"since_reversal_m": 12.0, "since_reversal_s": 12.0}
"""After a reversal only this many times the effect's own length or time is shown."""


FEWEST_SHOWN = 8.0
"""But at least this many sample periods, or as many times the distance moved in the first."""


REMAINDER = "remainder"
"""Name of the figure of what is left."""


_NOTHING = np.zeros(0)


class Axis:
    """A variable on an axis: its label, and its values in the label's unit.

    Parameters
    ----------
    name : what it is called. unit : on a linear drive. factor : to that unit.
    values : (n,), of which the size decides how fine motion is shown; as it is where there are none.
    """

    def __init__(
        self, quantities: Quantities, name: str, unit: str, factor: float = 1.0, values: Floats = _NOTHING
    ) -> None:
        shown, self.factor = quantities.unit(unit), factor * quantities.value(1.0, unit)
        finite = np.abs(values[np.isfinite(values)])
        top = float(finite.max()) if finite.size else 0.0
        if unit in (POSITION, VELOCITY) and not quantities.shown:
            for limit, prefix, finer in FINER:
                if 0.0 < top < limit:
                    shown, self.factor = f"{prefix}{quantities.unit(unit)}", finer
        self.label = f"{quantities.worded(name)} ({shown})"

    def __call__(self, values: Floats) -> Floats:
        """Return values in the label's unit."""
        return values * self.factor


def axis_of(variable: str, quantities: Quantities, values: Floats) -> Axis:
    """Return the axis of a field of `Features` with these values."""
    name, unit, factor = AXES[variable]
    return Axis(quantities, name, unit, factor, values)


def write_diagnosis_figures(
    result: Diagnosis,
    folder: str | os.PathLike[str],
    quantities: Quantities,
    formats: Sequence[str] = style.USUAL,
) -> dict[str, Path]:
    """Draw one figure for each effect and one for what is left; return effect id -> file.

    The remainder's figure is filed under "remainder".
    """
    out = {}
    for found in result.effects:
        out[found.name] = style.save(_modelled(result, found, quantities), folder, found.name, formats)
    for fault in result.faults:
        figure = Figure(figsize=(10, 4.2))
        FIGURES[EFFECTS[fault.name].figure](figure, result, fault, quantities)
        out[fault.name] = style.save(figure, folder, fault.name, formats)
    if result.remainder is not None:
        out[REMAINDER] = style.save(_remainder(result, quantities), folder, REMAINDER, formats)
    return out


def _modelled(result: Diagnosis, found: Found, quantities: Quantities) -> Figure:
    """Residual before, with the fitted term; residual after."""
    if EFFECTS[found.name].delays:
        return _delayed(result, found, quantities)
    number = found.term
    before, after = result.models[number], result.models[number + 1]
    # The term as it stands in the final model; what the residual lacked before is its projected part.
    name = EFFECTS[found.name].reveals
    values = after.features.force_N if name == "force_N" else getattr(after.features, name)
    used = result.record.used & np.isfinite(values)
    reach = reach_of(name, found, result)
    used &= values <= reach
    across = axis_of(name, quantities, values[used])
    turns = EFFECTS[found.name].turns
    folded = np.sign(result.record.features.velocity_m_s) if turns else np.ones(values.size)
    figure = Figure(figsize=(10, 4.2))
    axes = figure.subplots(1, 2, sharey=True)
    up = Axis(quantities, "residual, in the direction of motion" if turns else "residual", FORCE)
    first, last = up(before.residual_N * folded), up(after.residual_N * folded)
    _cloud(axes[0], across(values), first, used)
    _line(axes[0], across(values), first, used, style.RESIDUAL, "mean residual")
    _line(axes[0], across(values), first - last, used, style.PREDICTED, "what the effect takes off it", "--")
    axes[0].set(
        title=f"before: base model{' and earlier effects' if number else ''}", xlabel=across.label, ylabel=up.label
    )
    _cloud(axes[1], across(values), last, used)
    _line(axes[1], across(values), last, used, style.RESIDUAL, "mean residual")
    axes[1].set(title=f"after: with {found.name}", xlabel=across.label)
    _limits(axes, first[used], last[used])
    axes[0].legend(loc="upper right", fontsize=8)
    return figure


def _delayed(result: Diagnosis, found: Found, quantities: Quantities) -> Figure:
    """One reversal as it was measured and as both models have it; their residuals after all reversals.

    The base model's memory bends towards a time of the whole force, so that its mean residual alone shows no delay.
    """
    before, after = result.models[found.term], result.models[found.term + 1]
    features, force = result.record.features, result.record.friction_N
    since, step = features.since_reversal_s, result.context.step_s
    (time,) = (e.value for e in found.parameters.values())
    reach = max(NEAR["since_reversal_s"] * time, FEWEST_SHOWN * step)
    up = Axis(quantities, "{force}", FORCE)
    figure = Figure(figsize=(10, 4.2))
    axes = figure.subplots(1, 2)
    starts = np.flatnonzero((np.diff(np.where(np.isfinite(since), since, 0.0), prepend=0.0) < 0.0) & result.record.used)
    # The sharpest reversal of the middle ones: there a time shows best.
    starts = starts if starts.size else np.array([since.size // 2])
    sharp = np.abs(features.acceleration_m_s2[starts])
    here = int(starts[np.argsort(np.abs(starts - since.size // 2) / since.size - sharp / max(sharp.max(), 1e-300))[0]])
    count = round(reach / step)
    part = slice(max(0, here - count // 3), here + count)
    at = (features.time_s[part] - features.time_s[here]) * 1e3
    axes[0].plot(at, up(force[part]), "o", ms=4, color=style.MEASURED, label="measured")
    for model, color, name in ((before, style.THEORY, "base model"), (after, style.PREDICTED, f"with {found.name}")):
        axes[0].plot(at, up((force - model.residual_N)[part]), color=color, lw=1.4, label=name)
    axes[0].set(title="one reversal", xlabel="time since the reversal (ms)", ylabel=up.label)
    axes[0].legend(fontsize=8)
    used = result.record.used & np.isfinite(since) & (since <= reach)
    up = Axis(quantities, "residual, in the direction of motion", FORCE)
    folded = np.sign(features.velocity_m_s)
    for model, color, name in ((before, style.THEORY, "base model"), (after, style.PREDICTED, f"with {found.name}")):
        where = np.flatnonzero(used)[:: max(1, int(used.sum()) // SHOWN)]
        shift = 0.1 * step * (1.0 if model is after else -1.0)  # samples of both stand side by side
        axes[1].plot(
            (since[where] + shift) * 1e3, up(model.residual_N * folded)[where], ".", ms=3, color=color, label=name
        )
    axes[1].set(title="all reversals", xlabel="time since the reversal (ms)")
    axes[1].set(ylabel=up.label)
    _limits([axes[1]], up(before.residual_N * folded)[used])
    axes[1].legend(loc="upper right", fontsize=8)
    return figure


def reach_of(name: str, found: Found, result: Diagnosis) -> float:
    """Return the largest value of the revealing variable that is shown."""
    if name not in NEAR:
        return float("inf")
    sizes = [found.parameters[k].value for k in ("length", "gap", "delay", "time_constant") if k in found.parameters]
    by_time = name == "since_reversal_s"
    one = result.context.step_s if by_time else first_distance_m(result.context)
    return max(NEAR[name] * (sizes[0] if sizes else 4.0 * one), FEWEST_SHOWN * one)


def _lattice(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:
    """The values about the median, and an excerpt at the largest."""
    step = found.parameters["step"][0]
    force = result.raw.friction_N
    near = force[np.abs(force - float(np.median(force))) < 12 * step]
    _histogram_of(figure, result, near, 240, f"values lie {quantities.text(step, FORCE, '.3g')} apart", quantities)


def _histogram(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:
    """The values near a level at which they pile up, and an excerpt at the largest."""
    level = found.parameters["level"][0]
    force = result.raw.friction_N
    top = force[np.abs(force) > 0.8 * level]
    _histogram_of(figure, result, top, 160, f"values pile up at {quantities.text(level, FORCE)}", quantities)


def _histogram_of(
    figure: Figure, result: Diagnosis, values: Floats, bins: int, title: str, quantities: Quantities
) -> None:
    across = Axis(quantities, "measured {force}", FORCE)
    axes = figure.subplots(1, 2)
    axes[0].hist(across(values), bins=bins, color=style.MEASURED)
    axes[0].set(title=title, xlabel=across.label, ylabel="samples")
    _excerpt(axes[1], result, int(np.argmax(np.abs(result.raw.friction_N))), quantities)


def _scatter_after_reversal(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:
    axes = figure.subplots(1, 2)
    up = Axis(quantities, "residual", FORCE)
    residual = up(result.models[-1].residual_N)
    since = result.record.features.since_reversal_s
    used = result.record.used & np.isfinite(since) & (since < 8.0 * found.parameters["decay"][0])
    _cloud(axes[0], since * 1e3, residual, used)
    axes[0].set(title="residual after reversals", xlabel="time since the reversal (ms)", ylabel=up.label)
    edges = np.quantile(since[used], np.linspace(0.0, 1.0, 31))
    cell = np.clip(np.searchsorted(edges, since[used], side="right") - 1, 0, 29)
    spread = [float(np.sqrt(np.mean(np.square(residual[used][cell == k])))) for k in range(30) if np.any(cell == k)]
    middle = [float(since[used][cell == k].mean()) * 1e3 for k in range(30) if np.any(cell == k)]
    axes[1].plot(middle, spread, "o-", ms=3, color=style.RESIDUAL, label="measured")
    a, d = up.factor * found.parameters["amplitude"][0], found.parameters["decay"][0] * 1e3
    floor = float(np.min(spread))
    fitted = np.sqrt(floor**2 + 0.5 * a * a * np.exp(-2.0 * np.array(middle) / d))
    axes[1].plot(middle, fitted, color=style.PREDICTED, label="fitted burst")
    axes[1].set(
        title="its scatter", xlabel="time since the reversal (ms)", ylabel=f"rms of the {up.label}", ylim=(0, None)
    )
    axes[1].legend()


def _velocity(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:  # noqa: ARG001
    """Reported velocity and the derivative of the position, in time and one against the other."""
    axes = figure.subplots(1, 2)
    time, reported = result.raw.features.time_s, result.raw.features.velocity_m_s
    derived = np.gradient(result.raw.features.position_m, time)
    kinds = ("velocity", "derivative of position", "reported velocity")
    plain, across, up = (Axis(quantities, kind, VELOCITY, 1.0, reported) for kind in kinds)
    axes[0].plot(time, plain(reported), color=style.MEASURED, label="reported velocity")
    axes[0].plot(time, plain(derived), color=style.PREDICTED, lw=0.8, label="derivative of position")
    axes[0].set(title="velocity", xlabel="time (s)", ylabel=plain.label, xlim=(time[0], time[0] + 10))
    axes[0].legend(fontsize=8, loc="upper right")
    axes[1].plot(across(derived), up(reported), ".", ms=1, color=style.MEASURED)
    axes[1].set(title="one against the other", xlabel=across.label, ylabel=up.label)


def _stamps(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:
    """Steps between stamps, and the position about the place where they jump."""
    axes = figure.subplots(1, 2)
    time, position = result.raw.features.time_s, result.raw.features.position_m
    axes[0].plot(time[1:], np.diff(time) * 1e3, ".", ms=2, color=style.MEASURED)
    axes[0].set(title="steps between stamps", xlabel="time (s)", ylabel="step (ms)")
    at = found.parameters["at"][0] if "at" in found.parameters else float(time[time.size // 2])
    middle = int(np.searchsorted(time, at))
    part = slice(max(0, middle - 40), middle + 40)
    up = Axis(quantities, "position", POSITION, 1.0, position)
    axes[1].plot(time[part], up(position[part]), ".-", ms=4, color=style.MEASURED)
    axes[1].set(title="position about the jump" if "at" in found.parameters else "an excerpt", xlabel="time (s)")
    axes[1].set(ylabel=up.label)


def _position(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:  # noqa: ARG001
    """The position as it was recorded and as it is used."""
    axes = figure.subplots()
    time, used = result.raw.features.time_s, result.record.features.position_m
    shift = result.record.samples.position_shift_m
    shown = result.raw.features.position_m if shift is None else used - shift
    up = Axis(quantities, "position", POSITION, 1.0, used)
    axes.plot(time, up(shown), color=style.MEASURED, label="recorded")
    axes.plot(time, up(used), color=style.PREDICTED, lw=0.8, label="unwrapped")
    axes.set(title="position", xlabel="time (s)", ylabel=up.label)
    axes.legend(fontsize=8, loc="upper right")


def _smoothed_velocity(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:  # noqa: ARG001
    """What was smoothed off the velocity, and an excerpt."""
    before, after = result.raw.features.velocity_m_s, result.record.features.velocity_m_s
    up = Axis(quantities, "velocity", VELOCITY, 1.0, after)
    _smoothed(figure, result, up(before), up(after), up.label)


def _smoothed_pressure(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:  # noqa: ARG001
    """What was smoothed off the pressure, and an excerpt."""
    before, after = result.raw.features.pressure_Pa, result.record.features.pressure_Pa
    _smoothed(figure, result, before * 1e-5, after * 1e-5, "gauge pressure (bar)")


def _smoothed(figure: Figure, result: Diagnosis, before: Floats, after: Floats, label: str) -> None:
    axes = figure.subplots(1, 2)
    axes[0].hist(before - after, bins=120, color=style.MEASURED)
    axes[0].set(title="measured minus smoothed", xlabel=label, ylabel="samples")
    time, middle = result.raw.features.time_s, before.size // 2
    part = slice(max(0, middle - 60), middle + 60)
    axes[1].plot(time[part], before[part], ".-", ms=3, color=style.MEASURED, label="measured")
    axes[1].plot(time[part], after[part], color=style.PREDICTED, label="smoothed")
    axes[1].set(title="an excerpt", xlabel="time (s)", ylabel=label)
    axes[1].legend(fontsize=8)


def _masked(figure: Figure, result: Diagnosis, found: Fault, quantities: Quantities) -> None:
    """The residual in time with the masked samples marked, and an excerpt about the first of them."""
    axes = figure.subplots(1, 2)
    raw, record = result.raw, result.record
    masked = raw.used & ~record.used
    up = Axis(quantities, "residual", FORCE)
    residual = up(result.models[-1].residual_N)
    time = raw.features.time_s
    thin = np.arange(0, time.size, max(1, time.size // SHOWN))
    axes[0].plot(time[thin], residual[thin], ".", ms=1.5, color=style.MEASURED, label="kept")
    axes[0].plot(time[masked], residual[masked], "x", ms=5, color=style.PREDICTED, label="masked")
    axes[0].set(title=f"{found.name}: {int(masked.sum())} samples masked", xlabel="time (s)", ylabel=up.label)
    axes[0].legend(loc="upper right", fontsize=8)
    where = int(np.flatnonzero(masked)[0]) if masked.any() else time.size // 2
    _excerpt(axes[1], result, where, quantities)


FIGURES: dict[str, Callable[[Figure, Diagnosis, Fault, Quantities], None]] = {
    "lattice": _lattice,
    "histogram": _histogram,
    "scatter": _scatter_after_reversal,
    "time": _masked,
    "stamps": _stamps,
    "velocity": _velocity,
    "wraps": _position,
    "smoothed velocity": _smoothed_velocity,
    "smoothed pressure": _smoothed_pressure,
}
"""`Effect.figure` -> what draws it for a fault of the data; "reveals", the residual over a variable, is `_modelled`."""


def _excerpt(axes: Axes, result: Diagnosis, middle: int, quantities: Quantities) -> None:
    """Draw a short piece of the measured force about a sample."""
    time, force = result.raw.features.time_s, result.raw.friction_N
    part = slice(max(0, middle - 60), middle + 60)
    up = Axis(quantities, "{force}", FORCE)
    axes.plot(time[part], up(force[part]), ".-", ms=4, color=style.MEASURED, label="measured")
    predicted = result.record.friction_N - result.models[-1].residual_N
    axes.plot(time[part], up(predicted[part]), color=style.PREDICTED, label="model")
    axes.set(title="an excerpt", xlabel="time (s)", ylabel=up.label)
    axes.legend(fontsize=8)


def _remainder(result: Diagnosis, quantities: Quantities) -> Figure:
    """Residual of the last model against the variable that it still depends on, in each direction."""
    remainder = result.remainder
    assert remainder is not None
    residual, features = result.models[-1].residual_N, result.models[-1].features
    figure = Figure(figsize=(8, 4.2))
    axes = figure.subplots()
    if remainder.variable == "frequency":
        used = result.record.used
        power = np.abs(np.fft.rfft(residual * used)) * 2.0 / max(int(used.sum()), 1)
        frequency = np.fft.rfftfreq(residual.size, result.context.step_s)
        up = Axis(quantities, "amplitude", FORCE)
        power = up(power)
        axes.plot(frequency, power, color=style.RESIDUAL, lw=0.7)
        axes.plot(
            remainder.frequency_hz, np.interp(remainder.frequency_hz, frequency, power), "v", color=style.PREDICTED
        )
        axes.set(title="spectrum of the residual", xlabel="frequency (Hz)", ylabel=up.label)
        return figure
    values = features.force_N if remainder.variable == "force_N" else getattr(features, remainder.variable)
    used = result.record.used & np.isfinite(values)
    if remainder.variable in NEAR:
        used &= values <= np.quantile(values[used], 0.3)
    across = Axis(quantities, *AXES[remainder.variable], values[used])
    up = Axis(quantities, "size of the residual" if remainder.kind == "variance" else "residual", FORCE)
    shown = up(np.abs(residual) if remainder.kind == "variance" else residual)
    _cloud(axes, across(values), shown, used)
    forward = result.record.features.velocity_m_s > 0.0
    _line(axes, across(values), shown, used & forward, style.PREDICTED, "mean, forward")
    _line(axes, across(values), shown, used & ~forward, style.THEORY, "mean, backward")
    axes.set(title="what no named cause explains", xlabel=across.label, ylabel=up.label)
    _limits([axes], shown[used])
    axes.legend(loc="upper right", fontsize=8)
    return figure


def _cloud(axes: Axes, x: Floats, y: Floats, used: Bools) -> None:
    where = np.flatnonzero(used)
    where = where[:: max(1, where.size // SHOWN)]
    axes.plot(x[where], y[where], ".", ms=1.5, color=style.MEASURED, alpha=0.45, zorder=1, rasterized=True)


def _line(axes: Axes, x: Floats, y: Floats, used: Bools, color: str, label: str, dashes: str = "-") -> None:
    """Draw the mean in quantile bins of x; where x has a few levels only, the mean of each."""
    if used.sum() < BINS:
        return
    bins = int(np.clip(used.sum() // IN_BIN, BINS, MOST_BINS))
    even = np.linspace(float(x[used].min()), float(x[used].max()), BINS + 1)
    held = np.histogram(x[used], even)[0] > 0.002 * used.sum()
    change = np.diff(held.astype(int))
    starts, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    few = starts.size + int(held[0]) <= LEVELS and held.mean() < 0.2
    if few:  # edges in the middle of the empty stretches between levels
        gaps = [0.5 * (even[a + 1] + even[b + 1]) for a in ends for b in starts[starts >= a][:1]]
        edges = np.array([even[0], *gaps, even[-1]])
    else:
        edges = _apart(np.quantile(x[used], np.linspace(0.0, 1.0, bins + 1)), bins)
    if edges.size < 3:
        return
    cell = np.clip(np.searchsorted(edges, x[used], side="right") - 1, 0, edges.size - 2)
    count = np.bincount(cell, minlength=edges.size - 1)
    keep = count > 0
    middle = np.bincount(cell, weights=x[used], minlength=edges.size - 1)[keep] / count[keep]
    mean = np.bincount(cell, weights=y[used], minlength=edges.size - 1)[keep] / count[keep]
    axes.plot(middle, mean, ("o" if few else "") + dashes, ms=6, color=color, lw=1.8, label=label, zorder=3)


def _apart(edges: Floats, bins: int) -> Floats:
    """Return edges of which none is closer to the next than half of what even bins would be wide.

    Samples that a periodic drive puts at the same places would otherwise have bins of their own, one over the other.
    """
    least = 0.5 * float(edges[-1] - edges[0]) / bins
    kept = [float(edges[0])]
    for edge in edges[1:-1].tolist():
        if edge - kept[-1] >= least and edges[-1] - edge >= least:
            kept.append(edge)
    return np.unique([*kept, float(edges[-1])])


def _limits(axes: "np.ndarray | list[Axes]", *values: Floats) -> None:
    """Show all but the farthest thousandth, with room for the legend."""
    low = min(float(np.quantile(v, 0.001)) for v in values)
    high = max(float(np.quantile(v, 0.999)) for v in values)
    room = 0.08 * (high - low)
    for one in np.ravel(np.asarray(axes, dtype=object)):
        one.set_ylim(low - room, high + 3.0 * room)
