"""Claims about convergence: does it, how close, how fast, and how good before."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from friction_estimator.core.metrics import drive_cycles, nrmse
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.paper.claims import (
    ADAPTED,
    ELSEWHERE,
    FROZEN,
    MODES,
    Claim,
    Interval,
    Judged,
    below,
    both,
    by_step_size,
    denied,
    geometric_mean,
    share,
    without_companding,
)
from friction_estimator.paper.study import (
    BATCH,
    DEFAULT_STEP,
    LEARNERS,
    OTHER_DRIVES,
    Outcome,
    Plan,
    Study,
    derived,
    record,
)
from friction_estimator.rig.drive import CONDITIONS

CLOSE = 0.05
"""Error over the std of friction that counts as following it `quite closely`."""

NEAR = 1.1
"""Times Hammerstein's end error: there, a model has arrived."""

WRONG_THEORIES = (0.25, 0.5, 2.0, 4.0)
"""Factors on the boundary friction of the identifier's theory; the plant's is 1.3."""

PAPER_LAW = "lms"

Score = Callable[[Outcome], float]

SCORES: dict[str, dict[str, Score]] = {
    ADAPTED: {"": lambda run: run.last},
    FROZEN: {"": lambda run: run.frozen},
    ELSEWHERE: {f" on {name}": lambda run, name=name: run.elsewhere[name] for name in OTHER_DRIVES},  # type: ignore[misc]
}
"""Mode -> end of the case's name -> the error at the end."""


def _early(place: str) -> Score:
    return lambda run: run.by_cycles[1][place]


EARLY: dict[str, dict[str, Score]] = {
    ADAPTED: {"": lambda run: run.first},
    FROZEN: {"": _early(FROZEN)},
    ELSEWHERE: {f" on {name}": _early(name) for name in OTHER_DRIVES},
}
"""The same, of the first drive cycle or with what was learned in it."""

FROZEN_TEXT = (
    "Frozen: learned on the first half, judged on the second without learning. Elsewhere: the same parameters on a "
    "triangle and a multisine at the same pressure, 0.95 of the top speed."
)


def claim_of(
    judged: Judged, plain: Judged | None, *, id: str, statement: str, experiment: str, more: str = ""
) -> Claim:
    """Return the claim with the verdicts of both bases, and where they depend on the step size of lms."""
    steps = by_step_size(judged.cases, PAPER_LAW, f"{DEFAULT_STEP:g}")
    why = [judged.told, steps, more]
    numbers = dict(judged.numbers)
    if plain is not None:
        why.append(without_companding(judged, plain))
        numbers["without companding"] = dict(plain.numbers)
    return Claim(
        id=id,
        statement=statement,
        experiment=experiment,
        numbers=numbers,
        verdict=judged.verdict,
        why=" ".join(filter(None, why)),
        verdicts=judged.verdicts,
        cases=judged.counts,
        verdicts_without_companding={} if plain is None else plain.verdicts,
    )


def hammerstein_converges(study: Study, plain: Study | None = None) -> Claim:
    """Judge whether Hammerstein ends close to the measured friction, and closer than it began."""

    def judge(one: Study) -> Judged:
        cases: dict[str, dict[str, bool | None]] = {mode: {} for mode in MODES}
        numbers: dict[str, Any] = {}
        for learner in LEARNERS:
            for condition in CONDITIONS:
                runs = one.over_seeds(condition, "hammerstein", learner)
                found: dict[str, Interval] = {"last_over_first_cycle": geometric_mean([r.last / r.first for r in runs])}
                for mode, scores in SCORES.items():
                    for end, score in scores.items():
                        error = geometric_mean([score(run) for run in runs])
                        found[_error_name(mode, end)] = error
                        cases[mode][f"{learner} {condition}{end}"] = below(error, CLOSE)
                name = f"{learner} {condition}"
                cases[ADAPTED][name] = both(cases[ADAPTED][name], below(found["last_over_first_cycle"], 1.0))
                numbers[name] = found
        for condition in CONDITIONS:
            rows = one.yardsticks.get(condition, [])
            numbers[f"no model {condition}"] = {
                name: geometric_mean([row[name] for row in rows]) for name in (rows[0] if rows else ())
            }
        return Judged(cases, numbers)

    return claim_of(
        judge(study),
        None if plain is None else judge(plain),
        id="hammerstein_converges",
        statement="For the Hammerstein model the estimated friction converges to the actual friction quite closely.",
        experiment=f"{study.plan}. Adapted: a priori error of the last five drive cycles, which must also be below "
        f"that of the first. {FROZEN_TEXT} Holds where the interval of the error lies below {CLOSE:g} of the "
        "friction's spread. Beside it, of no model: persistence (the guess that friction is what it was one sample "
        "ago) while learning, and a static Stribeck curve fitted to the first half where nothing is learned.",
    )


