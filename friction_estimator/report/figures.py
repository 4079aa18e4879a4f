"""Figures of a replay: signals, convergence, the learned map and the taps."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from friction_estimator.core import metrics
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.report import style

SHOWN_SAMPLES = 4000
"""Points drawn of a scatter or a signal: more hide each other."""


def write_figures(replay: Replay, folder: str | os.PathLike[str]) -> list[tuple[Path, str]]:
    """Draw every figure of a replay into `folder`; return (file, caption) in the order of reading."""
    place = Path(folder)
    return [
        (
            style.save(signals(replay), place / "signals.png"),
            "Start and end of the record: velocity, measured and predicted friction, and what is left. "
            "Every prediction was made before its measurement was used.",
        ),
        (
            style.save(convergence(replay), place / "convergence.png"),
            "Error of each drive cycle over the standard deviation of the measured friction, beside the guess that "
            "friction stays as it was one sample ago, and the theoretical curve alone.",
        ),
        (
            style.save(friction_map(replay), place / "friction_map.png"),
            "Measured friction against velocity in the last fifth of the record, with the learned static curve.",
        ),
        (
            style.save(taps(replay), place / "taps.png"),
            "FIR taps while they are learned, and their last values.",
        ),
    ]


def signals(replay: Replay) -> Figure:
    """Velocity, friction and residual in the first and the last cycles."""
    samples, n = replay.samples, len(replay.samples)
    cycles = metrics.drive_cycles(samples.velocity_m_s)
    length = 2 * (cycles[0].stop - cycles[0].start) if cycles else n // 10
    length = int(np.clip(length, min(n, 50), n))
    figure = Figure(figsize=(10, 6))
    axes = figure.subplots(3, 2, sharex="col", sharey="row")
    for column, (part, title) in enumerate(((slice(0, length), "start"), (slice(n - length, n), "end"))):
        time = samples.time_s[part]
        thin = slice(None, None, max(1, length // SHOWN_SAMPLES))
        axes[0, column].plot(time[thin], samples.velocity_m_s[part][thin], color=style.THEORY)
        axes[1, column].plot(time[thin], samples.friction_N[part][thin], color=style.MEASURED, lw=2.4, label="measured")
        axes[1, column].plot(
            time[thin], replay.predicted_N[part][thin], color=style.PREDICTED, label="predicted", lw=0.9
        )
        axes[2, column].plot(time[thin], replay.residual_N[part][thin], color=style.RESIDUAL, lw=0.7)
        axes[0, column].set_title(f"{title} of the record")
        axes[2, column].set_xlabel("time (s)")
        # A start-up transient must not flatten everything else.
    reach = 1.15 * float(np.quantile(np.abs(samples.friction_N), 0.999))
    axes[1, 0].set_ylim(-reach, reach)
    error_reach = 4.0 * float(np.sqrt(np.mean(np.square(np.clip(replay.residual_N, -reach, reach)))))
    if error_reach > 0.0:
        axes[2, 0].set_ylim(-error_reach, error_reach)
    for row, label in enumerate(("velocity (m/s)", "friction (N)", "measured - predicted (N)")):
        axes[row, 0].set_ylabel(label)
    axes[1, 1].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    figure.align_ylabels(axes[:, 0])
    return figure


def convergence(replay: Replay) -> Figure:
    """Nrmse of each cycle on a logarithmic scale."""
    figures = replay.figures()
    values = np.array(figures["nrmse_by_cycle"])
    figure = Figure(figsize=(10, 3.4))
    axes = figure.subplots()
    axes.semilogy(np.arange(1, values.size + 1), values, "o-", ms=3, color=style.PREDICTED, label="predicted")
    _level(axes, figures["nrmse_persistence"], "guess f[k-1]", style.MEASURED, ":")
    if figures["theory_nrmse"] is not None:
        _level(axes, figures["theory_nrmse"], "theoretical curve alone", style.THEORY, "--")
    periodic = bool(metrics.drive_cycles(replay.samples.velocity_m_s))
    axes.set_xlabel("drive cycle" if periodic else "tenth of the record")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("nrmse (1)")
    axes.set_title("Error while learning")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _level(axes: Axes, value: float, label: str, colour: str, dash: str) -> None:
    if np.isfinite(value) and value > 0.0:
        axes.axhline(value, color=colour, ls=dash, label=label)


def friction_map(replay: Replay) -> Figure:
    """Friction against velocity: measured, learned static curve, theory."""
    samples = replay.samples[len(replay.samples) - max(2, len(replay.samples) // 5) :]
    thin = slice(None, None, max(1, len(samples) // SHOWN_SAMPLES))
    low, high = replay.config.basis.velocity_range
    v = np.linspace(low, high, 801)
    inside = (v >= samples.velocity_m_s.min()) & (v <= samples.velocity_m_s.max())
    v = v[inside] if inside.sum() > 2 else v
    probe = Samples(np.arange(v.size), v, np.zeros(v.size), np.ones(v.size, np.bool_), *_conditions(samples, v.size))
    parameters = replay.parameters
    model = replay.estimator.model
    theory = model.theoretical_friction(probe)
    learned = model.static_map(parameters.theta, v)
    figure = Figure(figsize=(10, 4.2))
    axes = figure.subplots()
    axes.plot(samples.velocity_m_s[thin], samples.friction_N[thin], ".", ms=2, color=style.MEASURED, label="measured")
    if parameters.theory_taps.size:
        learned = learned + parameters.theory_taps.sum() * theory
        axes.plot(v, theory, "--", color=style.THEORY, label="theoretical curve")
    axes.plot(v, learned, color=style.LEARNED, label="learned, at constant velocity")
    reach = 1.2 * float(np.quantile(np.abs(samples.friction_N), 0.999))
    axes.set_ylim(-reach, reach)
    axes.set_xlabel("velocity (m/s)")
    axes.set_ylabel("friction (N)")
    axes.set_title("Friction against velocity")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _conditions(samples: Samples, n: int) -> list[np.ndarray | None]:
    """Median pressure and temperature of the part that is drawn, held over the probe."""
    held: list[np.ndarray | None] = []
    for channel in (samples.pressure_Pa, samples.temperature_degC):
        known = channel is not None and bool(np.isfinite(channel).any())
        held.append(np.full(n, np.nanmedian(channel)) if known and channel is not None else None)
    return held


def taps(replay: Replay) -> Figure:
    """Taps over time and at the end."""
    blocks = [("taps behind g", [p.fir_taps for p in replay.snapshots])]
    if replay.parameters.theory_taps.size:
        blocks.append(("taps behind the theoretical curve", [p.theory_taps for p in replay.snapshots]))
    seconds = (np.array(replay.snapshot_stamp_ns) - replay.samples.stamp_ns[0]) / NS_PER_S
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
