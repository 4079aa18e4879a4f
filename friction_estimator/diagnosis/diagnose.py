"""The diagnosis: from recordings to a verdict, the named causes, the extended model and the gain."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Samples, joined
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import ALARM, BaseProblem
from friction_estimator.diagnosis.causes import Cause, Search
from friction_estimator.diagnosis.excitation import Excitation, assess
from friction_estimator.diagnosis.floor import coarse_step, noise_floor
from friction_estimator.diagnosis.gaining import gaining
from friction_estimator.diagnosis.held_out import gain_between, rms
from friction_estimator.diagnosis.intervals import estimates
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.remainder import Remainder, unexplained
from friction_estimator.diagnosis.repair import concealed, confirmed, left_by, repaired, scattered, with_repair
from friction_estimator.diagnosis.result import (
    EFFECTS_FOUND,
    NOTHING_FOUND,
    UNDECIDABLE,
    UNEXPLAINED,
    Diagnosis,
    Found,
    Trace,
)
from friction_estimator.diagnosis.search import Searcher
from friction_estimator.diagnosis.theory import with_theory
from friction_estimator.diagnosis.trials import Trials
from friction_estimator.diagnosis.words import next_experiment, telling_experiment
from friction_estimator.effects.base import EFFECTS, Effect
from friction_estimator.effects.detection import COMPLETELY, Fault
from friction_estimator.effects.features import Context

ABOVE_FLOOR = 1.08
"""Held-out error over the noise floor from which something is left to explain: the floor itself is known to a few
percent where the drive repeats."""

MOST_TRACES = 3

Progress = Callable[[str, float], None]


def _silent(_stage: str, _part: float) -> None:
    """Report nothing."""


def diagnose(
    recordings: Sequence[Samples],
    config: Config,
    seed: int = 0,
    progress: Progress = _silent,
    faults: Sequence[Fault] = (),
    catalogue: Mapping[str, type[Effect]] = EFFECTS,
) -> Diagnosis:
    """Diagnose recordings.

    Parameters
    ----------
    recordings : one or more, in the order in which they were made. config : theory, FIR order, extension terms.
    seed : of folds and bootstrap; the same seed gives the same result. progress : told of stage and share done.
    faults : of the stamps, found while reading (`streams`). catalogue : effects that are considered, by name.

    Raises
    ------
    UnanswerableError : too few usable samples, or no motion.
    """
    progress("reading", 0.0)
    config = with_theory(config, joined(recordings))
    raw = build_record(recordings, config)
    context = raw.context(config, float(np.abs(raw.friction_N).max()))
    excitation = assess(raw, context)
    if excitation.undecidable:
        return _undecidable(raw, config, context, excitation)
    record, context, found_faults = repaired(raw, config, context, catalogue)
    found_faults = [*faults, *found_faults]
    searcher = Searcher(record, config, context, catalogue, seed, found_faults)
    found = searcher(progress)
    if late := concealed(found_faults, record, context, found.models[-1], catalogue):
        for fault in late:
            record = with_repair(record, config, fault)
        instead = {fault.name for fault in late}
        found_faults = [*(fault for fault in found_faults if fault.name not in instead), *late]
        searcher = Searcher(record, config, context, catalogue, seed, found_faults)
        found = searcher(progress)
    progress("measuring gains on held-out data", 0.75)
    spread = float(np.std(record.friction_N[record.used]))
    found, errors, refuted = gaining(found, record, context, spread)
    if refuted:
        # What had been held against those may gain in their place.
        again = searcher.without(refuted, progress)
        other, others, _ = gaining(again, record, context, spread)
        if rms(others[-1], record) < rms(errors[-1], record):
            found, errors = other, others
    final = found.models[-1]
    found_faults = confirmed(found_faults, record, context, final, catalogue)
    trials = Trials(final, record, config, context, seed)
    base_error, last_error = rms(errors[0], record), rms(errors[-1], record)
    lattice_N = max((f.lattice_N for f in found_faults), default=0.0)
    floor = min(noise_floor(record, final.residual_N, lattice_N), base_error)
    left_N2 = float(record.used.sum()) * max(0.0, last_error**2 - floor**2)
    causes = [term.effect for term in final.terms]
    coarse_N = coarse_step(record, final.residual_N, lattice_N)
    effects = _named(record, context, found, errors, spread, left_N2, coarse_N, seed, trials, catalogue)
    progress("noise floor and remainder", 0.85)
    view = left_by(record, context, final, found_faults)
    found_faults += scattered(view, catalogue)
    concealed_by_one = any(f.conceals for f in found_faults)
    remainder = None if concealed_by_one else unexplained(record, final, found, found_faults, view, seed)
    notes = [f"{f.name}: {f.evidence}" for f in found_faults if f.repaired == COMPLETELY]
    found_faults = [f for f in found_faults if f.repaired != COMPLETELY]
    left = max(0.0, last_error - floor)
    verdict = NOTHING_FOUND
    if effects or found_faults:
        verdict = EFFECTS_FOUND
    elif remainder is not None or last_error > ABOVE_FLOOR * floor:
        verdict = UNEXPLAINED
    warnings = (*excitation.warnings, *found.warnings, *_unfinished(found.models[0]), *_remainder_words(remainder))
    progress("done", 1.0)
    return Diagnosis(
        config=config,
        verdict=verdict,
        excitation=replace(excitation, warnings=warnings, notes=(*excitation.notes, *notes)),
        nrmse_holdout=base_error / spread,
        noise_floor=floor / spread,
        faults=tuple(found_faults),
        effects=tuple(effects),
        total_gain=gain_between(errors[0], errors[-1], record, spread, causes) if effects else None,
        traces=_traces(found),
        needs_channel=_asked(found, effects, remainder, context, catalogue),
        unexplained_percent=100.0 * left / max(last_error, 1e-300),
        remainder=remainder,
        detection_limit_N=_detection_limits(found) if verdict == NOTHING_FOUND else {},
        record=record,
        raw=raw,
        context=context,
        models=found.models,
    )


def _undecidable(raw: Record, config: Config, context: Context, excitation: Excitation) -> Diagnosis:
    """Return the answer to data that cannot give one: the base fit alone."""
    base = JointFit(BaseProblem(raw, config), context)()
    spread = float(np.std(raw.friction_N)) or 1.0
    error = rms(base.residual_N, raw)
    return Diagnosis(
        config=config,
        verdict=UNDECIDABLE,
        excitation=excitation,
        nrmse_holdout=error / spread,
        noise_floor=min(noise_floor(raw, base.residual_N), error) / spread,
        faults=(),
        effects=(),
        total_gain=None,
        traces=(),
        needs_channel=(),
        unexplained_percent=0.0,
        remainder=None,
        detection_limit_N={},
        record=raw,
        raw=raw,
        context=context,
        models=(base,),
    )


def _named(
    record: Record,
    context: Context,
    found: Search,
    errors: Sequence[np.ndarray],
    spread: float,
    left_N2: float,
    coarse_N: float,
    seed: int,
    trials: Trials,
    catalogue: Mapping[str, type[Effect]],
) -> list[Found]:
    """Return the causes with parameters and held-out gains, each from the model before it.

    `left_N2` is the error power that none of them explains, `coarse_N` the step to which rounding repeats.
    """
    if not found.causes:
        return []
    apart, untold = [c.apart for c in found.causes], [c.untold for c in found.causes]
    fitted = estimates(found.models[-1], record, context, seed, left_N2, apart, coarse_N, untold)
    named = {c.name for c in found.causes}

    def one(i: int, cause: Cause) -> Found:
        term = found.models[-1].terms[i]
        rivals = tuple(name for name in cause.rivals if name not in named)
        gain = gain_between(errors[i], errors[i + 1], record, spread, [term.effect])
        return Found(
            name=cause.name,
            p_value=cause.p_value,
            parameters=fitted[i],
            gain=gain if cause.p_value is not None else None,
            rivals=rivals,
            experiment=next_experiment(cause.name, rivals, lambda rival: trials.separation(term, catalogue[rival]))
            or telling_experiment(cause, fitted[i]),
            evidence=term.effect.words.where if cause.p_value is not None else MEMORY_WORDS,
            term=i,
        )

    return [one(i, cause) for i, cause in enumerate(found.causes)]


MEMORY_WORDS = "one time stands in for the many taps with which the base model would have to follow it"


def _traces(found: Search) -> tuple[Trace, ...]:
    """Return what passes the bootstrap but is too small for a finding."""
    total = max(float(found.last_evidence.ee.sum()), 1e-300)
    small = [s for s in found.screened if found.gates[s.name] < s.gain < found.least_N2]
    return tuple(Trace(s.name, 100.0 * s.gain / total) for s in small[:MOST_TRACES])


def _asked(
    found: Search,
    effects: Sequence[Found],
    remainder: Remainder | None,
    context: Context,
    catalogue: Mapping[str, type[Effect]],
) -> tuple[tuple[str, str], ...]:
    """Return the channels that would let a suspected effect be named."""
    out = [(name, catalogue[name].channel) for name in found.asked]
    named = {e.name for e in effects}
    for name, cls in catalogue.items():
        suspected = remainder is not None or bool(named & set(cls.words.confused_with))
        if cls.recorded and cls.channel not in context.channels and suspected:
            out.append((name, cls.channel))
    return tuple(dict.fromkeys(out))


def _unfinished(model: Joint) -> list[str]:
    promise = model.coefficients.promise
    if promise <= ALARM:
        return []
    return [f"the base fit is unfinished: its tangent promises {100 * promise:.0f} % less error than the fit reached"]


def _remainder_words(remainder: Remainder | None) -> list[str]:
    return [] if remainder is None else [remainder.words]


def _detection_limits(found: Search) -> dict[str, float]:
    """Return the rms of the smallest change of each effect that the gate would have let through, N."""
    evidence = found.last_evidence
    out = {}
    for item in found.screened:
        moments = item.hypothesis.moments
        if not moments.xx.any():
            continue  # the record shows nothing of it, whatever its size
        inner, _ = evidence.projected(moments)
        shown = float(np.trace(inner)) / max(float(np.trace(moments.xx.sum(0))), 1e-300)
        need = max(found.gates[item.name], 1e-300)
        need = max(need, found.least_N2)
        out[item.name] = float(np.sqrt(need / evidence.samples / max(shown, 1e-9)))
    return out