def parallel_ends_closer(study: Study, plain: Study | None = None) -> Claim:
    """Judge Parallel's end error over Hammerstein's."""
    learners = [*LEARNERS, BATCH]
    return claim_of(
        _ratios(study, learners, SCORES),
        None if plain is None else _ratios(plain, learners, SCORES),
        id="parallel_ends_closer",
        statement="The Parallel model works better than the Hammerstein model: it converges more closely to the actual "
        "friction.",
        experiment=f"{study.plan}; error of Parallel over Hammerstein, for each law and for the batch fit of either "
        f"structure. Adapted: last five cycles (the batch fit: its own record). {FROZEN_TEXT} Holds where the interval "
        "lies below 1.",
    )


def parallel_converges_faster(study: Study, plain: Study | None = None) -> Claim:
    """Judge which model comes first within 1.1 of Hammerstein's end error."""

    def judge(one: Study) -> Judged:
        cases: dict[str, dict[str, bool | None]] = {mode: {} for mode in MODES}
        numbers: dict[str, Any] = {}
        for learner in LEARNERS:
            for condition in CONDITIONS:
                name = f"{learner} {condition}"
                both_models = [
                    *zip(
                        one.over_seeds(condition, "parallel", learner),
                        one.over_seeds(condition, "hammerstein", learner),
                        strict=True,
                    )
                ]
                pairs = [tuple(run.samples_until(NEAR * h.last) for run in (p, h)) for p, h in both_models]
                cases[ADAPTED][name], found = _sooner(pairs)
                numbers[name] = {
                    "share_of_seeds_parallel_sooner": found,
                    "median_samples_parallel": _median([p for p, _ in pairs]),
                    "median_samples_hammerstein": _median([h for _, h in pairs]),
                }
                places = [(FROZEN, FROZEN, ""), *((ELSEWHERE, drive, f" on {drive}") for drive in OTHER_DRIVES)]
                for mode, place, end in places:
                    pairs = [
                        tuple(run.cycles_until(NEAR * _end(h, place), place) for run in (p, h)) for p, h in both_models
                    ]
                    cases[mode][f"{name}{end}"], found = _sooner(pairs)
                    numbers[name] |= {
                        f"share_of_seeds_parallel_sooner_{place}": found,
                        f"median_cycles_parallel_{place}": _median([p for p, _ in pairs]),
                        f"median_cycles_hammerstein_{place}": _median([h for _, h in pairs]),
                    }
        return Judged(cases, numbers)

    return claim_of(
        judge(study),
        None if plain is None else judge(plain),
        id="parallel_converges_faster",
        statement="The theoretical model increases the convergence speed of the Parallel model.",
        experiment=f"{study.plan}. Adapted: samples learned from until the error of every later cycle-long window is "
        f"within {NEAR:g} of Hammerstein's own end error. Frozen and elsewhere: drive cycles learned from until what "
        "was learned by then, judged without learning on the second half or on another drive, is within the same "
        "factor of what Hammerstein reaches there after the first half. Holds where the Clopper-Pearson interval of "
        "the share of seeds in which Parallel is there first lies above one half; seeds in which both come at once do "
        "not count.",
    )


def wrong_theory(plan: Plan, condition: str, seed: int) -> dict[str, dict[float, float]]:
    """Return for each learner the error of the first cycle, Parallel over Hammerstein, by factor on the theory's
    boundary friction.
    """
    samples = record(plan, condition, seed)
    cycles = drive_cycles(samples.velocity_m_s)
    samples = samples[: max(part.stop - part.start for part in cycles)]
    rows: dict[str, dict[float, float]] = {}
    for learner, settings in LEARNERS.items():
        hammerstein = derived(samples, "hammerstein").updated(settings)
        reference = nrmse(samples.friction_N, Estimator(hammerstein).run(samples))
        usual = hammerstein.seal.boundary_friction
        rows[learner] = {}
        for factor in WRONG_THEORIES:
            config = derived(samples, "parallel", seal__boundary_friction=factor * usual).updated(settings)
            rows[learner][factor] = nrmse(samples.friction_N, Estimator(config).run(samples)) / reference
    return rows


