"""The diagnosis: from recordings to a verdict, the named causes, the extended model and the gain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from friction_estimator.core.sample import Bools, Floats, Ints, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import BaseFit
from friction_estimator.diagnosis.excitation import Excitation, assess
from friction_estimator.diagnosis.floor import noise_floor
from friction_estimator.diagnosis.joint import Estimate, Joint, estimates, fit_joint
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.remainder import Remainder, unexplained
from friction_estimator.diagnosis.repair import confirmed, repaired, scattered
from friction_estimator.diagnosis.search import Search, search
from friction_estimator.diagnosis.words import next_experiment, structural_rivals
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.effects.features import Context

HELD_OUT_FOLDS = 4
LEAST_SHARE = 0.002


@dataclass(frozen=True)
class Gain:
    """What naming an effect is worth on data that the fit never saw."""

    nrmse_before: float
    nrmse_after: float
    reduction_percent: float
    low_percent: float
    high_percent: float


@dataclass(frozen=True)
class Found:
    """One named effect.

    Attributes
    ----------
    name : effect id. p_value : family-wise. parameters : fitted, with intervals. gain : held-out.
    rivals : effects that the data cannot tell from it. experiment : what would. evidence : a sentence.
    term : its place among the model's terms, or None for an effect that is repaired rather than modelled.
    """

    name: str
    p_value: float | None
    parameters: dict[str, Estimate]
    gain: Gain
    rivals: tuple[str, ...]
    experiment: str | None
    evidence: str
    term: int | None


@dataclass(frozen=True)
class Diagnosis:
    """The result, with everything that figures and words need.

    Attributes
    ----------
    verdict : effects_found, nothing_found or undecidable. effects : strongest first.
    needs_channel : (effect id, channel). unexplained_percent : of the held-out rms, above the noise floor.
    nrmse_holdout, noise_floor : of the base model, over the standard deviation of the measured friction.
    detection_limit_N : effect id -> rms of the smallest change that would have been named, N.
    models : base alone, then with each modelled effect added. remainder : what is left, or None.
    """

    verdict: str
    excitation: Excitation
    nrmse_holdout: float
    noise_floor: float
    effects: tuple[Found, ...]
    needs_channel: tuple[tuple[str, str], ...]
    unexplained_percent: float
    remainder: Remainder | None
    detection_limit_N: dict[str, float]
    record: Record
    raw: Record
    context: Context
    models: tuple[Joint, ...]
    findings: tuple[Fault, ...]


Progress = Callable[[str, float], None]


def _silent(_stage: str, _part: float) -> None:
    """Report nothing."""


def diagnose(
    recordings: Sequence[Samples],
    config: Config,
    seed: int = 0,
    progress: Progress = _silent,
    faults: Sequence[Fault] = (),
) -> Diagnosis:
    """Diagnose recordings.

    Parameters
    ----------
    recordings : one or more, in the order in which they were made. config : theory, FIR order, extension terms.
    seed : of folds and bootstrap; the same seed gives the same result. progress : told of stage and share done.
    faults : of the stamps, found while reading (`streams`).

    Raises
    ------
    UnanswerableError : too few usable samples, or no motion.
    """
    progress("reading", 0.0)
    raw = build_record(recordings, config)
    context = raw.context(config, float(np.abs(raw.friction_N).max()))
    excitation = assess(raw, context)
    if excitation.undecidable:
        return _undecidable(raw, config, context, excitation)
    record, context, findings = repaired(raw, config, context)
    findings = [*faults, *findings]
    coarse = max((f.conceals_N2 for f in findings), default=0.0)
    found = search(record, config, context, seed, progress, coarse, {f.name for f in findings})
    findings = confirmed(findings, record, context, found.models[-1])
    progress("measuring gains on held-out data", 0.75)
    effects, models = _named(record, config, context, found, seed)
    progress("noise floor and remainder", 0.85)
    final = models[-1]
    floor = noise_floor(record, final.residual_N)
    findings += scattered(record, context, final, findings)
    spread = float(np.std(record.friction_N[record.used]))
    base_error = _held_out_rms(record, config, context, models[0], found)
    last_error = effects[-1].gain.nrmse_after * spread if effects else base_error
    quality_effects = [_from_finding(f, base_error, spread) for f in findings]
    remainder = None if coarse else unexplained(record, final, found, findings, seed)
    ordered = _ordered(effects, quality_effects, findings, record)
    asked = _asked(found, effects, remainder, context)
    verdict = "effects_found" if ordered else "nothing_found"
    warnings = (*excitation.warnings, *found.warnings, *_base_warnings(models[0].base), *_remainder_words(remainder))
    progress("done", 1.0)
    return Diagnosis(
        verdict=verdict,
        excitation=replace(excitation, warnings=warnings),
        nrmse_holdout=base_error / spread,
        noise_floor=floor / spread,
        effects=tuple(ordered),
        needs_channel=asked,
        unexplained_percent=100.0 * max(0.0, last_error - floor) / max(last_error, 1e-300),
        remainder=remainder,
        detection_limit_N=_detection_limits(found),
        record=record,
        raw=raw,
        context=context,
        models=models,
        findings=tuple(findings),
    )


def _undecidable(raw: Record, config: Config, context: Context, excitation: Excitation) -> Diagnosis:
    """Return the answer to data that cannot give one: the base fit alone."""
    base = fit_joint(raw, config, context)
    spread = float(np.std(raw.friction_N)) or 1.0
    error = float(np.sqrt(np.mean(np.square(base.residual_N)))) / spread
    return Diagnosis(
        verdict="undecidable",
        excitation=excitation,
        nrmse_holdout=error,
        noise_floor=noise_floor(raw, base.residual_N) / spread,
        effects=(),
        needs_channel=(),
        unexplained_percent=0.0,
        remainder=None,
        detection_limit_N={},
        record=raw,
        raw=raw,
        context=context,
        models=(base,),
        findings=(),
    )


def _named(
    record: Record, config: Config, context: Context, found: Search, seed: int
) -> tuple[list[Found], tuple[Joint, ...]]:
    """Return the modelled effects with parameters and held-out gains, and the models after each."""
    if not found.causes:
        return [], found.models
    final = found.models[-1]
    fitted = estimates(final, record, context, seed)
    errors = [held_out_errors(record, config, context, m, found) for m in found.models]
    spread = float(np.std(record.friction_N[record.used]))
    out = []
    for i, cause in enumerate(found.causes):
        named = {c.name for c in found.causes}
        also = list(cause.rivals)
        for name in (cause.name, *(rival for rival in cause.rivals if rival not in named)):
            also += [n for n in structural_rivals(name, record, context) if n != cause.name]
        rivals = tuple(name for name in dict.fromkeys(also) if name not in named)
        out.append(
            Found(
                name=cause.name,
                p_value=cause.p_value,
                parameters=fitted[i],
                gain=gain_between(errors[i], errors[i + 1], record, spread),
                rivals=rivals,
                experiment=next_experiment(cause.name, rivals),
                evidence=EFFECTS[cause.name].words.where,
                term=i,
            )
        )
    return out, found.models


def held_out_errors(record: Record, config: Config, context: Context, model: Joint, found: Search) -> Floats:
    """Return the error of the model refitted without each fold's samples, on those samples, (n,), N.

    Everything is refitted, the nonlinear parameters too.
    """
    error = np.zeros(record.used.size)
    fold = record.block % HELD_OUT_FOLDS
    for number in range(HELD_OUT_FOLDS):
        test = fold == number
        train = record.with_force(record.friction_N, record.used & ~test)
        fitted = fit_joint(
            train,
            config,
            context,
            model.terms,
            start=model.base,
            rounds=2 if model.terms else 1,
            capacity=found.capacity,
        )
        error[test] = fitted.residual_N[test]
    return error


def _held_out_rms(record: Record, config: Config, context: Context, model: Joint, found: Search) -> float:
    error = held_out_errors(record, config, context, model, found)
    return float(np.sqrt(np.mean(np.square(error[record.used]))))


def gain_between(before: Floats, after: Floats, record: Record, spread: float) -> Gain:
    """Return the gain with its 95 % interval over blocks."""
    one = _block_sums(np.square(before), record.block, record.used)
    other = _block_sums(np.square(after), record.block, record.used)
    count = float(record.used.sum())
    nrmse_before = float(np.sqrt(one.sum() / count)) / spread
    nrmse_after = float(np.sqrt(other.sum() / count)) / spread
    ratio = nrmse_after / max(nrmse_before, 1e-300)
    # d(sqrt(sum other / sum one)), block by block
    influence = ratio / 2.0 * (other / max(other.sum(), 1e-300) - one / max(one.sum(), 1e-300))
    error = float(np.sqrt(np.square(influence - influence.mean()).sum() * one.size / max(one.size - 1, 1)))
    reach = 100.0 * float(student.ppf(0.975, max(one.size - 1, 1))) * error
    reduction = 100.0 * (1.0 - ratio)
    return Gain(nrmse_before, nrmse_after, reduction, reduction - reach, reduction + reach)


def _block_sums(values: Floats, block: Ints, used: Bools) -> Floats:
    return np.asarray(np.bincount(block, weights=values * used), np.float64)


def _from_finding(finding: Fault, error_N: float, spread: float) -> Found:
    """Return a fault of the data as an effect; nothing is predicted better, so its gain is what it no longer costs."""
    after = error_N / spread
    before = float(np.sqrt(error_N**2 + finding.power_N2)) / spread if finding.power_N2 else after
    if EFFECTS[finding.name].scatters and finding.used is None:  # still in the data
        before = after
    reduction = 100.0 * (1.0 - after / max(before, 1e-300))
    return Found(
        name=finding.name,
        p_value=finding.p_value,
        parameters={k: Estimate(v, unit, low, high) for k, (v, unit, low, high) in finding.parameters.items()},
        gain=Gain(before, after, reduction, reduction, reduction),
        rivals=(),
        experiment=None,
        evidence=finding.evidence,
        term=None,
    )


def _ordered(
    effects: Sequence[Found],
    faults: Sequence[Found],
    findings: Sequence[Fault],
    record: Record,
) -> list[Found]:
    """Return all effects, strongest first: by the power of the error that each makes."""
    spread = float(np.std(record.friction_N[record.used]))
    power = {f.name: f.power_N2 for f in findings}

    def strength(found: Found) -> float:
        if found.term is None:
            # Faults that mask or distort whole samples come first whatever their power.
            return power.get(found.name, 0.0) or 1e300
        return float((found.gain.nrmse_before**2 - found.gain.nrmse_after**2) * spread**2)

    return sorted([*effects, *faults], key=lambda e: -strength(e))


def _asked(
    found: Search, effects: Sequence[Found], remainder: Remainder | None, context: Context
) -> tuple[tuple[str, str], ...]:
    """Return the channels that would let a suspected effect be named."""
    out = [(name, EFFECTS[name].channel) for name in found.asked]
    named = {e.name for e in effects}
    for name, cls in EFFECTS.items():
        suspected = remainder is not None or bool(named & set(cls.words.confused_with))
        if cls.recorded and cls.channel not in context.channels and suspected:
            out.append((name, cls.channel))
    return tuple(dict.fromkeys(out))


def _base_warnings(base: BaseFit) -> list[str]:
    if base.condition > 3.0:
        return [f"the fitted FIR differentiates (sum|h|/|sum h| = {base.condition:.1f}): its taps are not physical"]
    return []


def _remainder_words(remainder: Remainder | None) -> list[str]:
    return [] if remainder is None else [remainder.words]


def _detection_limits(found: Search) -> dict[str, float]:
    """Return the rms of the smallest change of each effect that the gate would have let through, N."""
    evidence = found.last_evidence
    out = {}
    for item in found.screened:
        moments = item.hypothesis.moments
        inner, _ = evidence.projected(moments)
        shown = float(np.trace(inner)) / max(float(np.trace(moments.xx.sum(0))), 1e-300)
        need = max(found.thresholds[item.hypothesis.effect.many], 1e-300)
        need = max(need, LEAST_SHARE * float(evidence.ee.sum()))
        out[item.name] = float(np.sqrt(need / evidence.samples / max(shown, 1e-9)))
    return out
