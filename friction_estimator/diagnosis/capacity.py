"""Whether the base model is too coarse for a record: a finer curve or a longer memory gains more than any cause."""

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.base_problem import SPLINES, Capacity, OddCurve
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.lagged import lagged

FINER = 24
LONGER = 16
"""Splines of the finer curve, and order of the longer memory."""


def wider(model: Joint, evidence: Evidence) -> tuple[Capacity | None, float]:
    """Return the larger base model that gains most on held-out blocks, and its gain, N^2; None where it is largest."""
    problem = model.base.problem
    capacity, products = problem.capacity, problem.products
    gains: dict[Capacity, float] = {}
    if capacity.splines < FINER:
        fine = OddCurve(model.base.curve.top, FINER)(problem.record.features.velocity_m_s)
        gains[Capacity(FINER, capacity.order)] = _gain(evidence, fine)
    if capacity.order < LONGER:
        force = model.base.static_N
        lags = range(capacity.order + 1, LONGER + 1)
        more = np.column_stack([lagged(force, i, products.start) - force for i in lags])
        gains[Capacity(capacity.splines, LONGER)] = _gain(evidence, more)
    best = max(gains, key=lambda k: gains[k], default=None)
    return best, gains[best] if best is not None else 0.0


def in_words(capacity: Capacity) -> str:
    """Return the warning that goes with a larger base model."""
    what = "a finer static curve" if capacity.splines > SPLINES else "a longer memory"
    return f"the base model needed {what} than usual; that is lack of fit, no cause"


def _gain(evidence: Evidence, columns: Floats) -> float:
    moments = evidence.moments(columns)
    return float(evidence.cross_validated(moments, Rule((0,) * columns.shape[1])).sum())
