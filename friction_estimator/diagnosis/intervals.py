"""Fitted physical quantities with 95 % intervals: chance, rounding, other forms, and what none explains."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.library import columns_of
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.rounding import rounding_errors
from friction_estimator.diagnosis.seek import plateau
from friction_estimator.effects.features import Context

MEMORY_SHARE = 0.1
"""Samples by which a time of the whole force is uncertain beside its sampling error: the rig's own short memory, of
which the prior knows that much, delays the force as well."""

LEAST_TOLD = 1e-9
"""Of the variance that white noise would give: from which on that of the blocks is lifted to it."""

BEYOND = 0.25
"""Share of a plateau's width beyond its edges at which what lies beside it is looked at."""

MISFIT = 0.35
"""Correlation up to which what no cause explains may lie along a quantity's own part of its columns
(decision 0178)."""


@dataclass(frozen=True)
class Estimate:
    """A fitted physical quantity with its 95 % interval."""

    value: float
    unit: str
    low: float
    high: float

    @property
    def apart_from_zero(self) -> bool:
        """Whether 0 lies outside the interval."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True)
class Curvature:
    """What is known of the tangent's coefficients of a joint fit.

    Attributes
    ----------
    evidence : products of the tangent and what is left. inverse : (q, q), of the Hessian, in the tangent's own units.
    """

    evidence: Evidence
    inverse: Floats

    @classmethod
    def of(cls, joint: Joint, record: Record, seed: int) -> "Curvature":
        """A parameter held at an end of its bracket is as uncertain as a free one."""
        evidence = joint.evidence(record, seed)
        hessian = evidence.zz.sum(0) + np.diag(np.where(joint.at_end, 0.0, joint.penalty))
        told = np.diag(hessian) > 0.0  # of the others nothing is known: any inverse will do, nobody uses it
        hessian = hessian + np.diag(np.where(told, 1e-10 * np.diag(hessian), 1.0))
        return cls(evidence, np.linalg.inv(hessian))

    @property
    def variance(self) -> float:
        """Of what is left, N^2."""
        freedom = max(self.evidence.samples - self.inverse.shape[0], 1)
        return float(self.evidence.ee.sum() / freedom)

    def covariance(self) -> Floats:
        """Return that of the coefficients by chance, (q, q).

        Sandwich over blocks: H^-1 (sum_b s_b s_b') H^-1 with s_b = X_b' e_b, B / (B - 1), so that neither coloured
        nor uneven noise makes the intervals too narrow.
        """
        blocks = self.evidence.blocks
        scores = self.evidence.ze - self.evidence.ze.mean(axis=0)
        half = self.inverse @ scores.T  # multiplied with itself no variance is below nothing, however alike two columns
        sandwich, plain = half @ half.T * (blocks / (blocks - 1)), self.inverse * self.variance
        # Few blocks make the sandwich noisy: it never falls below what white noise alone would give.
        least = np.maximum(np.diag(plain), 1e-300)
        lift = np.sqrt(np.fmax(least / np.maximum(np.diag(sandwich), LEAST_TOLD * least), np.ones(least.size)))
        return np.asarray(sandwich * np.outer(lift, lift))

    def rounding(self, force_N: Floats, lattice_N: float) -> Floats:
        """Return that which rounding of a force (n,) to steps of a lattice makes, (q, q): its mean over other lattices.

        The error of rounding repeats with the drive, so that it is the same in every block, and no noise.
        """
        pulls = sum(
            piece.z.T @ piece.masked(np.column_stack(list(rounding_errors(force_N[piece.part], lattice_N))))
            for piece in self.evidence.pieces()
        )
        moved = self.inverse @ pulls
        return np.asarray(moved @ moved.T / moved.shape[1])

    def power(self, column: Floats) -> float:
        """Return the power of a column (n,) that no coefficient can make up for, summed."""
        moments = self.evidence.moments(column[:, None])
        across = moments.zx.sum(0)[:, 0]
        return max(float(moments.xx.sum()) - float(across @ self.inverse @ across), 1e-300)


def estimates(
    joint: Joint,
    record: Record,
    context: Context,
    seed: int,
    left_N2: float | None = None,
    apart: Sequence[Mapping[str, float]] = (),
    lattice_N: float = 0.0,
    untold: Sequence[Mapping[str, tuple[float, float]]] = (),
) -> list[dict[str, Estimate]]:
    """Return the physical parameters of each term with intervals.

    A quantity that hangs on a coefficient of which the samples used tell nothing has no interval (NaN).

    Without `left_N2` they are those of chance alone: by the delta method with Student t over blocks. With it half of
    the interval is the root of the sum of squares of this, of what rounding to a lattice makes of the quantity, of what
    other forms of the cause differ by, and of what a misfit of that power makes of it at a correlation of `MISFIT`.

    Parameters
    ----------
    left_N2 : error power that no cause explains, summed. apart : for each term by how much other forms of its cause
        that fit as well differ, by quantity; the effect's own systematic share holds where that is less.
    lattice_N : step of the force where rounding to it repeats with the drive (`floor.coarse_step`), else 0.
    untold : for each term the least and the largest value of a quantity in forms of its cause that the drive does not
        tell from this one (`Candidates.untold`): to each side the interval reaches as far.
    """
    known = Curvature.of(joint, record, seed)
    quantile = float(stdtrit(max(record.blocks - 1, 1), 0.975))
    scales = np.outer(joint.scales, joint.scales)
    squares = quantile**2 * known.covariance() * scales
    if left_N2 is not None:
        squares += MISFIT**2 * left_N2 * known.inverse * scales
    if lattice_N:
        squares += quantile**2 * known.rounding(record.friction_N - joint.residual_N, lattice_N) * scales
    place = joint.base.tangent.shape[1]
    told = (np.diag(known.evidence.zz.sum(0)) > 0.0) | (~joint.at_end & (joint.penalty > 0.0))
    unknown = ~told & (joint.scales != 0.0)
    out = []
    for number, term in enumerate(joint.terms):
        free = 0 if term.effect.fixed_gain else term.weights.size
        names = [n for n in term.refined if term.params[n] != 0.0]
        theta = np.concatenate([term.weights[:free], [term.params[n] for n in names]])
        part = squares[place : place + theta.size, place : place + theta.size].copy()
        if left_N2 is not None:
            for i, name in enumerate(names, free):
                if name in term.effect.steps and (joint.scales[place + i] == 0.0 or unknown[place + i]):
                    part[i, i] = _jumping(joint, number, name, context, known, left_N2, quantile) ** 2
                    unknown[place + i] = False
        nothing = unknown[place : place + theta.size]
        place += theta.size

        def values(
            point: Floats, term: Term = term, free: int = free, names: list[str] = names
        ) -> dict[str, tuple[float, str]]:
            params = term.params | dict(zip(names, point[free:].tolist(), strict=True))
            weights = point[:free] if free else np.ones(1)
            return term.effect.told(params, weights, context, joint.reference)

        centre = values(theta)
        signed = {key.name for key in term.effect.keys if key.low < 0.0}
        unsigned = {*term.refined, *(key.name for key in term.effect.keys)} - signed
        found = {}
        for name, (value, unit) in centre.items():
            slope = np.zeros(theta.size)
            for i in range(theta.size):
                step = 1e-4 * abs(theta[i]) + 1e-12
                moved = theta.copy()
                moved[i] += step
                there, _ = values(moved).get(name, centre[name])  # a step further it may not be told
                slope[i] = (there - value) / step
            reach = float(np.sqrt(max(float(slope @ part @ slope), 0.0)))
            if np.any(slope[nothing] != 0.0):
                reach = float("nan")
            low, high = value - reach, value + reach
            if left_N2 is not None:
                form = term.effect.systematic.get(name, 0.0) * abs(value)
                form = max(form, apart[number].get(name, 0.0) if apart else 0.0)
                memory = MEMORY_SHARE * context.step_s if term.effect.delays else 0.0
                least, most = untold[number].get(name, (value, value)) if untold else (value, value)
                reach = np.hypot(reach, memory)
                low = value - np.hypot(reach, max(form, value - least))
                high = value + np.hypot(reach, max(form, most - value))
                if name in unsigned and value > 0.0:
                    low = max(low, 0.0)  # a length, a time or a height is not negative
            found[name] = Estimate(float(value), unit, float(low), float(high))
        out.append(found)
    return out


def _jumping(
    joint: Joint, number: int, name: str, context: Context, known: Curvature, left_N2: float, quantile: float
) -> float:
    """Return the reach of a parameter in which the columns jump, and that a small step does not move.

    On its plateau nothing tells one value from another; beyond, what the columns differ by from one neighbouring
    plateau to the other is their slope.
    """
    term = joint.terms[number]
    features = joint.features.with_force(joint.features.force_N - joint.parts_N[number])
    here = term.params[name]

    def columns(at: float) -> Floats:
        return columns_of(term.effect, {**term.params, name: at}, features, joint.reference)

    used = known.evidence.used
    standing = columns(here)[used]
    low, high = term.effect.bracket(name, here, context)
    first, last = plateau(lambda at: np.array_equal(columns(at)[used], standing), here, low, high)
    reach = BEYOND * (last - first)
    before, after = max(first - reach, low), min(last + reach, high)
    slope = (columns(after) - columns(before)) @ term.weights / (after - before)
    squares = (quantile**2 * known.variance + MISFIT**2 * left_N2) / known.power(slope)
    return max(last - here, here - first) + float(np.sqrt(squares))
