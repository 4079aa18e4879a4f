"""One configuration learned from one recording, and its error where it did not learn: a row of a sweep.

Runs in a worker process: nothing that draws or talks to ROS is imported here.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from friction_estimator.added_terms import added_terms, added_terms_as_met
from friction_estimator.core import metrics
from friction_estimator.core.errors import UnanswerableError, about
from friction_estimator.core.fit.baselines import StaticCurve
from friction_estimator.core.fit.frozen_score import CURVES, curves_learned
from friction_estimator.core.intake.strokes import reversal_speed, reversals
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.sweep.job import FEWEST_BLOCKS, MOST_BLOCKS, Job
from friction_estimator.sweep.recall import Admitted, keep_only, recalled
from friction_estimator.tasks.identity import File

LONGEST_MEMORY = int(PARAMETERS["fir.order"].high)
"""Samples left out after each restart of what is judged: those of the longest memory that can be set, so that every
configuration is judged on the same ones."""

LEAST_SAMPLES = 2 * FEWEST_BLOCKS


def row_of(job: Job) -> dict[str, Any]:
    """Return the row: plain values, the same on every machine of a kind.

    `samples` learned from, `motion`, and `judged`: a list with, for each recording that was judged, its `recording`
    (content), `samples`, `spread_N` (std of what was measured, the load that is taken off included, so that it is the
    same for all configurations), `error_N` (rms), `baselines_N` (rms of the textbook's curves fitted to what was
    learned from), and by block of about a drive cycle the first stamp `begin_ns`, `block_samples` and `block_error_N2`
    (sum of squares).

    Raises UnanswerableError and InputError where there is nothing to learn from or to judge by, or the model diverged.
    """
    given = Config.from_mapping(job.settings)
    keep_only([job.recording, *job.others])
    learned = recalled(job.recording, given, job.topics)
    config = given.updated({"input.motion": learned.motion})
    with about(job.recording.path):
        if not job.others:
            return _held_out(job, learned, config)
        return _elsewhere(job, learned, config)


def _held_out(job: Job, learned: Admitted, config: Config) -> dict[str, Any]:
    samples = learned.samples
    extension = added_terms_as_met(config, samples)
    result = replay(samples, config, extension=extension, freeze_after=job.learned_share)
    first = int(np.count_nonzero(result.learned)) if config.model.adapt else round(job.learned_share * len(samples))
    part = slice(first, None)
    rivals = _curves(learned, result.samples[:first])
    scored = metrics.settled(result.samples.restart, LONGEST_MEMORY)[part]
    judged = result.samples[part]
    known = result.estimator.model.load.known_N(judged)
    row = _judged(job.recording, judged, judged.friction_N + known, result.predicted_N[part], scored, rivals)
    return {"motion": learned.motion, "samples": first, "judged": [row]}


def _elsewhere(job: Job, learned: Admitted, config: Config) -> dict[str, Any]:
    samples = learned.samples
    result = replay(samples, config, extension=added_terms_as_met(config, samples))
    rivals = _curves(learned, result.samples)
    rows = []
    for other in job.others:
        admitted = recalled(other, Config.from_mapping(job.settings), job.topics)
        with about(other.path):
            if admitted.motion != learned.motion:
                raise UnanswerableError(f"{other.path} is {admitted.motion}, {job.recording.path} {learned.motion}")
            judged = admitted.samples
            predicted = result.predict(judged, added_terms(result.config))
            scored = metrics.settled(judged.restart, LONGEST_MEMORY)
            known = result.estimator.model.load.known_N(judged)
            rows.append(_judged(other, judged, judged.friction_N + known, predicted, scored, rivals))
    return {"motion": learned.motion, "samples": len(result.samples), "judged": rows}


def _judged(
    file: File,
    samples: Samples,
    measured_N: Floats,
    predicted_N: Floats,
    scored: Bools,
    rivals: Mapping[str, StaticCurve],
) -> dict[str, Any]:
    """Return what a recording, or what is held out of it, says of a model; arrays are (n,), N."""
    count = int(np.count_nonzero(scored))
    if count < LEAST_SAMPLES:
        raise UnanswerableError(
            f"{count} samples are left to judge by, behind the {LONGEST_MEMORY} after each gap that are left out: the "
            "recording is too short, or its gaps are too many"
        )
    spread = metrics.spread(measured_N[scored])
    if not spread > 0.0:
        raise UnanswerableError("friction is constant where it is judged: there is nothing to judge by")
    error = samples.friction_N - predicted_N
    if not np.isfinite(error[scored]).all():
        raise UnanswerableError("the model diverged: predictions are not finite")
    edges = _edges(samples)
    squares = np.where(scored, np.square(error), 0.0)
    velocity, friction = samples.velocity_m_s[scored], samples.friction_N[scored]
    return {
        "recording": file.content,
        "samples": count,
        "spread_N": spread,
        "error_N": float(np.sqrt(squares.sum() / count)),
        "baselines_N": {
            name: float(np.sqrt(np.mean(np.square(friction - rivals[name].evaluate(velocity)))))
            for name in CURVES
            if name in rivals
        },
        "begin_ns": samples.stamp_ns[edges[:-1]].tolist(),
        "block_samples": np.add.reduceat(scored.astype(np.int64), edges[:-1]).tolist(),
        "block_error_N2": np.add.reduceat(squares, edges[:-1]).tolist(),
    }


def _edges(samples: Samples) -> Any:
    """Return the first sample of each block and the end, (blocks + 1,)."""
    turns = reversals(samples.velocity_m_s, samples.restart, reversal_speed(samples))
    count = min(max(turns.size // 2, FEWEST_BLOCKS), MOST_BLOCKS)
    return np.linspace(0, len(samples), count + 1).astype(np.int64)


def _curves(learned: Admitted, samples: Samples) -> Mapping[str, StaticCurve]:
    """Return the textbook's curves fitted to the samples that a model learned from, once for all configurations."""
    key = (int(samples.stamp_ns[0]), len(samples)) if len(samples) else (0, 0)
    if key not in learned.curves:
        learned.curves[key] = curves_learned(samples.velocity_m_s, samples.friction_N)
    return learned.curves[key]
