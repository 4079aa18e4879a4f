"""The claim that Hammerstein's g has the theory's shape except for magnitude and sign."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.paper.claims import (
    ADAPTED,
    ELSEWHERE,
    FROZEN,
    Claim,
    Judged,
    Theorem,
    below,
    both,
    geometric_mean,
    share,
)
from friction_estimator.paper.convergence import claim_of
from friction_estimator.paper.runs import learn
from friction_estimator.paper.study import (
    BATCH,
    COMPANDED,
    LEARNERS,
    Plan,
    Study,
    derived,
    longer_drive,
    record,
    static_curves,
)
from friction_estimator.rig.drive import CONDITIONS

ALIKE = 0.95
"""Correlation with the theory above which a curve counts as of similar shape."""

ANOTHER = "multisine"
"""Drive from which g is learned elsewhere."""


@dataclass(frozen=True)
class Likeness:
    """How alike g and the theory d are, on 401 velocities over those driven.

    Attributes
    ----------
    apart : 1 - |correlation|.
    sign_apart : the same of sign(v), which knows nothing but the direction.
    beyond_sign : correlation of what sign(v) does not explain in either, g taken with the sign of its gain.
    gain : of g, with A as the law leaves it, over d (least squares): magnitude and sign.
    """

    apart: float
    sign_apart: float
    beyond_sign: float
    gain: float


def likeness(v: Floats, g: Floats, d: Floats) -> Likeness:
    """Compare two curves (n,) over velocities (n,).

    >>> v = np.linspace(-1.0, 1.0, 401)
    >>> one = likeness(v, -3.0 * np.tanh(5 * v), np.tanh(5 * v))
    >>> round(one.apart, 6), round(one.gain, 6), round(one.beyond_sign, 6), one.sign_apart > 0.01
    (0.0, -3.0, 1.0, True)
    """
    direction = np.sign(v)
    gain = float(g @ d / (d @ d))

    def correlation(one: Floats, other: Floats) -> float:
        return float(np.corrcoef(one, other)[0, 1])

    def beyond(curve: Floats) -> Floats:
        columns = np.column_stack([np.ones(v.size), direction])
        return np.asarray(curve - columns @ np.linalg.lstsq(columns, curve, rcond=None)[0])

    return Likeness(
        apart=1.0 - abs(correlation(g, d)),
        sign_apart=1.0 - abs(correlation(direction, d)),
        beyond_sign=float(np.copysign(1.0, gain)) * correlation(beyond(g), beyond(d)),
        gain=gain,
    )


def likeness_of(config: Config, parameters: Parameters, samples: Samples) -> Likeness:
    """Compare g, without the static gain of H, with the theory over the velocities of a recording."""
    v, g, d = static_curves(config.updated({"model.type": "hammerstein"}), parameters, samples)
    return likeness(v, g / parameters.fir_taps.sum(), d)


def learned_elsewhere(plan: Plan, condition: str, seed: int) -> dict[str, Likeness]:
    """Return for every learner, and the batch fit, how alike g is that was learned from another drive."""
    samples = longer_drive(plan, condition, seed, ANOTHER)
    config = derived(samples, "hammerstein", basis__companding=COMPANDED)
    found = {BATCH: likeness_of(config, fit_batch(samples, config).parameters, samples)}
    for learner, settings in LEARNERS.items():
        _, kept = learn(samples, config.updated(settings))
        found[learner] = likeness_of(config, kept[len(samples)], samples)
    return found


def mirrored_run(plan: Plan, condition: str) -> float:
    """Return how far, relative to |theta|, lms from -A ends from the mirror image of where it ends from A (0: the bits
    of the predictions are equal too).
    """
    samples = record(plan, condition, 0)
    config = derived(samples, "hammerstein", model__law="lms")
    taps = np.zeros(config.fir.order + 1)
    runs = []
    for sign in (1.0, -1.0):
        taps[0] = sign
        predicted, kept = learn(samples, config.updated({"learned.fir_taps": tuple(taps)}))
        runs.append((predicted, kept[len(samples)]))
    (predicted, one), (mirrored, other) = runs
    if not np.array_equal(predicted, mirrored):
        return float("inf")
    size = one.fir_taps.size + one.wavelet_weights.size
    return float(np.linalg.norm((one.theta + other.theta)[:size]) / np.linalg.norm(one.theta[:size]))


def g_has_the_shape(
    study: Study,
    elsewhere: Mapping[str, Sequence[Mapping[str, Likeness]]],
    mirrored: Mapping[str, float],
    plain: Study | None = None,
) -> Claim:
    """Judge the correlation of Hammerstein's g with the theory over the velocities driven.

    Parameters
    ----------
    elsewhere : by condition, what `learned_elsewhere` found for some seeds. mirrored : by condition, `mirrored_run`.
    """
    judged = _judge(study, elsewhere)
    distance = max(mirrored.values())
    signs = Theorem(
        "The sign of g is that of the start: lms started at (-A, -W) runs through the mirror images of the points that "
        "it runs through from (A, W), and predicts the same.",
        "The law's step in A is linear in W and that in W in A; both have changed their sign, and the error has not.",
        f"From A = (1, 0, ..) and from A = (-1, 0, ..), W = 0, every prediction has the same bits and the ends are "
        f"mirror images to {distance:.1e}"
        if np.isfinite(distance)
        else "The predictions of the two runs differ: the program departs from the law",
    )
    numbers = dict(judged.numbers)
    claim = claim_of(
        Judged(judged.cases, numbers),
        None if plain is None else _judge(plain, {}),
        id="g_has_the_theorys_shape",
        statement="The estimated nonlinear mapping of the Hammerstein model has a shape similar to the theoretical one "
        "except for magnitude and sign.",
        experiment=f"{study.plan}; correlation of g with the theory d on 401 velocities over the driven range. "
        "Adapted: g at the end. Frozen: g after the first half. Elsewhere: g learned from a multisine instead "
        f"({len(next(iter(elsewhere.values()), ()))} seeds). sign(v) alone correlates with d too: a case holds where "
        f"the interval of 1 - |correlation| lies below {1.0 - ALIKE:.2g} and that of its ratio to sign(v)'s below 1. "
        "beyond_sign is the correlation of what sign(v) leaves of either.",
        more=_told(numbers),
    )
    return replace(claim, theorems=(signs,))


def _judge(study: Study, elsewhere: Mapping[str, Sequence[Mapping[str, Likeness]]]) -> Judged:
    modes = (ADAPTED, FROZEN, ELSEWHERE) if elsewhere else (ADAPTED, FROZEN)
    cases: dict[str, dict[str, bool | None]] = {mode: {} for mode in modes}
    numbers: dict[str, Any] = {}
    negative = trials = 0
    for learner in (*LEARNERS, BATCH):
        for condition in CONDITIONS:
            shown = study.shown[condition]
            runs = study.over_seeds(condition, "hammerstein", learner)
            found = {
                ADAPTED: [likeness_of(shown.config, run.parameters, shown.samples) for run in runs],
                FROZEN: [
                    likeness_of(shown.config, run.frozen_parameters, shown.samples)
                    for run in runs
                    if run.frozen_parameters is not None
                ],
            }
            if elsewhere:
                found[ELSEWHERE] = [one[learner] for one in elsewhere[condition]]
            name = f"{learner} {condition}"
            numbers[name] = {}
            for mode, likes in found.items():
                ending = "" if mode == ADAPTED else f"_{mode}"
                apart = geometric_mean([one.apart for one in likes])
                over_sign = geometric_mean([one.apart / one.sign_apart for one in likes])
                cases[mode][name] = both(below(apart, 1.0 - ALIKE), below(over_sign, 1.0))
                numbers[name] |= {
                    f"one_minus_correlation{ending}": apart,
                    f"over_that_of_sign_v{ending}": over_sign,
                    f"beyond_sign{ending}": float(np.mean([one.beyond_sign for one in likes])),
                    f"scale_of_g_over_theory{ending}": geometric_mean([abs(one.gain) for one in likes]),
                }
            if learner != BATCH:  # its sign is that of the prior
                negative += sum(one.gain < 0.0 for one in found[ADAPTED])
                trials += len(runs)
    for condition in CONDITIONS:
        shown = study.shown[condition]
        one = likeness_of(shown.config, study.over_seeds(condition, "hammerstein", BATCH)[0].parameters, shown.samples)
        numbers[f"sign(v) {condition}"] = {"correlation_with_theory": 1.0 - one.sign_apart}
    numbers["share_of_runs_with_negative_sign"] = share(negative, trials)
    return Judged(cases, numbers)


def _told(numbers: Mapping[str, Any]) -> str:
    signs = [numbers[f"sign(v) {condition}"]["correlation_with_theory"] for condition in CONDITIONS]
    return (
        f"sign(v) alone correlates {', '.join(f'{one:.3f}' for one in signs)} with the theory at "
        f"{', '.join(CONDITIONS)}: only what is above that says anything of the shape."
    )
