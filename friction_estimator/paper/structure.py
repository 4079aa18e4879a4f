"""The claim that filters of an order above 8 help little."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from friction_estimator.core.fit.moments import Moments, gather
from friction_estimator.core.fit.variable_projection import on_gauge, refine, start_taps
from friction_estimator.core.model.structure import Model
from friction_estimator.paper.claims import (
    ADAPTED,
    ELSEWHERE,
    FROZEN,
    Claim,
    Judged,
    below,
    denied,
    geometric_mean,
)
from friction_estimator.paper.runs import HeldOut, learn
from friction_estimator.paper.study import (
    FROZEN_SHARE,
    LEARNERS,
    MODELS,
    OTHER_DRIVES,
    Plan,
    derived,
    other_drives,
    outcome,
    record,
)

ORDERS = (0, 2, 4, 8, 12, 16)
PAPER_ORDER = 8
RATES = (200.0, 1000.0)
LITTLE = 0.05
"""A reduction of the error by less than this share is little."""

FREE = "free fit"
"""Least squares without a prior: what the order could do at best."""

Errors: TypeAlias = dict[str, dict[str, dict[int, float]]]
"""Who learned, and where it is judged ("free fit on triangle") -> model -> order -> error."""


def order_errors(plan: Plan, condition: str, seed: int, rate_hz: float) -> Errors:
    """Return the errors of each order: the free fit of the first half on the second and on other drives.

    Each order starts from the taps of the one below, so that a higher one cannot fit worse. At the plan's own rate lms
    and rls learn with the paper's order and the highest one too, and are judged by their last cycles.
    """
    samples = record(plan, condition, seed, rate_hz)
    others = other_drives(plan, condition, seed, rate_hz)
    half = round(FROZEN_SHARE * len(samples))
    learned = np.arange(len(samples)) < half
    names = [FREE, *(f"{FREE} on {profile}" for profile in others)]
    errors: Errors = {name: {model: {} for model in MODELS} for name in names}
    for model_type in MODELS:
        taps = np.ones(1)
        longest = gather(Model(derived(samples, model_type, fir__order=ORDERS[-1])), samples, learned)
        for order in ORDERS:
            model = Model(derived(samples, model_type, fir__order=order))
            moments = shortened(longest, order + 1)
            longer = np.concatenate([taps, np.zeros(order + 1 - taps.size)])
            starts = [longer, *start_taps(moments, np.random.default_rng(0))[1:2]]
            theta = on_gauge(moments, min((refine(moments, start) for start in starts), key=moments.cost))
            taps = theta[: order + 1]
            parameters = model.split(theta)
            for name, judged in zip(names, [samples[half:], *others.values()], strict=True):
                errors[name][model_type][order] = HeldOut(model, judged).error(parameters)
    if rate_hz == plan.rate_hz:
        for learner in ("lms", "rls"):
            errors[learner] = {model: {} for model in MODELS}
            for model_type in MODELS:
                for order in (PAPER_ORDER, ORDERS[-1]):
                    config = derived(samples, model_type, fir__order=order).updated(LEARNERS[learner])
                    predicted, kept = learn(samples, config)
                    errors[learner][model_type][order] = outcome(samples, predicted, kept[len(samples)]).last
    return errors


def shortened(moments: Moments, taps: int) -> Moments:
    """Return the moments of the same record for fewer taps: those of the first lags, which are there already."""
    kept = moments.gram.shape[0] // moments.taps * taps
    return replace(
        moments,
        taps=taps,
        theory_taps=min(moments.theory_taps, taps),
        gram=np.ascontiguousarray(moments.gram[:kept, :kept]),
        cross=moments.cross[:kept],
        ridge=moments.ridge[:kept],
    )


def higher_orders_help_little(plan: Plan, errors: Mapping[tuple[str, float], Sequence[Errors]]) -> Claim:
    """Judge the gain of order 16 over 8 by condition, sample rate and model."""
    cases: dict[str, dict[str, bool | None]] = {ADAPTED: {}, FROZEN: {}, ELSEWHERE: {}}
    numbers: dict[str, Any] = {}
    for (condition, rate), runs in errors.items():
        for who in runs[0]:
            mode = FROZEN if who == FREE else ELSEWHERE if who.startswith(FREE) else ADAPTED
            for model in MODELS:
                by_order = [run[who][model] for run in runs]
                ratio = geometric_mean([one[ORDERS[-1]] / one[PAPER_ORDER] for one in by_order])
                learner, on, drive = who.partition(" on ")
                name = f"{model}, {learner}, {rate:g} Hz {condition}{on}{drive}"
                cases[mode][name] = denied(below(ratio, 1.0 - LITTLE))
                numbers[name] = {
                    f"order_{ORDERS[-1]}_over_{PAPER_ORDER}": ratio,
                    "nrmse_by_order": {
                        str(order): geometric_mean([one[order] for one in by_order]) for order in by_order[0]
                    },
                }
    judged = Judged({mode: found for mode, found in cases.items() if found}, numbers)
    seeds = len(next(iter(errors.values())))
    return Claim(
        id="orders_above_8_help_little",
        statement="Filters of a higher order than 8 improve the performance slightly, not significantly.",
        experiment=f"{seeds} seeds of conditions a, b, c, {plan.seconds:g} s, {100 * plan.noise:g} % noise, at "
        f"{' and '.join(f'{rate:g}' for rate in RATES)} Hz, orders {', '.join(map(str, ORDERS))}. Adapted: last five "
        f"cycles of lms and rls at {plan.rate_hz:g} Hz. Frozen: free least squares over the first half, judged on the "
        f"second. Elsewhere: the same on a {' and a '.join(OTHER_DRIVES)}. Holds where the interval of error(16) / "
        f"error(8) lies above {1 - LITTLE:g}.",
        numbers=numbers,
        verdict=judged.verdict,
        why=judged.told,
        verdicts=judged.verdicts,
        cases=judged.counts,
    )
