"""Counterparts of the paper's Figs. 3 to 6."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.paper.convergence import PAPER_LAW
from friction_estimator.paper.shape import likeness
from friction_estimator.paper.study import BATCH, DEFAULT_STEP, LEARNERS, Study, plant_curve, static_curves
from friction_estimator.report import style
from friction_estimator.rig.drive import CONDITIONS, PA_PER_PSI, celsius

TITLES = {"a": "(a) 130 °F, 50 psi, T = 5 s", "b": "(b) 130 °F, 50 psi, T = 1 s", "c": "(c) 130 °F, 200 psi, T = 5 s"}
COLOURS = {
    "lms 0.002": "#f3b49b", PAPER_LAW: style.PREDICTED, "lms 0.01": "#8f2d0c", "lms 0.02": "#4a1505",
    "nlms": style.ACCENT, "rls": style.THEORY, BATCH: style.MEASURED,
}  # fmt: skip
"""Learner -> its colour; the larger the step of lms, the darker."""

DRAWN = (BATCH, *LEARNERS)
POINTS = 3000

PARTS = {
    "3": (
        "The paper: the steady-state theory of the lip seal as two surfaces, friction against velocity and pressure at "
        "130 °F, and against velocity and temperature at 200 psi.",
        "Ours: the same two surfaces of a mixed-lubrication curve: a peak beside standstill, the Stribeck minimum, "
        "film friction that rises with speed; more pressure lifts all of it, more heat thins the film.",
        "What differs: the paper's curve is not published, ours is own physics; its force scale (newton at the rod) is "
        "not the paper's.",
    ),
    "4": (
        "The paper: velocity and friction measured on an actuator with an eccentric drive under (a), (b), (c).",
        "Ours: the same three conditions on a simulated rig, two drive cycles of seed 0.",
        "What differs: a simulation, with a sine of 20 mm amplitude, 1 % noise and a plant unlike the theory, in place "
        "of a measurement that is not public.",
    ),
    "5": (
        "The paper: friction measured and estimated by the Hammerstein model, and its g, of the theory's shape but for "
        "magnitude and sign.",
        f"Ours: first and last cycle, predicted by the paper's law (lms, step {DEFAULT_STEP:g}) before each "
        "measurement was used, each with what is left; in the file figure_5, for the last cycle, also what the same "
        "law leaves if it stops learning half way. Then g as it was learned, magnitude and sign included; g scaled "
        "onto the theory, beside the plant; and the error of each cycle.",
        "What differs: the paper shows estimates while learning only, of one step size that it does not name; here "
        "four of them stand beside nlms, rls and the batch fit.",
    ),
    "6": (
        "The paper: friction measured and estimated by the Parallel model.",
        "Ours: as in Fig. 5, but for g, which here is the correction to the theory (in newton, behind its filter at "
        "constant velocity), and the sum of both beside theory and plant.",
        "What differs: as in Fig. 5; the theory that Parallel is given is not the plant's.",
    ),
}
"""Figure -> what the paper shows (by its text and captions), what ours shows, what differs."""

CAPTIONS = {number: " ".join((f"Counterpart of Fig. {number}.", *parts)) for number, parts in PARTS.items()}

JUDGED_CAPTION = (
    "The same parameters judged four times: while learning (last five cycles), frozen half way on the rest, and frozen "
    "on two drives that differ in kind. Mean over the seeds and its 95 % interval; grey: what no model reaches, "
    "persistence while learning and a static Stribeck curve elsewhere."
)


def write_figures(
    study: Study, folder: str | os.PathLike[str], formats: Sequence[str] = style.USUAL
) -> dict[str, tuple[Path, str]]:
    """Draw all figures into `folder`; return (file, caption) by the paper's number, and of `judged`."""
    from friction_estimator.report.judged_figure import judged  # noqa: PLC0415 - it takes its colours from here

    drawn = {"3": figure_3(), "4": figure_4(study), "5": estimates(study, "hammerstein")}
    drawn |= {"6": estimates(study, "parallel"), "judged": judged(study)}
    captions = CAPTIONS | {"judged": JUDGED_CAPTION}
    return {
        name: (style.save(figure, folder, f"figure_{name}", formats), captions[name]) for name, figure in drawn.items()
    }


