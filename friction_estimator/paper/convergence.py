"""Claims about convergence: does it, how close, how fast, how good before, and in which shape of g."""

from collections.abc import Mapping, Sequence

import numpy as np

from friction_estimator.core.metrics import drive_cycles, nrmse
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.paper.claims import Claim, Interval, below, geometric_mean, listed, share, verdict
from friction_estimator.paper.study import BATCH, Plan, Study, derived, record, static_curves
from friction_estimator.rig.drive import CONDITIONS

CLOSE = 0.05
"""Error over the std of friction that counts as following it `quite closely`."""

ALIKE = 0.95
"""Correlation with the theory above which a curve counts as of similar shape."""

WRONG_THEORIES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors on the boundary friction of the identifier's theory."""

CASES = [(law, condition) for law in LAWS for condition in CONDITIONS]


def hammerstein_converges(study: Study) -> Claim:
    """Judge whether Hammerstein ends close to the measured friction, and closer than it began."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {}
    for law, condition in CASES:
        runs = study.over_seeds(condition, "hammerstein", law)
        end, ratio = geometric_mean([r.last for r in runs]), geometric_mean([r.last / r.first for r in runs])
        cases[f"{law} {condition}"] = _both(below(end, CLOSE), below(ratio, 1.0))
        numbers[f"{law} {condition}"] = {"nrmse_last_cycles": end, "last_over_first_cycle": ratio}
    return Claim(
        id="hammerstein_converges",
        statement="For the Hammerstein model the estimated friction converges to the actual friction quite closely.",
        experiment=f"{study.plan}; a priori error of the last five drive cycles, and over that of the first. Holds for "
        f"a law and condition where the interval of the first lies below {CLOSE:g} of the friction's spread and that "
        "of the second below 1.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"It holds for: {listed(cases, True)}; it fails for: {listed(cases, False)}.",
    )


def parallel_ends_closer(study: Study) -> Claim:
    """Judge Parallel's end error over Hammerstein's."""
    cases, numbers = _ratios(study, [*LAWS, BATCH], "last")
    return Claim(
        id="parallel_ends_closer",
        statement="The Parallel model works better than the Hammerstein model: it converges more closely to the actual "
        "friction.",
        experiment=f"{study.plan}; error of the last five cycles, Parallel over Hammerstein, for each law and for the "
        "batch fit of either structure. Holds where the interval lies below 1.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Parallel ends closer for {listed(cases, True)}; farther for {listed(cases, False)}; undecided: "
        f"{listed(cases, None)}.",
    )


def parallel_converges_faster(study: Study) -> Claim:
    """Judge which model comes first within 1.1 of Hammerstein's end error."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {}
    for law, condition in CASES:
        pairs = [
            (p.samples_until(1.1 * h.last), h.samples_until(1.1 * h.last))
            for p, h in zip(
                study.over_seeds(condition, "parallel", law),
                study.over_seeds(condition, "hammerstein", law),
                strict=True,
            )
        ]
        decided = [(p, h) for p, h in pairs if p != h]
        sooner = share(sum(p < h for p, h in decided), len(decided)) if decided else Interval(0.5, 0.0, 1.0)
        above = below(sooner, 0.5)
        cases[f"{law} {condition}"] = None if above is None else not above
        numbers[f"{law} {condition}"] = {
            "share_of_seeds_parallel_sooner": sooner,
            "median_samples_parallel": _median([p for p, _ in pairs]),
            "median_samples_hammerstein": _median([h for _, h in pairs]),
        }
    return Claim(
        id="parallel_converges_faster",
        statement="The theoretical model increases the convergence speed of the Parallel model.",
        experiment=f"{study.plan}; samples learned from until the error of every later cycle-long window is within 1.1 "
        "of Hammerstein's own end error. Holds where the Clopper-Pearson interval of the share of seeds in which "
        "Parallel is there first lies above one half.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Parallel is there first for {listed(cases, True)}; Hammerstein for {listed(cases, False)}; "
        f"undecided: {listed(cases, None)}.",
    )


def wrong_theory(plan: Plan, condition: str, seed: int) -> dict[str, dict[float, float]]:
    """Return for each law the error of the first cycle, Parallel over Hammerstein, by factor on the theory's boundary
    friction.
    """
    samples = record(plan, condition, seed)
    cycles = drive_cycles(samples.velocity_m_s)
    samples = samples[: max(part.stop - part.start for part in cycles)]
    rows: dict[str, dict[float, float]] = {}
    for law in LAWS:
        hammerstein = derived(samples, "hammerstein", model__law=law)
        reference = nrmse(samples.friction_N, Estimator(hammerstein).run(samples))
        usual = hammerstein.seal.boundary_friction
        rows[law] = {}
        for factor in WRONG_THEORIES:
            config = derived(samples, "parallel", model__law=law, seal__boundary_friction=factor * usual)
            rows[law][factor] = nrmse(samples.friction_N, Estimator(config).run(samples)) / reference
    return rows


