"""Linear screening of the library, and the gate that a gain must pass."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence, Fit, Rule, null_maximum
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.library import Hypothesis
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.record import Record

FLIPS = 400
"""Sign flips of the bootstrap."""

EVERYWHERE = 0.7
"""Share of blocks in which a wave in time or position must bring a gain."""


@dataclass(frozen=True)
class Screened:
    """The best hypothesis of one effect after the linear screening."""

    name: str
    params: dict[str, float]
    gain: float
    hypothesis: Hypothesis
    fit: Fit


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
        everywhere = not items[0].effect.many or float(np.mean(gain > 0.0)) >= EVERYWHERE
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