def label(learner: str) -> str:
    """Return the name of a learner with its step size."""
    return f"{PAPER_LAW} {DEFAULT_STEP:g}" if learner == PAPER_LAW else learner


def figure_3() -> Figure:
    """Two surfaces of the seal curve."""
    curve = SealCurve(SealConfig())
    v = 0.15 * np.sinh(np.linspace(-4.0, 4.0, 61)) / np.sinh(4.0)  # fine beside standstill, where the peak is
    surfaces: list[tuple[Floats, str, str, Any]] = [
        (np.linspace(0.0, 400.0, 17), "pressure (psi)", "at 130 °F", lambda y: (y * PA_PER_PSI, celsius(130.0))),
        (np.linspace(60.0, 200.0, 15), "temperature (°F)", "at 200 psi", lambda y: (200.0 * PA_PER_PSI, celsius(y))),
    ]
    figure = Figure(figsize=(11, 4.8))
    figure.set_layout_engine("none")  # a constrained layout knows nothing of surfaces
    for column, (levels, name, title, at) in enumerate(surfaces):
        axes: Any = figure.add_axes((0.01 + 0.49 * column, 0.03, 0.47, 0.97), projection="3d")
        height = np.array([curve.evaluate(v, *(np.full(v.size, x) for x in at(level))) for level in levels])
        axes.plot_surface(*np.meshgrid(v, levels), height, cmap="viridis", rstride=1, cstride=1, linewidth=0.1)
        axes.set_xlabel("velocity (m/s)", labelpad=8)
        axes.set_ylabel(name, labelpad=8)
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
        thin = _thin(slice(0, round(2 * _cycle(study, condition))))
        axes[0, column].plot(samples.time_s[thin], samples.velocity_m_s[thin], color=style.THEORY)
        axes[1, column].plot(samples.time_s[thin], samples.friction_N[thin], color=style.RESIDUAL, lw=0.7)
        axes[0, column].set_title(TITLES[condition])
        axes[1, column].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("velocity (m/s)")
    axes[1, 0].set_ylabel("friction (N)")
    figure.align_ylabels(axes[:, 0])
    return figure


def estimates(study: Study, model: str) -> Figure:
    """First and last cycle and what is left of either, the learned curve, and the error by cycle."""
    figure = Figure(figsize=(11, 16.5))
    axes = figure.subplots(7, len(CONDITIONS), height_ratios=(1.1, 0.8, 1.1, 0.8, 1.1, 1.1, 1.1))
    for column, condition in enumerate(CONDITIONS):
        cycle = _cycle(study, condition)
        whole = len(study.shown[condition].samples) // cycle * cycle
        first, last = slice(0, cycle), slice(whole - cycle, whole)
        for row, (part, title) in enumerate(((first, "first cycle"), (last, "last cycle"))):
            _cycle_of(axes[2 * row, column], axes[2 * row + 1, column], study, model, condition, part)
            axes[2 * row, column].set_title(f"{TITLES[condition]}\n{title}" if row == 0 else title)
        _learned(axes[4, column], axes[5, column], study, model, condition)
        _errors(axes[6, column], study, model, condition)
    left, force = "measured -\npredicted (N)", "friction (N)"
    names = (force, left, force, left, "g (N)", force, "rms error of a cycle\nover std of friction (1)")
    for row, name in enumerate(names):
        axes[row, 0].set_ylabel(name)
    for row in (0, 3, 4, 5, 6):
        handles, words = axes[row, -1].get_legend_handles_labels()
        axes[row, -1].legend(handles, words, loc="upper left", bbox_to_anchor=(1.02, 1.0))
    figure.align_ylabels(axes[:, 0])
    return figure


