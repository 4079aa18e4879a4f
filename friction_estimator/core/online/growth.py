"""The range grows with the speeds that come: functions are appended, curve and band stay what they were."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from friction_estimator.core.banded import diagonal, identity
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Extension, Model
from friction_estimator.core.online import recovery
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.units import MARGIN

LARGEST_GROWTH = 10.0
"""Largest factor by which the range grows at once: faster drives take another twenty samples, and a burst of absurd
velocities does not make the model large."""

POINTS_A_CELL = 4
"""Of the fit that carries a curve over: several for the finest function."""

WITHIN_DEVIATION, BEYOND_DEVIATION = 1e-4, 0.03
"""Force units by which g may miss what it was, and its edge's value beyond, against prior deviations of weights."""


def grown_model(model: Model, velocity_m_s: float, extension: Extension | None) -> Model | None:
    """Return the model whose range holds `velocity_m_s` with its margin, or None where it would grow too large."""
    low, high = model.basis.reach
    most = LARGEST_GROWTH * max(abs(low), abs(high))
    reached = min(max(MARGIN * velocity_m_s, -most), most)
    low, high = min(low, reached), max(high, reached)
    try:
        return Model(model.config.updated({"learned.velocity_range": (low, high)}), extension)
    except ConfigError:
        return None


def carried_over(work: Workspace, before: Model, after: Model, prior: Prior) -> Workspace:
    """Return the work space of `after`, with what `before` had learned.

    The curve over the former range is what it was, and level beyond. Functions that reach into the former range keep
    their covariance, the appended ones have the prior's.

    Parameters
    ----------
    prior : of `after`.
    """
    taps, old = int(before.shape[0]), int(before.shape[1])
    new = int(after.shape[1])
    place = after.basis.places_of(before.basis)
    # Where each parameter of `before` stands in `after`.
    head, tail = np.arange(taps), np.arange(before.size - taps - old)
    kept = np.concatenate([head, taps + place, taps + new + tail])
    fresh = np.setdiff1d(np.arange(after.size), kept)
    shift = before.basis.first_cell - after.basis.first_cell

    held_at_edges = _edge_holder(before, after)

    def larger_theta(theta: Floats) -> Floats:
        larger = np.zeros(after.size)
        larger[kept] = theta
        larger[taps : taps + new] = held_at_edges(theta[taps : taps + old])
        return larger

    def larger_errors(errors: Floats) -> Floats:
        larger = np.zeros((after.basis.cell_count, 3))
        larger[shift : shift + before.basis.cell_count] = errors
        return larger

    def larger_owed(owed: Floats) -> Floats:
        larger = np.zeros(after.size if owed.size else 0)
        larger[kept[: owed.size]] = owed
        return larger

    def larger_root(root: Floats) -> Floats:
        larger = np.zeros((after.size, after.size))
        larger[np.ix_(kept, kept)] = root
        larger[fresh, fresh] = prior.deviation[fresh] / np.sqrt(prior.residual_variance)
        return larger

    def larger_roots(roots: Floats) -> Floats:
        larger = np.zeros((2, after.size, after.size))
        for place, used in ((recovery.HELD, at.HOLDING), (recovery.FORMER, at.HAS_FORMER)):
            if work.hold[used]:
                larger[place] = larger_root(roots[place])
        return larger

    def larger_row(row: Floats) -> Floats:
        model = recovery.Kept.of(row, work)
        parts = larger_theta(model.theta), larger_owed(model.owed), larger_errors(model.errors).ravel(), model.moments
        return np.concatenate(parts)

    ring = np.zeros((taps, new))
    ring[:, place] = work.ring
    constants: dict[str, Any] = prior_arrays(prior) if work.root.size else {}
    return replace(
        work,
        shape=after.shape.copy(),
        theta=larger_theta(work.theta),
        ring=ring,
        root=larger_root(work.root) if work.root.size else work.root,
        prior=prior.metric if work.prior.size else work.prior,
        errors=larger_errors(work.errors),
        owed=larger_owed(work.owed),
        kept=np.stack([larger_row(row) for row in work.kept]),
        kept_root=larger_roots(work.kept_root) if work.root.size else work.kept_root,
        trial=np.zeros((recovery.bins(after), 3)),
        **constants,
    )


