"""Linear screening of the library, and the gate that a gain must pass."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.evidence import Evidence, Fit, Rule, null_maximum
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.library import Family, Hypothesis, Library, columns_of
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.tangent import normal_equations, pieces
from friction_estimator.effects.base import Effect

FLIPS = 400
"""Sign flips of the bootstrap."""

LEVEL = 0.01
MARGIN = 1.5
"""Family-wise level, and times the bootstrap's quantile that the best held-out gain must exceed."""

RIDGE = 1e-6
"""Share of their energy by which the gate's columns of unit rms are damped: they may be collinear."""

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


@dataclass(frozen=True)
class View:
    """What screening the library says about what a model leaves.

    Attributes
    ----------
    evidence, library : what was compared. screened : the best hypothesis of each effect, best first.
    nulls : the bootstrap's largest gains of ordinary and of wide hypotheses, (flips,) each, N^2.
    least : gain that any cause must bring, N^2.
    """

    evidence: Evidence
    library: Library
    screened: tuple[Screened, ...]
    nulls: tuple[Floats, Floats]
    least: float

    @property
    def thresholds(self) -> tuple[float, float]:
        """Gain that an ordinary and a wide hypothesis must exceed, N^2; each takes half of the level."""
        one, other = (float(np.quantile(null, 1.0 - LEVEL / 2.0)) * MARGIN for null in self.nulls)
        return one, other

    @property
    def needed(self) -> dict[str, float]:
        """Gain that each effect must exceed, N^2."""
        thresholds = self.thresholds
        return {s.name: max(thresholds[s.hypothesis.effect.many], self.least) for s in self.screened}

    def p_value(self, effect: type[Effect], gain: float) -> float:
        """Return the family-wise probability of such a gain by chance."""
        return min(1.0, 2.0 * float(1 + np.sum(self.nulls[effect.many] >= gain)) / (FLIPS + 1))


def screening(record: Record, model: Joint, evidence: Evidence, library: Library, least: float, seed: int) -> View:
    """Screen the library against what a model leaves, and find the gate."""
    screened = screen(evidence, library)
    return View(evidence, library, tuple(screened), gate(record, model, library, screened, seed), least)


def screen(evidence: Evidence, library: Library) -> list[Screened]:
    """Return the best hypothesis of each effect by nested cross-validation, best first.

    In each fold the grid point is chosen on the training blocks alone, and scored on the others.
    """
    by_name: dict[str, list[Family]] = {}
    for family in library.families:
        by_name.setdefault(family.name, []).append(family)
    out = []
    for name, families in by_name.items():
        gain = np.zeros(evidence.blocks)
        for fold in range(int(evidence.folds.max()) + 1):
            test = evidence.folds == fold
            item = _best(evidence, families, ~test)
            fit = evidence.fit(item.moments, item.rule, ~test)
            gain[test] = evidence.held_out(fit, item.moments, test, ~test)
        best = _best(evidence, families, None)
        # What is there at every speed and time shows in nearly every block; leakage of the drive does not.
        everywhere = not best.effect.many or float(np.mean(gain > 0.0)) >= EVERYWHERE
        fit = evidence.fit(best.moments, best.rule)
        out.append(Screened(name, best.params, float(gain.sum()) if everywhere else 0.0, best, fit))
    return sorted(out, key=lambda s: -s.gain)


def _best(evidence: Evidence, families: Sequence[Family], rows: Bools | None) -> Hypothesis:
    """Return the hypothesis that gains most on the chosen blocks (default all)."""
    gains = [evidence.gains(family.stack, family.rule, rows) for family in families]
    first = int(np.argmax([g.max() for g in gains]))
    return families[first][int(np.argmax(gains[first]))]


def gate(record: Record, joint: Joint, library: Library, best: Sequence[Screened], seed: int) -> tuple[Floats, Floats]:
    """Return the bootstrap's largest gains, (flips,) for ordinary and for wide hypotheses, N^2.

    The blocks' signs are flipped after the best candidates' share was taken out of the residual, or the threshold would
    grow with the effect.
    """
    shares = [
        columns_of(s.hypothesis.effect, s.params, library.features, library.reference)
        for s in best[:3]
        if s.fit.gain > 0.0
    ]
    residual = joint.residual_N
    if shares:
        norm, gram, right = normal_equations(joint.tangent, shares, residual, record.used)
        weights = np.linalg.solve(gram + RIDGE * int(record.used.sum()) * np.eye(norm.size), right) / norm
        residual = residual.copy()
        place = joint.tangent.shape[1]
        for part in pieces(residual.size):
            rows = np.concatenate([c[part] for c in shares], axis=1)
            residual[part] -= joint.tangent[part] @ weights[:place] + rows @ weights[place:]
    calm = Evidence(joint.tangent, joint.penalty, residual, record.used, record.block, seed)
    groups: dict[bool, tuple[list[tuple[Floats, Floats]], list[Rule]]] = {False: ([], []), True: ([], [])}
    for family, xe in zip(library.families, library.products_with(calm), strict=True):
        projections, rules = groups[family.effect.many]
        projections += calm.projections(replace(family.stack, xe=xe))
        rules += [family.rule] * len(family.points)
    return (
        null_maximum(calm, *groups[False], FLIPS),
        null_maximum(calm, *groups[True], FLIPS),
    )
