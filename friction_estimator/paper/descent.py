"""Where lms ends on one recording: arrived, still falling, or level, beside starts that show what each means.

A flat learning curve proves nothing, and neither does what a Newton step promises: a law of constant step hovers, where
every step undoes another, at a place that need not be stationary. So runs from random taps stand beside two controls:
one started at the best minimum found, which has nowhere to go, and one started at a minimum that is not the best, where
there is one, which would stay there if lms could be caught. All go over the same record several times.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_estimator.core.fit.moments import Moments, solve
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config

PASSES = 8
"""Times that a run goes over the recording."""

RANDOM, OPTIMUM, SECOND = "random taps", "the best minimum", "another minimum"

SETTLED = 0.01
"""A point counts as at rest where a Newton step promises less than this share of its cost."""

FALLING = 0.02
"""A run is falling while the second half of its passes lowers the cost by more than this share, else it is level."""

ARRIVED = 1.2
"""A run has arrived where its cost is at most this many times that of the run started at the best minimum."""


@dataclass(frozen=True)
class End:
    """One run of lms.

    Attributes
    ----------
    start : one of `RANDOM`, `OPTIMUM`, `SECOND`.
    start_over_lowest : cost at the start over that of the best minimum found.
    cost_over_lowest : the same after 1, 2, 4, .. passes.
    share_a_newton_step_promises : of the cost after the first pass, and after the last.
    state : arrived, falling or level, by the costs.
    """

    start: str
    start_over_lowest: float
    cost_over_lowest: tuple[float, ...]
    share_a_newton_step_promises: tuple[float, float]
    state: str


def ends(
    moments: Moments, samples: Samples, config: Config, starts: Sequence[tuple[str, Floats]], lowest: float
) -> list[End]:
    """Run lms from each start (name, theta); the first one named `OPTIMUM` is what the others are held against."""
    traces = [_run(moments, samples, config, theta) for _, theta in starts]
    goal = next(costs[-1] for (name, _), (costs, _) in zip(starts, traces, strict=True) if name == OPTIMUM)
    return [
        End(
            start=name,
            start_over_lowest=moments.cost(theta) / lowest,
            cost_over_lowest=tuple(cost / lowest for cost in costs),
            share_a_newton_step_promises=promises,
            state=state_of(costs, goal),
        )
        for (name, theta), (costs, promises) in zip(starts, traces, strict=True)
    ]


def state_of(costs: Sequence[float], goal: float) -> str:
    """Return whether a run has arrived at the goal, is falling, or is level above it, by its costs after 1, 2, 4, ..
    passes.

    >>> state_of([9.0, 3.0, 1.1], 1.0), state_of([9.0, 7.0, 5.0], 1.0), state_of([9.0, 5.0, 5.0], 1.0)
    ('arrived', 'falling', 'level')
    """
    if costs[-1] <= ARRIVED * goal:
        return "arrived"
    return "falling" if costs[-1] < (1.0 - FALLING) * costs[-2] else "level"


def _run(moments: Moments, samples: Samples, config: Config, theta: Floats) -> tuple[list[float], tuple[float, float]]:
    """Return the costs after 1, 2, 4, .. passes, and what a Newton step promises after the first and the last."""
    parts = Model(config).split(theta)
    given = {name: tuple(getattr(parts, name)) for name in ("fir_taps", "wavelet_weights", "theory_taps")}
    estimator = Estimator(config.updated({f"learned.{name}": value for name, value in given.items()}))
    costs, promises = [], []
    for count in range(1, PASSES + 1):
        estimator.run(samples)
        if count & (count - 1) == 0:
            here = estimator.parameters.theta
            costs.append(moments.cost(here))
            promises.append(_promised(moments, here) / costs[-1])
    return costs, (promises[0], promises[-1])


def _promised(moments: Moments, theta: Floats) -> float:
    """Return the fall in cost that a Newton step promises, g' H^-1 g / 2 (Gauss-Newton, which is never indefinite)."""
    gradient = moments.gradient(theta)
    return 0.5 * float(gradient @ solve(moments.gauss_newton(theta), gradient))


def summary(found: Mapping[str, Sequence[End]]) -> tuple[dict[str, Any], str]:
    """Return counts and ranges by start, over all cases, and what they say in sentences."""
    every = [end for many in found.values() for end in many]
    numbers: dict[str, Any] = {"passes": PASSES}
    by_start = {start: [end for end in every if end.start == start] for start in (RANDOM, OPTIMUM, SECOND)}
    promised: dict[str, list[tuple[float, float]]] = {}
    for start, runs in by_start.items():
        if not runs:
            continue
        columns = [*zip(*(end.share_a_newton_step_promises for end in runs), strict=True)]
        promised[start] = [(min(column), max(column)) for column in columns]
        numbers[f"from {start}"] = {
            "runs": len(runs),
            **{state: sum(end.state == state for end in runs) for state in ("arrived", "falling", "level")},
            "cost_over_lowest_after_one_pass": _span([end.cost_over_lowest[0] for end in runs]),
            "cost_over_lowest_after_all_passes": _span([end.cost_over_lowest[-1] for end in runs]),
            "share_a_newton_step_promises_after_one_pass": _span(columns[0]),
            "share_a_newton_step_promises_after_all_passes": _span(columns[1]),
            "at_rest_by_a_newton_step": sum(column < SETTLED for column in columns[1]),
        }
    random, best = numbers[f"from {RANDOM}"], numbers[f"from {OPTIMUM}"]
    apart = promised[RANDOM][-1][0] > promised[OPTIMUM][-1][1]
    resting = sum(of_start["at_rest_by_a_newton_step"] for of_start in numbers.values() if isinstance(of_start, dict))
    text = (
        f"Of {random['runs']} lms runs from random taps {random['arrived']} have arrived after {PASSES} passes over "
        f"the record, {random['falling']} are still falling and {random['level']} are level above the control. This "
        f"one, started at the best minimum, leaves it: for {best['cost_over_lowest_after_one_pass']} times the least "
        f"cost after one pass and {best['cost_over_lowest_after_all_passes']} after all. {resting} of {len(every)} "
        "runs, controls included, are at rest by what a Newton step promises; after all passes that is "
        f"{_percent(promised[RANDOM][-1])} of the cost from random taps and {_percent(promised[OPTIMUM][-1])} from the "
        f"best minimum, which {'tells the two apart' if apart else 'does not tell the two apart'}."
    )
    if SECOND in promised:
        second = numbers[f"from {SECOND}"]
        starts = _span([end.start_over_lowest for end in by_start[SECOND]])
        text += (
            f" Started at a minimum that is not the best ({starts} times the least cost) lms does not stay there: "
            f"{second['cost_over_lowest_after_all_passes']} times after all passes."
        )
    return numbers, text


def _span(values: Sequence[float]) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"


def _percent(span: tuple[float, float]) -> str:
    return f"{_span([100 * one for one in span])} %"
