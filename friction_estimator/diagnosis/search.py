"""Greedy search for causes: screen the library, gate, compare by joint refit, and say what cannot be told apart."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import SPLINES, OddCurve, fit_base, lagged, piece_starts
from friction_estimator.diagnosis.evidence import Evidence, Fit, Moments, Rule, null_maximum
from friction_estimator.diagnosis.excitation import pressure_order
from friction_estimator.diagnosis.joint import (
    SETTLED_ROUNDS,
    Capacity,
    Joint,
    Term,
    cross_validated_loss,
    fit_joint,
)
from friction_estimator.diagnosis.library import Hypothesis, build_library
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import EFFECTS, REVERSAL, SLOW
from friction_estimator.effects.features import Context

LEVEL = 0.01
FLIPS = 400
MARGIN = 1.15
"""The best held-out gain must exceed this many times the bootstrap's quantile."""

LEAST_SHARE = 0.0008
"""And this share of the error power."""

EVERYWHERE = 0.7
"""Share of blocks in which a wave in time or position must bring a gain."""

CANDIDATES = 6
"""Effects that are compared by joint refit."""

CONTENDER = 0.25
"""Share of the best screened gain below which an effect is not refitted."""

MEASURED_SHARE = 0.25
"""Of the best gain: what a recorded variable must explain to be preferred to an unrecorded one."""

SECOND_SHARE = 0.02
ALIKE_SHARE = 0.10
"""A further cause must bring this share of the first one's gain; the larger where both act near reversals, since what
another functional form of the first leaves there looks like the second."""

MOST_CAUSES = 4
PLAIN = 10.0
"""Times the noise power: surplus of gain that one more parameter must bring."""

SET_ERRORS = 2.0
SET_SHARE = 0.03
FINER = 24
LONGER = 16


@dataclass(frozen=True)
class Screened:
    """The best hypothesis of one effect after the linear screening."""

    name: str
    params: dict[str, float]
    gain: float
    hypothesis: Hypothesis
    fit: Fit