def good_before_convergence(
    study: Study,
    scans: Mapping[str, Sequence[dict[str, dict[float, float]]]],
    plain: Study | None = None,
) -> Claim:
    """Judge the first cycle, with the theory as it is and with theories that are further off."""
    judged = _ratios(study, list(LEARNERS), EARLY)
    cases, numbers = {mode: dict(found) for mode, found in judged.cases.items()}, dict(judged.numbers)
    failed = []
    for learner in LEARNERS:
        for factor in WRONG_THEORIES:
            ratio = geometric_mean([scan[learner][factor] for runs in scans.values() for scan in runs])
            name = f"{learner}, theory's boundary friction x{factor:g}"
            cases[ADAPTED][name] = below(ratio, 1.0)
            numbers[name] = ratio
            if cases[ADAPTED][name] is False:
                failed.append(f"{learner} at x{factor:g} ({ratio})")
    return claim_of(
        Judged(cases, numbers),
        None if plain is None else _ratios(plain, list(LEARNERS), EARLY),
        id="good_before_convergence",
        statement="The Parallel model gives a good estimate even before the convergence, because the theory is a very "
        "good initial condition.",
        experiment=f"{study.plan}; error of Parallel over Hammerstein. Adapted: in the first drive cycle, with the "
        f"theory as it is and, over the conditions, with its boundary friction scaled by "
        f"{', '.join(f'{f:g}' for f in WRONG_THEORIES)} (the plant's is 1.3). Frozen and elsewhere: what was learned "
        "in the first cycle, judged without learning on the second half and on other drives. Holds where the interval "
        "lies below 1.",
        more="The head start is worth what the theory is worth"
        + (f": with a wrong one Parallel is worse in the first cycle for {', '.join(failed)}." if failed else "."),
    )


def _ratios(study: Study, learners: Sequence[str], scores: Mapping[str, Mapping[str, Score]]) -> Judged:
    """Return Parallel over Hammerstein, seed by seed, judged against 1."""
    cases: dict[str, dict[str, bool | None]] = {mode: {} for mode in scores}
    numbers: dict[str, Any] = {}
    for learner in learners:
        for condition in CONDITIONS:
            runs = {model: study.over_seeds(condition, model, learner) for model in ("parallel", "hammerstein")}
            name, found = f"{learner} {condition}", {}
            for mode, of_mode in scores.items():
                for end, score in of_mode.items():
                    errors = {model: [score(run) for run in many] for model, many in runs.items()}
                    ratio = geometric_mean([p / h for p, h in zip(*errors.values(), strict=True)])
                    cases[mode][f"{name}{end}"] = below(ratio, 1.0)
                    ending = _ending(mode, end)
                    found[f"parallel_over_hammerstein{ending}"] = ratio
                    for model, values in errors.items():
                        found[f"nrmse_{model}{ending}"] = geometric_mean(values)
            numbers[name] = found
    return Judged(cases, numbers)


def _ending(mode: str, end: str) -> str:
    """Return what tells the numbers of a mode apart; none while learning."""
    return "" if mode == ADAPTED else f"_{mode}" if not end else end.replace(" ", "_")


def _error_name(mode: str, end: str) -> str:
    return "nrmse_last_cycles" if mode == ADAPTED else f"nrmse{_ending(mode, end)}"


def _end(run: Outcome, place: str) -> float:
    return run.by_cycles[max(run.by_cycles)][place]


def _sooner(pairs: Sequence[Sequence[float]]) -> tuple[bool | None, Interval]:
    """Return whether the first of each pair comes first, and the share of pairs in which it does."""
    decided = [(p, h) for p, h in pairs if p != h]
    sooner = share(sum(p < h for p, h in decided), len(decided))
    return denied(below(sooner, 0.5)), sooner


def _median(values: Sequence[float]) -> float | None:
    middle = float(np.median(values))
    return middle if np.isfinite(middle) else None
