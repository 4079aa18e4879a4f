"""A Stribeck curve found from a drive's own samples: few of them, one stroke, one direction, noise, a slow start.

Least squares over samples gathered by velocity, as for `baselines`, but with the signs that physics gives: neither what
friction exceeds Coulomb's level by at breakaway, nor the viscous slope, nor the level over both directions is negative.
A falling branch then is the Stribeck term's, which ends at Coulomb's level, and no slope takes friction below zero at
speeds that nobody has seen. What the samples do not tell, the ridge of `baselines` decides: Coulomb first.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.fit.baselines import (
    EXPONENTS,
    NARROW,
    RIDGE_COULOMB,
    RIDGE_HALF_DIFFERENCE,
    RIDGE_NEVER,
    RIDGE_OFFSET,
    RIDGE_STRIBECK,
    RIDGE_VISCOUS,
)
from friction_estimator.core.fit.points import Bins, Points
from friction_estimator.core.model.theory_stribeck import Stribeck
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config

LEAST_SAMPLES = 30
"""Samples in motion below which the level alone is taken, their median."""

NARROWEST, WIDEST = 0.01, 0.5
"""Bounds of the width of the smooth sign, in top speeds: a step would ring through the filters behind it."""

SLOWEST, FASTEST = 0.01, 3.0
"""Bounds of the Stribeck velocity, in top speeds."""

GRID, ZOOMS = 7, 4
"""Points an axis of the search over the logarithms of both, and times that it is repeated on the neighbours' spacing,
each time half as wide."""

PARAMETERS = 9
"""Coefficients and shape, which the samples have to say besides their noise."""

REACH = 2.0
"""The curve goes on straight to this many times the speeds that it was found from, and is held there."""


def unknown_stribeck(config: Config) -> Stribeck:
    """Return Coulomb's law with the force unit, for a record in which nothing moves."""
    unit, scale = config.unit_N, config.velocity_scale
    return Stribeck(
        unit, unit, 0.0, 0.0, 0.0, 0.0, NARROWEST * scale, scale, EXPONENTS[0], -REACH * scale, REACH * scale
    )


@dataclass(frozen=True)
class _Trial:
    cost: float
    place: tuple[float, float]
    exponent: float
    coefficients: Floats


