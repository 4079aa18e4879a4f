"""The charts of `reproduce`: Figs. 5 and 6, to look into."""

import numpy as np
from bokeh.models import UIElement

from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.quantities import Quantities
from friction_estimator.paper.study import BATCH, MODELS, Study, static_curves
from friction_estimator.report.page import look, signals
from friction_estimator.report.page.content import Chart
from friction_estimator.report.reproduce_figures import PAPER_LAW, TITLES
from friction_estimator.rig.drive import CONDITIONS

ROWS = 6_000

NAMES = {"lms": "predicted", "nlms": "known", "rls": "theory", BATCH: "measured"}
"""Law -> name of its colour."""


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
    name = f"predicted ({PAPER_LAW})"
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
    text = f"By the paper's law {PAPER_LAW}; every prediction was made before its measurement was used."
    return signals.chart(f"{TITLES[condition]}: over time", text, drawn, q, ROWS)


def _learned(study: Study, model: str, condition: str, q: Quantities) -> Chart:
    text = (
        "g and the filtered theory together, at constant velocity."
        if model == "parallel"
        else "g after each law, scaled onto the theory: its magnitude and sign are free."
    )
    return Chart(f"{TITLES[condition]}: learned curve", text, lambda: _draw_learned(study, model, condition, q))


def _draw_learned(study: Study, model: str, condition: str, q: Quantities) -> UIElement:
    shown = study.shown[condition]
    config = shown.config.updated({"model.type": model})
    rows = []
    for law in (BATCH, *LAWS):
        parameters = study.outcomes[condition, 0, model, law].parameters
        v, g, d = static_curves(config, parameters, shown.samples)
        whole = g + parameters.theory_taps.sum() * d if model == "parallel" else g * float(g @ d) / float(g @ g)
        rows.append((law, whole))
    reach = 1.6 * float(np.abs(d).max())
    target = look.chart(
        f"velocity ({q.velocity})", f"friction ({q.force})", 320, y_range=look.spanning(-reach, reach, 0.0)
    )
    drawn = [
        look.line(
            target, v, np.clip(whole, -3 * reach, 3 * reach), NAMES[law], law, line_width=3.2 if law == BATCH else 1.5
        )
        for law, whole in rows
    ]
    look.line(target, v, d, "text", "theory d(v)", line_dash="dashed")
    look.hover(
        target, drawn[:1], [("velocity", f"@x{{0.0000}} {q.velocity}"), (BATCH, f"@y{{0.000}} {q.force}")], "vline"
    )
    return target


def _errors(study: Study, model: str, condition: str) -> Chart:
    return Chart(
        f"{TITLES[condition]}: error while learning",
        "Rms error of each drive cycle over the friction's standard deviation: geometric mean and range of all seeds.",
        lambda: _draw_errors(study, model, condition),
    )


def _draw_errors(study: Study, model: str, condition: str) -> UIElement:
    tables = {
        law: np.array([run.cycle_rms for run in study.over_seeds(condition, model, law)]) for law in (BATCH, *LAWS)
    }
    all_values = np.concatenate([rows.ravel() for rows in tables.values()])
    seen = all_values[np.isfinite(all_values) & (all_values > 0.0)]
    low, high = 0.8 * float(seen.min()), min(1.25 * float(seen.max()), 1e3 * float(seen.min()))
    target = look.chart("drive cycle", "nrmse of a cycle (1)", 280, y_axis_type="log", y_range=(low, high))
    for law, rows in tables.items():
        cycles = np.arange(1.0, rows.shape[1] + 1.0)
        look.band(target, cycles, rows.min(axis=0), rows.max(axis=0), NAMES[law], alpha=0.15)
        middle = np.exp(np.mean(np.log(rows), axis=0))
        look.line(target, cycles, middle, NAMES[law], law, line_width=3.0 if law == BATCH else 1.5)
    return target
