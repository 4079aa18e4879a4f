"""Figures of a replay: signals, convergence, the learned map and the taps."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from friction_estimator.core import metrics, series, sums
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.model.load import LoadTerms
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.series import Formed, Series
from friction_estimator.report import style

SHOWN_SAMPLES = 4000
"""Points drawn of a signal: more hide each other."""

DENSITY_CELLS = (240, 150)
"""Cells of velocity and friction in which samples are counted; fewer where samples are few."""

LEARNED = 0.5
"""Share of the prior's variance that data must have removed for a curve to count as learned there."""

FIGURES = ("signals", "convergence", "friction_map", "taps")
"""Names of the files that `write_figures` writes."""


def write_figures(
    replay: Replay,
    folder: str | os.PathLike[str],
    quantities: Quantities | None = None,
    formats: Sequence[str] = style.USUAL,
    *,
    fitted: bool = False,
) -> list[tuple[Path, str]]:
    """Draw every figure of a replay into `folder`; return (file, caption) in the order of reading.

    Parameters
    ----------
    quantities : how numbers are shown; in SI units unless given. formats : of the files, some of `style.FORMATS`.
    fitted : True for a batch fit: its samples were all known, and none was predicted before it was used.
    """
    q = quantities or replay.config.quantities
    when = (
        "All samples were known to the fit." if fitted else "Every prediction was made before its measurement was used."
    )
    return [
        (
            style.save(signals(replay, q), folder, "signals", formats),
            f"Start and end of the record: velocity, measured and predicted friction, and what is left. {when}",
        ),
        (
            style.save(convergence(replay, fitted), folder, "convergence", formats),
            "Error of each drive cycle over the standard deviation of the measured friction, beside the guess that "
            "friction stays as it was one sample ago, and the theoretical curve alone.",
        ),
        (
            style.save(friction_map(replay, q), folder, "friction_map", formats),
            "Friction at constant velocity as it was learned, with its 95 % band, over the measured friction (the "
            "darker, the more samples). Dashed and grey: what no data support. Beside it Coulomb and viscous friction "
            "fitted to the same samples.",
        ),
        (
            style.save(taps(replay), folder, "taps", formats),
            "FIR taps as they were fitted." if fitted else "FIR taps while they are learned, and their last values.",
        ),
    ]