def prior_arrays(prior: Prior) -> dict[str, Floats]:
    """Return the constants of `Workspace` that rls takes from the prior, in units of the residual variance."""
    return {
        "mean": prior.mean.copy(),
        "information": np.ascontiguousarray(prior.information * prior.residual_variance),
        "prior_root": np.ascontiguousarray(prior.root / np.sqrt(prior.residual_variance)),
    }


def _edge_holder(before: Model, after: Model) -> Callable[[Floats], Floats]:
    """Return what makes weights of `after`, (size,), from those of `before`: g is what it was, and flat beyond.

    A least-squares fit over velocity to the curve as it was, held at its edges beyond, against the prior's deviations
    from the weights as they were; those at the edges, of which the samples said little, move too. The fit reaches as
    far beyond the new edges as any function does: one that knew only a part of a function would give it a wild weight.
    """
    basis = after.basis
    wide = basis.widened()
    place, theirs = wide.places_of(before.basis), wide.places_of(basis)
    velocity = wide.cell_velocities(POINTS_A_CELL)
    index, value = wide.rows(velocity)
    # Sparse: at any velocity a few functions differ from zero, and a range in wrong units holds thousands.
    begins = np.arange(0, index.size + 1, index.shape[1])
    psi = csr_array((value.ravel(), index.ravel(), begins), shape=(velocity.size, wide.size))
    held, at_edge = before.basis.rows(velocity)  # rows are held at the edge outside
    importance = 1.0 / np.where(before.basis.inside(velocity), WITHIN_DEVIATION, BEYOND_DEVIATION)
    scale = after.config.prior.weight_deviation * wide.prior_scale(after.config.prior.weight_slope)
    columns = diagonal(importance) @ psi @ diagonal(scale)
    solve = splu(csc_array(columns.T @ columns + identity(wide.size))).solve

    def hold(weights: Floats) -> Floats:
        larger = np.zeros(wide.size)
        larger[place] = weights
        wanted = np.sum(weights[held] * at_edge, axis=1)
        larger += scale * solve(columns.T @ (importance * (wanted - psi @ larger)))
        return np.asarray(larger[theirs])

    return hold


def cold_start(model: Model, prior: Prior, metric: Floats, covariance: bool, constants: Floats) -> Workspace:
    """Return the work space before the first sample.

    Parameters
    ----------
    metric : of nlms, or empty. covariance : whether the law keeps one. constants : of the law.
    """
    taps, weights, theory_taps, _ = (int(v) for v in model.shape)
    nothing = {"mean": np.zeros(0), "information": np.zeros((0, 0)), "prior_root": np.zeros((0, 0))}
    arrays = prior_arrays(prior) if covariance else nothing
    return Workspace(
        shape=model.shape.copy(),
        theta=model.initial_theta(),
        ring=np.zeros((taps, weights)),
        ring_theory=np.zeros(max(1, theory_taps)),
        root=arrays["prior_root"].copy(),
        prior=metric,
        noise=np.zeros((model.load.size, 2)),
        owed=np.zeros(model.size if covariance else 0),
        law=constants,
        moments=at.cold_moments(),
        status=at.cold_status(may_grow=not model.config.basis.velocity_range),
        errors=np.zeros((model.basis.cell_count, 3)),
        rest=np.zeros(standstill.STATE_SIZE),
        **nothing_kept(model, covariance),
        **arrays,
    )


def nothing_kept(model: Model, covariance: bool) -> dict[str, Floats]:
    """Return the arrays of `recovery` before the first sample."""
    cells, root = model.basis.cell_count, model.size if covariance else 0
    return {
        "kept": np.zeros((recovery.KEPT, model.size + root + 3 * cells + at.MOMENTS_SIZE)),
        "kept_root": np.zeros((2, root, root)),
        "trial": np.zeros((recovery.bins(model), 3)),
        "hold": np.zeros(at.HOLD_SIZE),
    }
