"""Counterparts of the paper's Figs. 3 to 6."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.paper.study import BATCH, Study, static_curves
from friction_estimator.report import style
from friction_estimator.rig.drive import CONDITIONS, PA_PER_PSI, celsius

TITLES = {"a": "(a) 130 °F, 50 psi, T = 5 s", "b": "(b) 130 °F, 50 psi, T = 1 s", "c": "(c) 130 °F, 200 psi, T = 5 s"}
PAPER_LAW = "lms"
LAW_COLOURS = {"lms": style.PREDICTED, "nlms": style.ACCENT, "rls": style.THEORY, BATCH: style.MEASURED}
POINTS = 3000


def write_figures(
    study: Study, folder: str | os.PathLike[str], formats: Sequence[str] = style.USUAL
) -> list[tuple[Path, str]]:
    """Draw the four figures into `folder`; return (file, caption)."""
    figures = [(style.save(figure_3(), folder, "figure_3", formats), CAPTIONS["3"])]
    figures.append((style.save(figure_4(study), folder, "figure_4", formats), CAPTIONS["4"]))
    for number, model in (("5", "hammerstein"), ("6", "parallel")):
        figures.append((style.save(estimates(study, model), folder, f"figure_{number}", formats), CAPTIONS[number]))
    return figures


CAPTIONS = {
    "3": "Counterpart of Fig. 3: theoretical steady-state friction of the lip seal, against velocity and pressure at "
    "130 °F, and against velocity and temperature at 200 psi. Own physics; the force scale is not the paper's.",
    "4": "Counterpart of Fig. 4: simulated velocity and friction under the conditions a, b, c (seed 0).",
    "5": "Counterpart of Fig. 5, Hammerstein model. Top: the first and the last cycle, measured and predicted by the "
    f"paper's law {PAPER_LAW} before each measurement was used, and what it leaves of the last. Then: g after each "
    "law, scaled onto the theory (its magnitude and sign are free). Bottom: error of each cycle for every law.",
    "6": "Counterpart of Fig. 6, Parallel model. As before; the learned curve is g and the filtered theory together, "
    "at constant velocity.",
}


def figure_3() -> Figure:
    """Two surfaces of the seal curve."""
    curve = SealCurve(SealConfig())
    v = np.linspace(-0.15, 0.15, 181)
    surfaces: list[tuple[Floats, str, str, Any]] = [
        (np.linspace(0.0, 400.0, 31), "pressure (psi)", "at 130 °F", lambda y: (y * PA_PER_PSI, celsius(130.0))),
        (np.linspace(60.0, 200.0, 31), "temperature (°F)", "at 200 psi", lambda y: (200.0 * PA_PER_PSI, celsius(y))),
    ]
    with mpl.rc_context({"figure.constrained_layout.use": False}):  # it knows nothing of surfaces
        figure = Figure(figsize=(11, 4.8))
    for column, (levels, label, title, at) in enumerate(surfaces):
        axes: Any = figure.add_axes((0.01 + 0.49 * column, 0.03, 0.47, 0.97), projection="3d")
        height = np.array([curve.evaluate(v, *(np.full(v.size, x) for x in at(level))) for level in levels])
        axes.plot_surface(*np.meshgrid(v, levels), height, cmap="viridis", rcount=31, ccount=91, linewidth=0.1)
        axes.set_xlabel("velocity (m/s)", labelpad=8)
        axes.set_ylabel(label, labelpad=8)
        axes.set_zlabel("friction (N)", labelpad=4)
        axes.set_title(f"Steady-state friction {title}", y=0.9)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(4))
        axes.view_init(elev=24, azim=-128)
        axes.set_box_aspect(None, zoom=0.9)
    return figure


def figure_4(study: Study) -> Figure:
    """Velocity and friction of each condition."""
    figure = Figure(figsize=(11, 4.6))
    axes = figure.subplots(2, len(CONDITIONS), sharex="col")
    for column, condition in enumerate(CONDITIONS):
        samples = study.shown[condition].samples
        part = slice(0, round(2 * _cycle(study, condition)))
        thin = _thin(part)
        axes[0, column].plot(samples.time_s[thin], samples.velocity_m_s[thin], color=style.THEORY)
        axes[1, column].plot(samples.time_s[thin], samples.friction_N[thin], color=style.RESIDUAL, lw=0.7)
        axes[0, column].set_title(TITLES[condition])
        axes[1, column].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("velocity (m/s)")
    axes[1, 0].set_ylabel("friction (N)")
    figure.align_ylabels(axes[:, 0])
    return figure


def estimates(study: Study, model: str) -> Figure:
    """First and last cycle, what is left of the last, learned curve beside the theory, and error by cycle."""
    figure = Figure(figsize=(11, 12.0))
    axes = figure.subplots(5, len(CONDITIONS))
    for column, condition in enumerate(CONDITIONS):
        shown, cycle = study.shown[condition], _cycle(study, condition)
        samples, predicted = shown.samples, shown.predicted_N[model, PAPER_LAW]
        whole = len(samples) // cycle * cycle
        for row, (part, title) in enumerate(
            ((slice(0, cycle), "first cycle"), (slice(whole - cycle, whole), "last cycle"))
        ):
            thin, panel = _thin(part), axes[row, column]
            panel.plot(samples.time_s[thin], samples.friction_N[thin], color=style.MEASURED, lw=2.2, label="measured")
            panel.plot(
                samples.time_s[thin], predicted[thin], color=style.PREDICTED, lw=0.9, label=f"predicted ({PAPER_LAW})"
            )
            reach = 1.35 * float(np.quantile(np.abs(samples.friction_N), 0.999))
            panel.set_ylim(-reach, reach)
            panel.set_title(f"{TITLES[condition]}\n{title}" if row == 0 else title)
            panel.set_xlabel("time (s)")
        left = (samples.friction_N - predicted)[part][:: thin.step]
        axes[2, column].plot(samples.time_s[thin], left, color=style.RESIDUAL, lw=0.7)
        axes[2, column].set(title="left of the last cycle", xlabel="time (s)")
        _learned(axes[3, column], study, model, condition)
        _errors(axes[4, column], study, model, condition)
    labels = ("friction (N)", "friction (N)", "measured - predicted (N)", "friction (N)", "nrmse of a cycle (1)")
    for row, label in enumerate(labels):
        axes[row, 0].set_ylabel(label)
    for row in (0, 3, 4):
        handles, labels = axes[row, -1].get_legend_handles_labels()
        axes[row, -1].legend(handles, labels, loc="upper left", bbox_to_anchor=(1.02, 1.0))
    figure.align_ylabels(axes[:, 0])
    return figure


def _learned(panel: Any, study: Study, model: str, condition: str) -> None:
    """Draw the learned static curve of each law of seed 0 beside the theory."""
    shown = study.shown[condition]
    config = shown.config.updated({"model.type": model})
    for law in (BATCH, *LAWS):
        parameters = study.outcomes[condition, 0, model, law].parameters
        v, g, d = static_curves(config, parameters, shown.samples)
        if model == "parallel":
            curve, name = g + parameters.theory_taps.sum() * d, law
        else:
            curve, name = g * float(g @ d) / float(g @ g), f"g, {law}"
        panel.plot(v, curve, color=LAW_COLOURS[law], lw=2.4 if law == BATCH else 1.0, label=name)
    panel.plot(v, d, "--", color="black", lw=1.0, label="theory d(v)")
    reach = 1.6 * float(np.abs(d).max())
    panel.set_ylim(-reach, reach)
    panel.set_xlabel("velocity (m/s)")
    panel.set_title("learned curve and theory")


def _errors(panel: Any, study: Study, model: str, condition: str) -> None:
    """Draw the error of each cycle, geometric mean and range over the seeds."""
    for law in (BATCH, *LAWS):
        rows: Sequence[Floats] = [run.cycle_rms for run in study.over_seeds(condition, model, law)]
        cycles = np.arange(1, rows[0].size + 1)
        middle = np.exp(np.mean(np.log(rows), axis=0))
        panel.semilogy(cycles, middle, color=LAW_COLOURS[law], lw=2.4 if law == BATCH else 1.2, label=law)
        panel.fill_between(cycles, np.min(rows, axis=0), np.max(rows, axis=0), color=LAW_COLOURS[law], alpha=0.15, lw=0)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_xlabel("drive cycle")
    panel.set_title("error while learning, all seeds")
    style.readable_log(panel.yaxis)


def _cycle(study: Study, condition: str) -> int:
    return round(CONDITIONS[condition][0] * study.plan.rate_hz)


def _thin(part: slice) -> slice:
    return slice(part.start, part.stop, max(1, (part.stop - part.start) // POINTS))