@dataclass(frozen=True)
class Cause:
    """A named cause.

    Attributes
    ----------
    name : effect id. p_value : family-wise. gain : held-out decrease of the error power, summed, N^2.
    rivals : effects that explain the data as well, best first.
    """

    name: str
    p_value: float
    gain: float
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Attributes
    ----------
    causes : strongest first. models : base alone, then with each cause added.
    thresholds : gain that an effect had to exceed, N^2 (ordinary and wide hypotheses).
    library : of the last round. capacity : of the base model. warnings : in words.
    asked : effects that would have won but need a channel.
    """

    causes: tuple[Cause, ...]
    models: tuple[Joint, ...]
    thresholds: tuple[float, float]
    capacity: Capacity
    warnings: tuple[str, ...]
    asked: tuple[str, ...]
    last_evidence: Evidence
    screened: tuple[Screened, ...]


Progress = Callable[[str, float], None]


def screen(evidence: Evidence, library: Sequence[Hypothesis]) -> list[Screened]:
    """Return the best hypothesis of each effect by nested cross-validation, best first.

    In each fold the grid point is chosen on the training blocks alone, and scored on the others.
    """
    by_name: dict[str, list[Hypothesis]] = {}
    for item in library:
        by_name.setdefault(item.name, []).append(item)
    everything = np.ones(evidence.blocks, np.bool_)
    gains = {name: np.zeros(evidence.blocks) for name in by_name}
    for fold in range(int(evidence.folds.max()) + 1):
        test = evidence.folds == fold
        for name, items in by_name.items():
            fits = [evidence.fit(h.moments, h.rule, ~test) for h in items]
            best = int(np.argmax([f.gain for f in fits]))
            gains[name][test] = evidence.held_out(fits[best], items[best].moments, test, ~test)
    out = []
    for name, items in by_name.items():
        fits = [evidence.fit(h.moments, h.rule, everything) for h in items]
        best = int(np.argmax([f.gain for f in fits]))
        gain = gains[name]
        # What is there at every speed and time shows in nearly every block; leakage of the drive does not.
        everywhere = not EFFECTS[name].many or float(np.mean(gain > 0.0)) >= EVERYWHERE
        out.append(
            Screened(name, items[best].params, float(gain.sum()) if everywhere else 0.0, items[best], fits[best])
        )
    return sorted(out, key=lambda s: -s.gain)


def gate(
    record: Record, joint: Joint, library: Sequence[Hypothesis], best: Sequence[Screened], seed: int
) -> tuple[Floats, Floats]:
    """Return the bootstrap's largest gains, (flips,) for ordinary and for wide hypotheses, N^2.

    The blocks' signs are flipped after the best candidates' share was taken out of the residual, or the threshold would
    grow with the effect.
    """
    columns = [s.hypothesis.columns for s in best[:3] if s.fit.gain > 0.0]
    residual = joint.residual_N.copy()
    if columns:
        design = np.column_stack([joint.tangent, *columns])[record.used]
        design = design / np.maximum(np.sqrt(np.mean(np.square(design), axis=0)), 1e-300)
        gram = inner(design, design) + 1e-6 * len(design) * np.eye(design.shape[1])
        residual[record.used] -= design @ np.linalg.solve(gram, inner(design, residual[record.used]))
    calm = Evidence(joint.tangent, joint.penalty, residual, record.used, record.block, seed)
    groups: dict[bool, tuple[list[tuple[Floats, Floats]], list[Rule]]] = {False: ([], []), True: ([], [])}
    for item in library:
        xe = calm.moments_of(item.columns, item.moments)
        projections, rules = groups[item.effect.many]
        projections.append(calm.projected(xe))
        rules.append(item.rule)
    return (
        null_maximum(calm, *groups[False], FLIPS),
        null_maximum(calm, *groups[True], FLIPS),
    )


def search(
    record: Record,
    config: Config,
    context: Context,
    seed: int,
    progress: Progress,
    coarse_N2: float = 0.0,
    known: Collection[str] = (),
) -> Search:
    """Find the causes in a record, greedily, until nothing passes the gate.

    `coarse_N2` is error power that is known to be a lattice's: causes must bring more than that. `known` are
    effects that were found in the data already.
    """
    capacity = Capacity(SPLINES, config.fir.order)
    warnings: list[str] = []
    progress("base model", 0.1)
    base = fit_base(record, config, splines=capacity.splines, order=capacity.order)
    models = [fit_joint(record, config, context, start=base, capacity=capacity)]
    losses = [cross_validated_loss(models[0], record, seed)]
    causes: list[Cause] = []
    asked: list[str] = []
    thresholds = (0.0, 0.0)
    while True:
        model = models[-1]
        evidence = model.evidence(record, seed)
        out = {t.name for t in model.terms} | set(asked) | set(known)
        if any(EFFECTS[n].recorded for n in out) and pressure_order(record):
            out |= {n for n, cls in EFFECTS.items() if cls.acts == SLOW}
        families = {t.effect.family for t in model.terms}
        out |= {n for n, cls in EFFECTS.items() if cls.family in families}
        progress(f"screening for cause {len(causes) + 1}", 0.15 + 0.2 * len(causes))
        library = build_library(model.features, model.reference, context, evidence, out)
        screened = screen(evidence, library)
        null, wide = gate(record, model, library, screened, seed)
        thresholds = tuple(float(np.quantile(n, 1.0 - LEVEL / 2.0)) * MARGIN for n in (null, wide))  # type: ignore[assignment]
        least = LEAST_SHARE * float(evidence.ee.sum()) + coarse_N2 * evidence.samples
        passing = [s for s in screened if s.gain > max(thresholds[EFFECTS[s.name].many], least)]
        finer = _capacity_gains(record, model, evidence, capacity) if not causes and len(warnings) < 2 else {}
        wider = max(finer, key=lambda k: finer[k], default=None)
        lack = finer[wider] if wider is not None else 0.0
        found = None
        if passing and len(causes) < MOST_CAUSES:
            progress(f"comparing causes {len(causes) + 1}", 0.2 + 0.2 * len(causes))
            found = compare(record, config, context, model, losses[-1], passing, capacity, seed, causes)
        if wider is not None and lack > max(3.0 * thresholds[0], least, found[4] if found else 0.0):
            capacity = wider
            what = "a finer static curve" if wider.splines > SPLINES else "a longer memory"
            warnings.append(f"the base model needed {what} than usual; that is lack of fit, no cause")
            base = fit_base(record, config, splines=capacity.splines, order=capacity.order)
            models = [fit_joint(record, config, context, start=base, capacity=capacity)]
            losses = [cross_validated_loss(models[0], record, seed)]
            continue
        if found is None or not _enough(found[0], found[4], causes, max(thresholds[EFFECTS[found[0]].many], least)):
            break
        winner, joint, loss, rivals, gain = found
        if EFFECTS[winner].channel and EFFECTS[winner].channel not in context.channels:
            asked.append(winner)
            continue
        pool = wide if EFFECTS[winner].many else null
        p_value = min(1.0, 2.0 * float(1 + np.sum(pool >= gain)) / (FLIPS + 1))
        causes.append(Cause(winner, p_value, gain, rivals))
        models.append(joint)
        losses.append(loss)
    return Search(
        tuple(causes), tuple(models), thresholds, capacity, tuple(warnings), tuple(asked), evidence, tuple(screened)
    )


def _enough(name: str, gain: float, causes: Sequence[Cause], least_N2: float) -> bool:
    """Return whether a cause brings enough, by itself and beside what the first one brought."""
    alike = EFFECTS[name].acts == REVERSAL and any(EFFECTS[c.name].acts == REVERSAL for c in causes)
    share = ALIKE_SHARE if alike else SECOND_SHARE
    return gain >= least_N2 and not (causes and gain < share * causes[0].gain)


def compare(
    record: Record,
    config: Config,
    context: Context,
    model: Joint,
    loss: Floats,
    passing: Sequence[Screened],
    capacity: Capacity,
    seed: int,
    causes: Sequence[Cause],
) -> tuple[str, Joint, Floats, tuple[str, ...], float] | None:
    """Refit the best candidates jointly with base and earlier causes; return the winner and its equals."""
    top = [s for s in passing[:CANDIDATES] if s.gain > CONTENDER * passing[0].gain]
    known = {s.name for s in top}
    # What shows at reversals is badly screened while the base model has bent towards it.
    top += [s for s in passing if EFFECTS[s.name].acts == REVERSAL and s.name not in known][:2]
    fits: dict[str, tuple[Joint, Floats]] = {}
    for item in top:
        terms = [*model.terms, Term(EFFECTS[item.name], dict(item.params))]
        joint = fit_joint(record, config, context, terms, start=model.base, capacity=capacity)
        if not _signs_kept(joint):
            continue
        fits[item.name] = (joint, cross_validated_loss(joint, record, seed))
    gains = {n: float((loss - after).sum()) for n, (_, after) in fits.items()}
    gains = {n: g for n, g in gains.items() if np.isfinite(g)}
    best = max(gains.values(), default=0.0)
    if best <= 0.0:
        return None
    for name in [n for n in gains if gains[n] > 0.9 * best]:
        joint = fits[name][0]
        settled = fit_joint(
            record, config, context, joint.terms, start=joint.base, rounds=SETTLED_ROUNDS, capacity=capacity
        )
        if not _signs_kept(settled):
            if len(gains) > 1:
                del gains[name]
            continue
        fits[name] = (settled, cross_validated_loss(settled, record, seed))
        gains[name] = float((loss - fits[name][1]).sum())
    winner = max(gains, key=lambda n: gains[n])
    winner = _plainer(winner, gains, fits, sample_power(loss, record))
    # A recorded pressure that changed is preferred to an unrecorded cause that would have had to change with it, where
    # the order of pressures cannot separate the two (decision 0021).
    measured = max((n for n in gains if EFFECTS[n].recorded), key=lambda n: gains[n], default=winner)
    preferred = gains[measured] > MEASURED_SHARE * gains[winner] and _enough(measured, gains[measured], causes, 0.0)
    if EFFECTS[winner].acts == SLOW and preferred and pressure_order(record):
        winner = measured
    joint, lowest = fits[winner]
    for params in EFFECTS[winner].variants(joint.terms[-1].params):
        terms = [*model.terms, Term(EFFECTS[winner], params)]
        other = fit_joint(record, config, context, terms, start=model.base, capacity=capacity)
        after = cross_validated_loss(other, record, seed)
        surplus = float((lowest - after).sum())
        if np.isfinite(surplus) and surplus > PLAIN * sample_power(after, record):
            joint, lowest = other, after
            gains[winner] = float((loss - after).sum())
    rivals = []
    for name in sorted(gains, key=lambda n: -gains[n]):
        if name == winner:
            continue
        behind = fits[name][1] - lowest
        error = float(np.std(behind, ddof=1)) * np.sqrt(behind.size)
        if behind.sum() < SET_ERRORS * error or gains[winner] - gains[name] < SET_SHARE * gains[winner]:
            rivals.append(name)
    return winner, joint, lowest, tuple(rivals), gains[winner]


def _signs_kept(joint: Joint) -> bool:
    """Return whether the coefficients have the signs that physics gives them."""
    return all(
        sign * weight >= 0.0
        for term in joint.terms
        if len(term.effect.signs) == term.weights.size
        for sign, weight in zip(term.effect.signs, term.weights, strict=True)
    )


def sample_power(loss: Floats, record: Record) -> float:
    """Return the mean error power of a sample, N^2."""
    return float(loss.sum()) / max(int(record.used.sum()), 1)


def _plainer(winner: str, gains: dict[str, float], fits: dict[str, tuple[Joint, Floats]], noise_N2: float) -> str:
    """Return an effect with fewer parameters where the winner's surplus is what its further ones bring by chance."""

    def freedom(name: str) -> int:
        term = fits[name][0].terms[-1]
        return (0 if term.effect.fixed_gain else term.weights.size) + len(term.effect.refined)

    close = [n for n in gains if gains[winner] - gains[n] < PLAIN * noise_N2 * max(freedom(winner) - freedom(n), 0)]
    return min([winner, *close], key=lambda n: (freedom(n), -gains[n]))


def _capacity_gains(record: Record, model: Joint, evidence: Evidence, capacity: Capacity) -> dict[Capacity, float]:
    """Return the held-out gain of a finer static curve and of a longer memory."""
    out = {}
    start = piece_starts(record.restart)
    if capacity.splines < FINER:
        fine = OddCurve(model.base.curve.top, FINER)(record.features.velocity_m_s)
        out[Capacity(FINER, capacity.order)] = _gain(evidence, fine)
    if capacity.order < LONGER:
        force = model.base.static_N
        more = np.column_stack([lagged(force, i, start) - force for i in range(capacity.order + 1, LONGER + 1)])
        out[Capacity(capacity.splines, LONGER)] = _gain(evidence, more)
    return out


def _gain(evidence: Evidence, columns: Floats) -> float:
    moments: Moments = evidence.moments(columns)
    return float(evidence.cross_validated(moments, Rule((0,) * columns.shape[1])).sum())
