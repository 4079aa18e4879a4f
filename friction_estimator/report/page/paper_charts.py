"""The charts of `reproduce`: Figs. 5 and 6, to look into."""

from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import UIElement

from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Floats
from friction_estimator.paper.convergence import PAPER_LAW
from friction_estimator.paper.shape import likeness
from friction_estimator.paper.study import BATCH, LEARNERS, MODELS, Study, plant_curve, static_curves
from friction_estimator.report.page import look, signals
from friction_estimator.report.page.content import Chart
from friction_estimator.report.reproduce_figures import TITLES, label
from friction_estimator.rig.drive import CONDITIONS

ROWS, POINTS = 2_500, 201
"""Rows of a chart over time, beside the cycles kept in full; velocities of a curve. The page has six of each."""

INKS = {
    "lms 0.002": ("predicted", "dotted"),
    PAPER_LAW: ("predicted", "solid"),
    "lms 0.01": ("predicted", "dashed"),
    "lms 0.02": ("predicted", "dotdash"),
    "nlms": ("known", "solid"),
    "rls": ("theory", "solid"),
    BATCH: ("measured", "solid"),
}
"""Learner -> name of its colour, and dashes."""


def paper_charts(study: Study, q: Quantities) -> dict[str, list[Chart]]:
    """Return the charts of each model: over time, the learned curve, the error by cycle, for each condition."""
    return {
        model: [
            chart
            for condition in CONDITIONS
            for chart in (
                _over_time(study, model, condition, q),
                _learned(study, model, condition, q),
                _errors(study, model, condition),
            )
        ]
        for model in MODELS
    }


def _over_time(study: Study, model: str, condition: str, q: Quantities) -> Chart:
    shown = study.shown[condition]
    samples, predicted = shown.samples, shown.predicted_N[model, PAPER_LAW]
    left = samples.friction_N - predicted
    name = f"predicted ({label(PAPER_LAW)})"
    drawn = signals.Signals(
        samples.time_s,
        samples.restart,
        samples.velocity_m_s,
        samples.friction_N,
        {name: predicted},
        {name: left},
        None,
        signals.cycles_of(samples.velocity_m_s, left, [slice(0, len(samples))]),
    )
    text = f"By the paper's law, {label(PAPER_LAW)}; every prediction was made before its measurement was used."
    return signals.chart(f"{TITLES[condition]}: over time", text, drawn, q, ROWS)


def _learned(study: Study, model: str, condition: str, q: Quantities) -> Chart:
    text = (
        "g, the correction to the theory, at constant velocity; below it the sum of both, beside theory and plant."
        if model == "parallel"
        else "g as it was learned, with its magnitude and sign; below it the same, scaled onto the theory, beside the "
        "plant."
    )
    return Chart(f"{TITLES[condition]}: learned curve", text, lambda: _draw_learned(study, model, condition, q))


def _draw_learned(study: Study, model: str, condition: str, q: Quantities) -> UIElement:
    shown = study.shown[condition]
    config = shown.config.updated({"model.type": model})
    v, d = np.zeros(0), np.zeros(0)
    raw, whole = {}, {}
    for learner in (BATCH, *LEARNERS):
        parameters = study.outcomes[condition, 0, model, learner].parameters
        v, g, d = static_curves(config, parameters, shown.samples, POINTS)
        if model == "parallel":
            raw[learner], whole[learner] = g, g + parameters.theory_taps.sum() * d
        else:
            raw[learner] = g / parameters.fir_taps.sum()
            whole[learner] = raw[learner] / likeness(v, raw[learner], d).gain
    reach = 1.6 * float(np.abs(d).max())
    usual = 1.1 * float(np.max(np.abs([*raw.values(), d])))
    panels = []
    for curves, name, limit in ((raw, "g", usual), (whole, "friction", reach)):
        target = look.chart(
            f"velocity ({q.velocity})", f"{name} ({q.force})", 280, y_range=look.spanning(-limit, limit, 0.0)
        )
        drawn = [_line(target, v, np.clip(curve, -3 * limit, 3 * limit), learner) for learner, curve in curves.items()]
        if curves is whole or model == "hammerstein":
            look.line(target, v, d, "text", "theory d", line_dash="dashed")
        if curves is whole:
            look.line(target, v, plant_curve(condition, v), "text", "plant", line_dash="dotted")
        tips = [("velocity", f"@x{{0.0000}} {q.velocity}"), (BATCH, f"@y{{0.000}} {q.force}")]
        look.hover(target, drawn[:1], tips, "vline")
        panels.append(target)
    return column(*panels, sizing_mode="stretch_width")


def _line(target: look.Plot, x: Floats, y: Floats, learner: str) -> Any:
    """Draw a line in the colour of its learner; the step sizes of lms are told by their dashes."""
    ink, dash = INKS[learner]
    # Single precision: half as much of the page, and no screen is finer.
    x_drawn: Any = np.asarray(x, np.float32)
    y_drawn: Any = np.asarray(y, np.float32)
    width = 3.2 if learner == BATCH else 1.5
    return look.line(target, x_drawn, y_drawn, ink, label(learner), line_width=width, line_dash=dash)


def _errors(study: Study, model: str, condition: str) -> Chart:
    return Chart(
        f"{TITLES[condition]}: error while learning",
        "Rms error of each drive cycle over the friction's standard deviation: geometric mean and range of all seeds.",
        lambda: _draw_errors(study, model, condition),
    )


def _draw_errors(study: Study, model: str, condition: str) -> UIElement:
    tables = {
        learner: np.array([run.cycle_rms for run in study.over_seeds(condition, model, learner)])
        for learner in (BATCH, *LEARNERS)
    }
    all_values = np.concatenate([rows.ravel() for rows in tables.values()])
    seen = all_values[np.isfinite(all_values) & (all_values > 0.0)]
    low, high = 0.8 * float(seen.min()), min(1.25 * float(seen.max()), 1e3 * float(seen.min()))
    target = look.chart("drive cycle", "nrmse of a cycle (1)", 280, y_axis_type="log", y_range=(low, high))
    for learner, rows in tables.items():
        cycles = np.arange(1.0, rows.shape[1] + 1.0)
        if learner in (PAPER_LAW, BATCH, "nlms", "rls"):
            look.band(target, cycles, rows.min(axis=0), rows.max(axis=0), INKS[learner][0], alpha=0.15)
        _line(target, cycles, np.exp(np.mean(np.log(rows), axis=0)), learner)
    return target