def signals(replay: Replay, quantities: Quantities) -> Figure:
    """Velocity, friction and residual in the first and the last cycles."""
    samples, n = replay.samples, len(replay.samples)
    speed, force = quantities.value(1.0, VELOCITY), quantities.value(1.0, FORCE)
    first, last = (_excerpt_length(samples[part]) for part in (replay.parts[0], replay.parts[-1]))
    figure = Figure(figsize=(10, 6))
    axes = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, (part, title) in enumerate(((slice(0, first), "start"), (slice(n - last, n), "end"))):
        time = replay.time_s[part]
        thin = slice(None, None, max(1, time.size // SHOWN_SAMPLES))
        axes[0, column].plot(time[thin], speed * samples.velocity_m_s[part][thin], color=style.THEORY)
        measured, predicted, residual = (
            force * values[part][thin] for values in (samples.friction_N, replay.predicted_N, replay.residual_N)
        )
        axes[1, column].plot(time[thin], measured, color=style.MEASURED, lw=2.4, label="measured")
        axes[1, column].plot(time[thin], predicted, color=style.PREDICTED, label="predicted", lw=0.9)
        axes[2, column].plot(time[thin], residual, color=style.RESIDUAL, lw=0.7)
        axes[0, column].set_title(f"{title} of the record")
        axes[2, column].set_xlabel("time (s)")
        # A start-up transient must not flatten everything else.
    reach = 1.15 * usual_size(samples.friction_N)
    axes[1, 0].set_ylim(-force * reach, force * reach)
    left = replay.residual_N
    error_reach = 4.0 * float(np.sqrt(sums.mean_square(lambda part: np.clip(left[part], -reach, reach), n)))
    if error_reach > 0.0:
        axes[2, 0].set_ylim(-force * error_reach, force * error_reach)
    labels = {"velocity": quantities.velocity, "friction": quantities.force, "measured - predicted": quantities.force}
    for row, (name, unit) in enumerate(labels.items()):
        axes[row, 0].set_ylabel(f"{name} ({unit})")
    axes[1, 1].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    figure.align_ylabels(axes[:, 0])
    return figure


def usual_size(friction_N: Series) -> float:
    """Return the largest friction but for rare spikes, N; above 0 unless all are 0."""
    return series.usual_size(friction_N) or series.ends(series.sizes(friction_N))[1]


def _excerpt_length(recording: Samples) -> int:
    """Return how many samples of a recording make two drive cycles, or a tenth of it."""
    n, cycles = len(recording), metrics.drive_cycles(recording.velocity_m_s)
    length = 2 * (cycles[0].stop - cycles[0].start) if cycles else n // 10
    return int(np.clip(length, min(n, 50), n))


def convergence(replay: Replay, fitted: bool = False) -> Figure:
    """Nrmse of each cycle on a logarithmic scale."""
    figures = replay.figures()
    values = np.array(figures["nrmse_by_cycle"])
    figure = Figure(figsize=(10, 3.4))
    axes = figure.subplots()
    axes.semilogy(np.arange(1, values.size + 1), values, "o-", ms=3, color=style.PREDICTED, label="predicted")
    _level(axes, figures["nrmse_persistence"], "guess f[k-1]", style.MEASURED, ":")
    if figures["theory_nrmse"] is not None:
        _level(axes, figures["theory_nrmse"], "theoretical curve alone", style.THEORY, "--")
    periodic = [bool(metrics.drive_cycles(replay.samples.velocity_m_s[part])) for part in replay.parts]
    kinds = ["drive cycle"] * any(periodic) + ["tenth of the record"] * (not all(periodic))
    axes.set_xlabel(" or ".join(kinds) + (", a line where a recording begins" if len(replay.parts) > 1 else ""))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("nrmse (1)")
    axes.set_title("Error of the fit" if fitted else "Error while learning" if replay.learned.all() else "Error")
    style.readable_log(axes.yaxis)
    for number in cycles_before(replay):
        axes.axvline(number + 0.5, color=style.MEASURED, lw=0.8)
    stop = learning_stops(replay)
    if stop is not None:
        axes.axvline(stop, color=style.RESIDUAL, ls="--", label="learning stops")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _level(axes: Axes, value: float, label: str, colour: str, dash: str) -> None:
    if np.isfinite(value) and value > 0.0:
        axes.axhline(value, color=colour, ls=dash, label=label)


def cycles_before(replay: Replay) -> list[int]:
    """Return how many values of nrmse_by_cycle lie before each recording but the first."""
    cycles = metrics.cycles_or_tenths(replay.samples.velocity_m_s, replay.starts)
    return [sum(cycle.start < start for cycle in cycles) for start in replay.starts[1:]]


def learning_stops(replay: Replay) -> float | None:
    """Return where learning stops, on an axis on which cycle k of nrmse_by_cycle lies at k + 1; None where it goes on.

    Where nothing was learned there is no such place either.
    """
    if replay.learned.all() or not replay.learned.any():
        return None
    last = int(np.flatnonzero(replay.learned)[-1]) + 1
    cycles = metrics.cycles_or_tenths(replay.samples.velocity_m_s, replay.starts)
    done = [min(1.0, max(0.0, (last - one.start) / (one.stop - one.start))) for one in cycles]
    return 0.5 + float(sum(done))


def friction_map(replay: Replay, quantities: Quantities) -> Figure:
    """Friction against velocity: the learned curve with its band over the measured samples, beside its rivals."""
    samples = replay.samples
    curve = replay.outlook
    v = curve.velocity_m_s
    speed, force = quantities.value(1.0, VELOCITY), quantities.value(1.0, FORCE)
    figure = Figure(figsize=(10, 5.0))
    axes = figure.subplots()
    alone = friction_alone(replay)
    velocity = Formed(alone.size, lambda part: speed * samples.velocity_m_s[part])
    friction = Formed(alone.size, lambda part: force * alone[part])
    reach = 1.2 * usual_size(friction)
    slowest, fastest = series.ends(velocity)
    low, high = min(speed * v[0], slowest), max(speed * v[-1], fastest)
    margin = 0.02 * (high - low) or 1e-3
    axes.set_xlim(low - margin, high + margin)
    axes.set_ylim(-reach, reach)
    handles: list[Artist] = [_density(axes, velocity, friction, (low - margin, high + margin), reach)]
    inside = supported(curve, replay.curve)
    for where, colour, alpha, label in (
        (inside, style.LEARNED, 0.22, "95 % band"),
        (~inside, style.UNSUPPORTED, 0.25, "95 % band, no data"),
    ):
        if where.any():
            shown = reaching(where)
            handles.append(
                axes.fill_between(
                    speed * v,
                    force * curve.low_N,
                    force * curve.high_N,
                    where=shown,
                    color=colour,
                    alpha=alpha,
                    lw=0.0,
                    zorder=2,
                    label=label,
                )
            )
    theory = theory_curve(replay, v, curve)
    if theory is not None:
        theory = force * theory
        handles += axes.plot(speed * v, theory, ":", color=style.THEORY, lw=1.4, label="theoretical curve", zorder=3)
    if "coulomb_viscous" in replay.baseline_curves and not replay.loads:  # fitted to the effort, load and all
        known = force * replay.baseline_curves["coulomb_viscous"].evaluate(v)
        label = "Coulomb and viscous, fitted"
        handles += axes.plot(speed * v, known, color=style.ACCENT, lw=0.9, label=label, zorder=4)
    for where, colour, dash, label in (
        (inside, style.LEARNED, "-", "learned"),
        (~inside, style.UNSUPPORTED, "--", "learned, no data"),
    ):
        if where.any():
            line = np.where(reaching(where), force * curve.friction_N, np.nan)
            handles += axes.plot(speed * v, line, dash, color=colour, lw=1.6, label=label, zorder=5)
    axes.set_xlabel(f"velocity ({quantities.velocity})")
    axes.set_ylabel(f"friction ({quantities.force})")
    axes.set_title(conditions(replay, curve))
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _density(axes: Axes, velocity: Series, friction: Series, span: tuple[float, float], reach: float) -> Patch:
    """Draw how many samples, (n,) each, lie where, the more the darker; return what stands for them in the legend."""
    across, along = DENSITY_CELLS
    fewer = min(1.0, max(0.5, np.sqrt(velocity.size / 20_000)))
    cells = (int(across * fewer), int(along * fewer))
    count = np.zeros(cells)
    for part in sums.parts(velocity.size):
        speed, force = velocity[part], friction[part]
        seen = (np.abs(force) <= reach) & np.isfinite(speed)
        more, x, y = np.histogram2d(speed[seen], force[seen], bins=cells, range=(span, (-reach, reach)))
        count += more
    shown = np.ma.masked_equal(count.T, 0)
    norm = LogNorm(1, max(2.0, count.max()))
    drawn = axes.pcolormesh(x, y, shown, cmap=style.DENSITY, norm=norm, zorder=1, rasterized=True)
    assert axes.figure is not None
    bar = axes.figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.4, aspect=40, pad=0.02)
    bar.set_label("samples in a cell")
    style.readable_log(bar.ax.xaxis, (1.0,))
    return Patch(color=style.DENSITY(0.5), label="measured")


def friction_alone(replay: Replay) -> Series:
    """Return the measured friction without the load learned beside it, (n,), N: what a curve is held against."""
    terms = LoadTerms(replay.estimator.config)
    if not terms.size or not replay.loads:
        return replay.samples.friction_N
    values = {load.term: load.value for load in replay.loads}
    weights = np.array([values.get(part.label, 0.0) for part in terms.unknown]) / terms.scales
    samples = replay.samples
    return Formed(len(samples), lambda part: samples.friction_N[part] - terms.force_N(samples[part], weights))


def supported(outlook: Curve, curve: Curve) -> Bools:
    """Return where data support a curve: within the velocities of the learned one, half of the prior's variance gone.

    `outlook` is the learned curve over more velocities than those of `curve`.
    """
    v, learned = outlook.velocity_m_s, curve.velocity_m_s
    known: Bools = np.ones(v.size, np.bool_) if outlook.learned_share is None else outlook.learned_share >= LEARNED
    return np.asarray(known & (v >= learned[0]) & (v <= learned[-1]), np.bool_)


def reaching(where: Bools) -> Bools:
    """Return `where` with one point more at each end, so that neighbouring pieces of a line meet."""
    out = where.copy()
    out[1:] |= where[:-1]
    out[:-1] |= where[1:]
    return out


def theory_curve(replay: Replay, velocity_m_s: Floats, curve: Curve) -> Floats | None:
    """Return the theoretical curve at the conditions of the learned one; None for a model without."""
    if not replay.parameters.theory_taps.size:
        return None
    return replay.estimator.model.theory_at(velocity_m_s, curve.pressure_Pa, curve.temperature_degC)


def conditions(replay: Replay, curve: Curve) -> str:
    """Return the title: the conditions, where they were recorded."""
    recorded = []
    if replay.samples.pressure_Pa is not None and np.isfinite(replay.samples.pressure_Pa).any():
        recorded.append(f"{curve.pressure_Pa * 1e-5:.3g} bar")
    if replay.samples.temperature_degC is not None and np.isfinite(replay.samples.temperature_degC).any():
        recorded.append(f"{curve.temperature_degC:.3g} °C")
    return "Friction against velocity" + (f", learned curve at {', '.join(recorded)}" if recorded else "")


def taps(replay: Replay) -> Figure:
    """Taps over time and at the end."""
    blocks = [("taps behind g", [p.fir_taps for p in replay.snapshots])]
    if replay.parameters.theory_taps.size:
        blocks.append(("taps behind the theoretical curve", [p.theory_taps for p in replay.snapshots]))
    seconds = series.at(replay.time_s, replay.snapshot_index)
    figure = Figure(figsize=(10, 2.6 * len(blocks)))
    axes = figure.subplots(len(blocks), 2, squeeze=False, width_ratios=(2, 1))
    for row, (title, history) in enumerate(blocks):
        _draw_taps(axes[row], title, seconds, history)
    return figure


def _draw_taps(axes: Sequence[Axes], title: str, seconds: np.ndarray, history: Sequence[np.ndarray]) -> None:
    values = np.array(history)
    axes[0].plot(seconds, values, lw=0.9)
    axes[0].set_title(title)
    axes[0].set_xlabel("time (s)")
    axes[0].set_ylabel("tap (1)")
    axes[1].stem(np.arange(values.shape[1]), values[-1], linefmt=style.LEARNED, markerfmt="o", basefmt=" ")
    axes[1].set_title("at the end")
    axes[1].set_xlabel("lag (samples)")