def _cycle_of(panel: Any, below: Any, study: Study, model: str, condition: str, part: slice) -> None:
    """Draw one cycle, measured and predicted, and what is left of it; the latter also without learning."""
    shown = study.shown[condition]
    samples, key = shown.samples, (model, PAPER_LAW)
    predicted, thin = shown.predicted_N[key], _thin(part)
    time, measured = samples.time_s[thin], samples.friction_N
    panel.plot(time, measured[thin], color=style.MEASURED, lw=2.2, label="measured")
    panel.plot(time, predicted[thin], color=style.PREDICTED, lw=0.9, label=f"predicted\n({label(PAPER_LAW)})")
    reach = 1.35 * float(np.quantile(np.abs(measured), 0.999))
    panel.set_ylim(-reach, reach)
    panel.tick_params(labelbottom=False)
    if part.start >= shown.frozen_from:
        frozen = shown.frozen_N[key][part.start - shown.frozen_from : part.stop - shown.frozen_from : thin.step]
        below.plot(time, measured[thin] - frozen, color=style.ACCENT, lw=0.8, label="learning stopped\nhalf way")
    below.plot(time, (measured - predicted)[thin], color=style.PREDICTED, lw=0.7, label="while learning")
    below.set_xlabel("time (s)")


def _learned(panel: Any, scaled: Any, study: Study, model: str, condition: str) -> None:
    """Draw g of each learner of seed 0 as it is, and what comes of it beside theory and plant."""
    shown = study.shown[condition]
    config = shown.config.updated({"model.type": model})
    v, d = np.zeros(0), np.zeros(0)
    for learner in DRAWN:
        parameters = study.outcomes[condition, 0, model, learner].parameters
        v, g, d = static_curves(config, parameters, shown.samples)
        colour, width = COLOURS[learner], 2.4 if learner == BATCH else 1.0
        if model == "parallel":
            panel.plot(v, g, color=colour, lw=width, label=label(learner))
            scaled.plot(v, g + parameters.theory_taps.sum() * d, color=colour, lw=width, label=label(learner))
            continue
        bare = g / parameters.fir_taps.sum()
        alike = likeness(v, bare, d)
        panel.plot(v, bare, color=colour, lw=width, label=label(learner))
        scaled.plot(v, bare / alike.gain, color=colour, lw=width, label=label(learner))
        if learner in (PAPER_LAW, "rls"):
            panel.text(
                0.03, 0.93 if learner == PAPER_LAW else 0.83, f"{label(learner)}: {alike.gain:+.2f} d",
                transform=panel.transAxes, color=colour, fontsize=8, va="top",
            )  # fmt: skip
    scaled.plot(v, plant_curve(condition, v), ":", color="black", lw=1.3, label="plant")
    if model == "hammerstein":
        panel.plot(v, d, "--", color="black", lw=1.0, label="theory d")
    else:
        panel.axhline(0.0, color=style.UNSUPPORTED, lw=0.6)
    scaled.plot(v, d, "--", color="black", lw=1.0, label="theory d")
    reach = 1.6 * float(np.abs(d).max())
    scaled.set_ylim(-reach, reach)
    panel.set_title("g as learned" if model == "hammerstein" else "g, the correction")
    scaled.set_title("g scaled onto the theory" if model == "hammerstein" else "theory and correction together")
    for axes in (panel, scaled):
        axes.set_xlabel("velocity (m/s)")


def _errors(panel: Any, study: Study, model: str, condition: str) -> None:
    """Draw the error of each cycle, geometric mean and range over the seeds."""
    for learner in DRAWN:
        rows: Sequence[Floats] = [run.cycle_rms for run in study.over_seeds(condition, model, learner)]
        cycles = np.arange(1, rows[0].size + 1)
        middle, colour = np.exp(np.mean(np.log(rows), axis=0)), COLOURS[learner]
        panel.semilogy(cycles, middle, color=colour, lw=2.4 if learner == BATCH else 1.2, label=label(learner))
        panel.fill_between(cycles, np.min(rows, axis=0), np.max(rows, axis=0), color=colour, alpha=0.15, lw=0)
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.set_xlabel("drive cycle (1)")
    panel.set_title("error while learning, all seeds")
    style.readable_log(panel.yaxis)


def _cycle(study: Study, condition: str) -> int:
    return round(CONDITIONS[condition][0] * study.plan.rate_hz)


def _thin(part: slice) -> slice:
    return slice(part.start, part.stop, max(1, (part.stop - part.start) // POINTS))