def found_stribeck(velocity_m_s: Floats, friction_N: Floats, moving: Bools | None = None) -> Stribeck | None:
    """Return the curve of samples in motion; None where nothing moves.

    Deterministic. Where friction drives the motion (a sensor wired the other way) the curve is that of -f, negated.

    Parameters
    ----------
    velocity_m_s, friction_N : (n,); what is not finite is left out.
    moving : (n,), the samples in motion; all of them unless given.
    """
    finite = np.isfinite(velocity_m_s) & np.isfinite(friction_N)
    points = Points(velocity_m_s, friction_N, finite if moving is None else finite & moving)
    speed, force = points.top_speed, points.largest_force
    if not speed > 0.0:
        return None
    with_motion = (np.sign(velocity) * friction for velocity, friction in points)
    if points.size < LEAST_SAMPLES:
        level = float(np.median(np.concatenate(list(with_motion))))
        return _curve(np.array([level, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), (NARROWEST, 1.0), 1.0, speed, 1.0)
    sign = -1.0 if sums.total(with_motion, points.size) < 0.0 else 1.0
    bins = points.gathered(speed, sign * force)
    widths, falls = (np.log(ends) for ends in ((NARROWEST, WIDEST), (SLOWEST, FASTEST)))
    axes = [np.linspace(ends[0], ends[1], GRID) for ends in (widths, falls)]
    best = _tried(bins, (NARROWEST, 1.0), EXPONENTS[0])
    for _ in range(1 + ZOOMS):
        for exponent, width, fall in product(EXPONENTS, *axes):
            # A Stribeck term narrower than the sign it is multiplied with is a spike that no instrument sees.
            trial = _tried(bins, (float(np.exp(width)), float(np.exp(max(width, fall)))), exponent)
            # a difference that rounding can make does not move the answer from the first
            if trial.cost < best.cost * (1.0 - 1e-9):
                best = trial
        axes = [
            np.clip(np.log(at) + 0.5 * (axis - axis[GRID // 2]), ends[0], ends[1])
            for at, axis, ends in zip(best.place, axes, (widths, falls), strict=True)
        ]
    # What noise makes of few samples, the ridge holds, as in `baselines.on_all`.
    noise = best.cost / max(bins.samples - PARAMETERS, 1)
    best = _tried(bins, best.place, best.exponent, noise)
    return _curve(best.coefficients, best.place, best.exponent, speed, sign * force)


def _tried(bins: Bins, place: tuple[float, float], exponent: float, noise: float = 0.0) -> _Trial:
    """Return the best coefficients for a width and a Stribeck velocity, in units of speed and force.

    `noise` is the mean square error of a coefficient of unit columns that the samples' noise makes.

    The coefficients are: level over both directions, half the difference of the directions where it is positive and
    where it is negative, Stribeck term and viscous slope at positive and at negative velocity.
    """
    x = bins.x
    from scipy.optimize import nnls  # noqa: PLC0415 - slow to import

    sign = np.tanh(x / place[0])
    fall = sign * np.exp(-((np.abs(x) / place[1]) ** exponent))
    ahead = x > 0.0
    size = np.abs(sign)
    columns = np.stack([sign, size, -size, fall * ahead, fall * ~ahead, x * ahead, x * ~ahead])
    one_way = not bins.both_ways
    ridge = np.array([RIDGE_COULOMB, *2 * [RIDGE_NEVER if one_way else RIDGE_OFFSET]])
    information = np.zeros((7, 7))
    information[:3, :3] = np.diag(ridge**2)
    for first, of_mean in ((3, RIDGE_STRIBECK), (5, RIDGE_VISCOUS)):
        of_difference = RIDGE_NEVER if one_way else RIDGE_HALF_DIFFERENCE * of_mean
        mean, difference = np.array([0.5, 0.5]), np.array([0.5, -0.5])
        information[first : first + 2, first : first + 2] = of_mean**2 * np.outer(
            mean, mean
        ) + of_difference**2 * np.outer(difference, difference)
    gram, moment = (columns * bins.share) @ columns.T, columns @ (bins.share * bins.y)
    power = float(np.sum(bins.share * bins.y**2)) + bins.scatter
    if power > 0.0:
        information[1:, 1:] += noise / power * np.eye(6)
    root = np.linalg.cholesky(gram + information + 1e-14 * np.eye(7))
    coefficients, _ = nnls(root.T, np.linalg.solve(root, moment))
    left = power - 2.0 * float(coefficients @ moment) + float(coefficients @ (gram + information) @ coefficients)
    widened = np.log(place[0] / NARROWEST) / np.log(WIDEST / NARROWEST)
    return _Trial(max(left, 0.0) * (1.0 + NARROW * widened / bins.samples), place, exponent, coefficients)


def _curve(coefficients: Floats, place: tuple[float, float], exponent: float, speed: float, force: float) -> Stribeck:
    level, more, less, stribeck_pos, stribeck_neg, viscous_pos, viscous_neg = coefficients.tolist()
    half = more - less
    return Stribeck(
        coulomb_neg=force * (level - half),
        coulomb_pos=force * (level + half),
        stribeck_neg=force * stribeck_neg,
        stribeck_pos=force * stribeck_pos,
        viscous_neg=force * viscous_neg / speed,
        viscous_pos=force * viscous_pos / speed,
        sign_velocity=place[0] * speed,
        stribeck_velocity=place[1] * speed,
        exponent=exponent,
        low=-REACH * speed,
        high=REACH * speed,
    )
