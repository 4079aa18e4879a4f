"""Whether the base model is too coarse for a record: what a finer curve, a longer memory or unlike memories gain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.base_problem import OWN_LAGS, Capacity, tap_covariance
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.lack_of_fit import Wider
from friction_estimator.diagnosis.lagged import filtered, lagged
from friction_estimator.diagnosis.odd_curve import OddCurve

FINER = 24
LONGER = 16
"""Splines of the finer curve, and order of the longer memory."""

MODES = 3
"""Directions of the prior of the lags that unlike memories may take: they have 96 % of its variance."""


def wider(model: Joint, evidence: Evidence) -> tuple[Capacity | None, float]:
    """Return the larger base model that gains most on held-out blocks, and its gain, N^2; None where it is largest."""
    problem = model.base.problem
    capacity, products = problem.capacity, problem.products
    gains: dict[Capacity, float] = {}
    if capacity.splines < FINER:
        fine = OddCurve(model.base.curve.top, FINER)(problem.record.features.velocity_m_s)
        # Behind the same memory as the curve that there is: without it, both would be a memory of another kind.
        behind = np.zeros_like(fine)
        filtered(fine, products.start, 0, np.concatenate([[1.0], model.base.taps]), behind)
        gains[Capacity(FINER, capacity.order)] = _gain(evidence, behind)
    if capacity.order < LONGER:
        force = model.base.static_N
        lags = range(capacity.order + 1, LONGER + 1)
        more = np.column_stack([lagged(force, i, products.start) - force for i in lags])
        gains[Capacity(capacity.splines, LONGER)] = _gain(evidence, more)
    best = max(gains, key=lambda k: gains[k], default=None)
    return best, gains[best] if best is not None else 0.0


def in_words(before: Capacity, after: Capacity) -> str:
    """Return the warning that goes with a larger base model than the one before."""
    what = "a finer static curve" if after.splines > before.splines else "a longer memory"
    return f"the base model needed {what} than usual; that is lack of fit, no cause"


@dataclass(frozen=True)
class UnlikeMemories(Wider):
    """A model's tangent, and beside it the lags of each spline: made piece by piece, as that is.

    The base has two memories, the theory's and that of all the rest. Where the theory is wrong the rest holds both what
    it says wrongly, with its memory, and what it does not say, with another one (decision 0167). Spline j adds
    sum_i w t_ij (B_j[k-i] - B_j[k]), w the rms of the splines' weights, since parts of unlike memory may cancel in any
    one of them, t_ij with the prior of the theory's own lags.

    Attributes
    ----------
    model : fitted, with a memory. modes : (order, modes), lags of one spline in units of their prior's deviations, N.
    """

    model: Joint
    modes: Floats

    @classmethod
    def of(cls, model: Joint) -> "UnlikeMemories":
        """Return those of a model."""
        base = model.base
        size = float(np.sqrt(np.mean(np.square(base.weights))))
        values, vectors = np.linalg.eigh(tap_covariance(base.taps.size))
        return cls(model, OWN_LAGS * size * (vectors * np.sqrt(values))[:, ::-1][:, :MODES])

    @property
    def width(self) -> int:
        """Number of columns beside the tangent."""
        return int(self.modes.shape[1] * self.model.base.weights.size)

    def beside(self, part: slice) -> Sequence[Floats]:
        """Return the columns beside the tangent for some samples."""
        base = self.model.base
        products = base.problem.products
        lagged_by = products.rows(part).reshape(-1, products.order + 1, products.width)
        splines = lagged_by[:, :, products.width - base.weights.size :]
        lags = np.tensordot(splines[:, 1:] - splines[:, :1], self.modes, (1, 0))
        return [lags.reshape(len(lags), -1)]


def _gain(evidence: Evidence, columns: Floats) -> float:
    moments = evidence.moments(columns)
    return float(evidence.cross_validated(moments, Rule((0,) * columns.shape[1])).sum())