def good_before_convergence(study: Study, scans: Mapping[str, Sequence[dict[str, dict[float, float]]]]) -> Claim:
    """Judge the first cycle, with the theory as it is and with theories that are further off."""
    cases, numbers = _ratios(study, list(LAWS), "first")
    for law in LAWS:
        for factor in WRONG_THEORIES:
            if factor == 1.0:
                continue
            ratio = geometric_mean([scan[law][factor] for runs in scans.values() for scan in runs])
            name = f"{law}, theory's boundary friction x{factor:g}"
            cases[name] = below(ratio, 1.0)
            numbers[name] = ratio
    return Claim(
        id="good_before_convergence",
        statement="The Parallel model gives a good estimate even before the convergence, because the theory is a very "
        "good initial condition.",
        experiment=f"{study.plan}; error of the first drive cycle, Parallel over Hammerstein; then the same with the "
        f"theory's boundary friction scaled by {', '.join(f'{f:g}' for f in WRONG_THEORIES if f != 1.0)} (the plant's "
        "is 1.3), over the conditions. Holds where the interval lies below 1.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Better in the first cycle for {listed(cases, True)}; worse for {listed(cases, False)}: the head start is "
        "worth what the theory is worth.",
    )


def g_has_the_shape(study: Study) -> Claim:
    """Judge the correlation of Hammerstein's g with the theory over the velocities driven."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {}
    negative = trials = 0
    for law in (*LAWS, BATCH):
        for condition in CONDITIONS:
            shown = study.shown[condition]
            config = shown.config.updated({"model.type": "hammerstein"})
            apart, gains = [], []
            for run in study.over_seeds(condition, "hammerstein", law):
                _, g, d = static_curves(config, run.parameters, shown.samples)
                bare = g / run.parameters.fir_taps.sum()
                apart.append(1.0 - abs(float(np.corrcoef(g, d)[0, 1])))
                gains.append(float(bare @ d / (d @ d)))
                negative += gains[-1] < 0.0
                trials += 1
            distance = geometric_mean(apart)
            cases[f"{law} {condition}"] = below(distance, 1.0 - ALIKE)
            numbers[f"{law} {condition}"] = {
                "one_minus_correlation": distance,
                "scale_of_g_over_theory": geometric_mean(np.abs(gains).tolist()),
            }
    numbers["share_of_runs_with_negative_sign"] = share(negative, trials)
    return Claim(
        id="g_has_the_theorys_shape",
        statement="The estimated nonlinear mapping of the Hammerstein model has a shape similar to the theoretical one "
        "except for magnitude and sign.",
        experiment=f"{study.plan}; correlation of g with the theory d on 401 velocities over the driven range, and the "
        f"factor between them. Holds where the interval of 1 - |correlation| lies below {1.0 - ALIKE:.2g}.",
        numbers=numbers,
        verdict=verdict(cases.values()),
        why=f"Similar for {listed(cases, True)}; not for {listed(cases, False)}; undecided: {listed(cases, None)}; the "
        f"sign came out negative in {negative} of {trials} runs, as the start has it.",
    )


def _ratios(study: Study, laws: Sequence[str], what: str) -> tuple[dict[str, bool | None], dict[str, object]]:
    """Return Parallel over Hammerstein, seed by seed, of `first` or `last`, judged against 1."""
    cases: dict[str, bool | None] = {}
    numbers: dict[str, object] = {}
    for law in laws:
        for condition in CONDITIONS:
            parallel, hammerstein = (study.over_seeds(condition, model, law) for model in ("parallel", "hammerstein"))
            ratios = [getattr(p, what) / getattr(h, what) for p, h in zip(parallel, hammerstein, strict=True)]
            ratio = geometric_mean(ratios)
            cases[f"{law} {condition}"] = below(ratio, 1.0)
            numbers[f"{law} {condition}"] = {
                "parallel_over_hammerstein": ratio,
                "nrmse_parallel": geometric_mean([getattr(p, what) for p in parallel]),
                "nrmse_hammerstein": geometric_mean([getattr(h, what) for h in hammerstein]),
            }
    return cases, numbers


def _both(one: bool | None, other: bool | None) -> bool | None:
    if one is False or other is False:
        return False
    return True if one and other else None


def _median(values: Sequence[float]) -> float | None:
    middle = float(np.median(values))
    return middle if np.isfinite(middle) else None
