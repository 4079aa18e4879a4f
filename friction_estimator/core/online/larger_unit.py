"""The force unit rises where the range does, if the first contact met less than the drive's usual friction."""

from dataclasses import replace
from typing import Any

import numpy as np

from friction_estimator.core.fit.band import POWER, PRODUCT
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.growth import nothing_kept, prior_arrays
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats
from friction_estimator.core.triangular import inverse

LARGEST_ERROR = 2.0
"""Force units above which the rms of recent errors says that the unit is too small."""


def units_too_small(work: Workspace) -> float:
    """Return the factor by which the force unit is to rise, or 1: the rms of recent errors, where it is several units.

    The unit is the usual magnitude of friction, so errors above it, where the drive goes faster than it ever did, say
    that the first contact had met something else (noise of rest, creep without load). During an alarm they may not be
    friction at all.
    """
    if work.hold[at.HOLDING]:
        return 1.0
    rms = float(np.sqrt(work.moments[at.ERROR_POWER]))
    return rms if rms > LARGEST_ERROR else 1.0


def in_larger_units(work: Workspace, before: Model, after: Model, prior: Prior) -> Workspace:
    """Return the work space of `after`, which has a larger force unit than `before`, with what was learned.

    The sum of squares that the samples contributed is the same in other units, but every one of them counts for
    less against the prior, whose deviations are multiples of the unit: with D = d theta_new / d theta and s the ratio
    of the units,

        R_new = R_prior,new + D^-1 (R - R_prior) D^-1 / s^2

    and the parameters follow from the information vector likewise. Models kept aside are given up.
    """
    ratio, taps, weights = after.unit_N / before.unit_N, int(before.shape[0]), int(before.shape[1])
    theory_taps = int(before.shape[2])
    theory = after.theory_scale / before.theory_scale
    change = np.full(before.size, 1.0 / ratio)
    change[:taps] = 1.0
    change[taps + weights : taps + weights + theory_taps] = 1.0 / theory
    change[before.load_places] = before.load.scales / after.load.scales
    change[before.load_places.stop :] = 1.0  # terms of a diagnosis are in newton whatever the unit
    theta, root = work.theta * change, work.root
    if root.size:
        theta, root = _posterior(work, change * ratio, ratio, prior)
    moments = work.moments.copy()
    moments[[at.ERROR_POWER, at.MISFIT_POWER, at.ABSORBED]] /= ratio**2
    moments[at.LAST_ERROR] /= ratio
    moments[[at.PULL, at.OWED]] = 0.0
    errors = work.errors.copy()
    errors[:, [POWER, PRODUCT]] /= ratio**2
    fresh: dict[str, Any] = nothing_kept(after, bool(root.size))
    fresh["hold"][at.RESTORED] = work.hold[at.RESTORED]
    if root.size:
        fresh |= prior_arrays(prior)
    return replace(
        work,
        theta=theta,
        root=root,
        ring_theory=work.ring_theory * theory / ratio,
        owed=np.zeros_like(work.owed),
        moments=moments,
        errors=errors,
        residual=work.residual / ratio**2,
        **fresh,
    )


def _posterior(work: Workspace, scale: Floats, ratio: float, prior: Prior) -> tuple[Floats, Floats]:
    """Return mean and root of the posterior in larger units; `scale` is s D, (n,)."""
    half = np.linalg.inv(work.root)
    # Of rows and columns of one size: a prior's deviations may differ by more orders than a number has digits.
    size = np.sqrt(np.diag(work.information))
    value, vector = np.linalg.eigh((half.T @ half - work.information) / np.multiply.outer(size, size))
    vector *= size[:, None]
    learned = (vector * np.maximum(value, 0.0)) @ vector.T  # of what no sample told, rounding leaves either sign
    found = learned @ work.theta + work.information @ (work.theta - work.mean)
    believed = prior_arrays(prior)
    factor = np.linalg.cholesky(believed["information"] + learned / np.multiply.outer(scale, scale))
    wanted = believed["information"] @ believed["mean"] + found / (scale * ratio)
    root = inverse(factor).T
    return root @ (root.T @ wanted), np.ascontiguousarray(root)
