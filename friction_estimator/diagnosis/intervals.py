"""Fitted physical quantities with 95 % intervals."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.features import Context

MEMORY_SHARE = 0.1
"""Samples by which a time of the whole force is uncertain beside its sampling error: the rig's own short memory, of
which the prior knows that much, delays the force as well."""


@dataclass(frozen=True)
class Estimate:
    """A fitted physical quantity with its 95 % interval."""

    value: float
    unit: str
    low: float
    high: float


def parameter_covariance(joint: Joint, record: Record, seed: int) -> Floats:
    """Return the covariance of the tangent's coefficients in the parameters' own units, (q, q).

    Sandwich over blocks: H^-1 (sum_b s_b s_b') H^-1 with s_b = X_b' e_b, B / (B - 1), so that neither coloured
    nor uneven noise makes the intervals too narrow. A parameter held at an end of its bracket is as uncertain as a free
    one.
    """
    evidence = joint.evidence(record, seed)
    hessian = evidence.zz.sum(0) + np.diag(np.where(joint.at_end, 0.0, joint.penalty))
    hessian = hessian + np.diag(1e-10 * np.maximum(np.diag(hessian), 1e-300))
    scores = evidence.ze - evidence.ze.mean(axis=0)
    inverse = np.linalg.inv(hessian)
    blocks = evidence.blocks
    middle = scores.T @ scores * blocks / (blocks - 1)
    white = hessian * float(evidence.ee.sum()) / max(evidence.samples - hessian.shape[0], 1)
    # Few blocks make the sandwich noisy: it never falls below what white noise alone would give.
    sandwich, plain = inverse @ middle @ inverse, inverse @ white @ inverse
    known = np.maximum(np.diag(sandwich), 1e-300)
    lift = np.sqrt(np.fmax(np.diag(plain) / known, np.ones(known.size)))
    return np.asarray(sandwich * np.outer(lift, lift) * np.outer(joint.scales, joint.scales))


def estimates(
    joint: Joint, record: Record, context: Context, seed: int, systematic: bool = True
) -> list[dict[str, Estimate]]:
    """Return the physical parameters of each term with intervals.

    Sampling error by the delta method with Student t over blocks, and the effect's systematic share beside it unless
    `systematic` is False.
    """
    covariance = parameter_covariance(joint, record, seed)
    quantile = float(student.ppf(0.975, max(record.blocks - 1, 1)))
    place = joint.base.tangent.shape[1]
    out = []
    for term in joint.terms:
        free = 0 if term.effect.fixed_gain else term.weights.size
        names = [n for n in term.effect.refined if term.params[n] != 0.0]
        theta = np.concatenate([term.weights[:free], [term.params[n] for n in names]])
        part = covariance[place : place + theta.size, place : place + theta.size]
        place += theta.size

        def values(
            point: Floats, term: Term = term, free: int = free, names: list[str] = names
        ) -> dict[str, tuple[float, str]]:
            params = term.params | dict(zip(names, point[free:].tolist(), strict=True))
            weights = point[:free] if free else np.ones(1)
            return term.effect.physical(params, weights, context)

        centre = values(theta)
        found = {}
        for name, (value, unit) in centre.items():
            slope = np.zeros(theta.size)
            for i in range(theta.size):
                step = 1e-4 * abs(theta[i]) + 1e-12
                moved = theta.copy()
                moved[i] += step
                slope[i] = (values(moved)[name][0] - value) / step
            reach = quantile * float(np.sqrt(max(float(slope @ part @ slope), 0.0)))
            if systematic:
                reach = float(np.hypot(reach, term.effect.systematic.get(name, 0.0) * abs(value)))
            if systematic and term.effect.delays:
                reach = float(np.hypot(reach, MEMORY_SHARE * context.step_s))
            low = float(value - reach)
            if systematic and name in term.effect.refined and value > 0.0:
                low = max(low, 0.0)  # a length or a time is not negative
            found[name] = Estimate(float(value), unit, low, float(value + reach))
        out.append(found)
    return out
