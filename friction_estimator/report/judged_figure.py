"""Errors while learning, frozen and on other drives, of every learner in one figure."""

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure

from friction_estimator.paper.claims import geometric_mean
from friction_estimator.paper.study import BATCH, LEARNERS, MODELS, OTHER_DRIVES, Outcome, Study
from friction_estimator.report import style
from friction_estimator.report.reproduce_figures import TITLES, label

PLACES: dict[str, tuple[str, str, Callable[[Outcome], float]]] = {
    "while learning": ("o", style.PREDICTED, lambda run: run.last),
    "frozen": ("s", style.THEORY, lambda run: run.frozen),
    **{
        f"frozen, {name}": (marker, colour, lambda run, name=name: run.elsewhere[name])  # type: ignore[misc]
        for name, marker, colour in zip(OTHER_DRIVES, ("^", "D"), (style.ACCENT, "#8250b0"), strict=True)
    },
}
"""Where -> marker, colour, error."""

YARDSTICKS = ("persistence", "static_curve_frozen", *(f"static_curve_on_{name}" for name in OTHER_DRIVES))
"""What no model reaches, in the order of `PLACES`."""


def judged(study: Study) -> Figure:
    """Draw the errors of each learner, one panel for each model and condition."""
    figure = Figure(figsize=(11, 7.0))
    axes: Any = figure.subplots(len(MODELS), len(TITLES), sharex="col", sharey=True)
    learners = [*LEARNERS, BATCH]
    for row, model in enumerate(MODELS):
        for column, condition in enumerate(TITLES):
            _panel(axes[row, column], study, model, condition, learners)
            axes[row, column].set_title(f"{TITLES[condition]}\n{model}" if row == 0 else model)
        axes[row, 0].set_yticks(
            range(len(learners) + 1), [*(label(one) if one != BATCH else "batch fit" for one in learners), "no model"]
        )
        axes[row, 0].set_ylim(len(learners) + 0.6, -0.6)
    for column in range(len(TITLES)):
        axes[-1, column].set_xlabel("rms error over std of friction (1)")
    handles, words = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, words, loc="outside lower center", ncols=len(PLACES))
    return figure


def _panel(panel: Any, study: Study, model: str, condition: str, learners: list[str]) -> None:
    for k, (where, (marker, colour, score)) in enumerate(PLACES.items()):
        shift = 0.18 * (k - 1.5)
        means = [geometric_mean([score(run) for run in study.over_seeds(condition, model, one)]) for one in learners]
        values = [one.value for one in means]
        reach = [[one.value - one.low for one in means], [one.high - one.value for one in means]]
        places = [number + shift for number in range(len(learners))]
        panel.errorbar(values, places, xerr=reach, fmt=marker, color=colour, ms=4, lw=1.0, label=where)
        rows = study.yardsticks.get(condition, [])
        if rows:
            mean = geometric_mean([one[YARDSTICKS[k]] for one in rows])
            panel.plot([mean.value], [len(learners) + shift], marker, color=style.MEASURED, ms=4)
    panel.set_xscale("log")
    style.readable_log(panel.xaxis)
