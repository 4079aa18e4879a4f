"""Linear screening of the library, and the gate that a gain must pass."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.evidence import Evidence, Fit, Rule, null_maximum
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.library import Family, Hypothesis, Library, columns_of
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.rounding import rounding_errors
from friction_estimator.diagnosis.tangent import normal_equations, pieces
from friction_estimator.effects.base import Effect

FLIPS = 400
"""Sign flips of the bootstrap."""

LEVEL = 0.01
MARGIN = 1.5
"""Family-wise level, and times the bootstrap's quantile that the best held-out gain must exceed."""

ROUNDING_MARGIN = 3.0
"""Times the largest of these that a gain must exceed: what rounding makes hangs on the noise and on the curve's own
error, too. In 120 records of a lattice alone it was up to 2.7 of them."""

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
    rounding : for each effect the largest gain that rounding to the lattice of the force makes, N^2.
    least : gain that any cause must bring, N^2.
    """

    evidence: Evidence
    library: Library
    screened: tuple[Screened, ...]
    nulls: tuple[Floats, Floats]
    rounding: Mapping[str, float]
    least: float

    @property
    def thresholds(self) -> tuple[float, float]:
        """Gain that an ordinary and a wide hypothesis must exceed, N^2; each takes half of the level."""
        one, other = (float(np.quantile(null, 1.0 - LEVEL / 2.0)) * MARGIN for null in self.nulls)
        return one, other

    @property
    def gates(self) -> dict[str, float]:
        """Gain of each effect that neither chance nor rounding makes, N^2."""
        chance = self.thresholds
        return {
            s.name: max(chance[s.hypothesis.effect.many], ROUNDING_MARGIN * self.rounding[s.name])
            for s in self.screened
        }

    @property
    def needed(self) -> dict[str, float]:
        """Gain that each effect must exceed, N^2."""
        return {name: max(gain, self.least) for name, gain in self.gates.items()}

    def p_value(self, effect: type[Effect], gain: float) -> float:
        """Return the family-wise probability of such a gain by chance."""
        return min(1.0, 2.0 * float(1 + np.sum(self.nulls[effect.many] >= gain)) / (FLIPS + 1))


def screening(
    record: Record, model: Joint, evidence: Evidence, library: Library, least: float, lattice_N: float, seed: int
) -> View:
    """Screen the library against what a model leaves, and find the gate.

    `lattice_N` is the distance of the values that the force can take, N, 0 where it can take any.
    """
    screened = screen(evidence, library)
    nulls, rounding = gate(record, model, library, screened, lattice_N, seed)
    library.forget()
    return View(evidence, library, tuple(screened), nulls, rounding, least)


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
    """Return the hypothesis that gains most on the chosen blocks (default all), of those that do anything at all.

    A gap that is closed before the first sample does nothing, which gains more than any gap that is not there.
    """
    gains = []
    for family in families:
        gain = evidence.gains(family.stack, family.rule, rows)
        nothing = np.einsum("bhcc->h", family.stack.xx) == 0.0
        gains.append(np.where(nothing, -np.inf, gain))
    first = int(np.argmax([g.max() for g in gains]))
    return families[first][int(np.argmax(gains[first]))]


def gate(
    record: Record, joint: Joint, library: Library, best: Sequence[Screened], lattice_N: float, seed: int
) -> tuple[tuple[Floats, Floats], dict[str, float]]:
    """Return the bootstrap's largest gains of ordinary and wide hypotheses, (flips,) each, and rounding's, N^2.

    The blocks' signs are flipped after the best candidates' share was taken out of the residual, or the threshold would
    grow with the effect. Rounding of a force that repeats is the same in every block: flips say nothing of it.
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
    errors = rounding_errors(record.friction_N - residual, lattice_N)
    rounded = [calm.with_residual(error) for error in errors]
    found = library.products_with(calm, np.column_stack([m.residual for m in (calm, *rounded)]))
    groups: dict[bool, tuple[list[tuple[Floats, Floats]], list[Rule]]] = {False: ([], []), True: ([], [])}
    rounding = dict.fromkeys((s.name for s in best), 0.0)
    for family, xe in zip(library.families, found, strict=True):
        projections, rules = groups[family.effect.many]
        projections += calm.projections(replace(family.stack, xe=xe[0]))
        rules += [family.rule] * len(family.points)
        for machine, pull in zip(rounded, xe[1:], strict=True):
            gain = float(machine.gains(replace(family.stack, xe=pull), family.rule).max())
            rounding[family.name] = max(rounding[family.name], gain)
    flips = calm.flips(FLIPS)
    return (null_maximum(flips, *groups[False]), null_maximum(flips, *groups[True])), rounding
