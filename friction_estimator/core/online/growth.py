"""The range grows with the speeds that come: functions are appended, curve and band stay what they were."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Extension, Model
from friction_estimator.core.online import recovery
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.units import MARGIN

LARGEST_GROWTH = 10.0
"""Largest factor by which the range grows at once: faster drives take another twenty samples, and a burst of absurd
velocities does not make the model large."""

EDGE_DEVIATION = 0.03
"""Force units by which g may miss the edge's value, against prior deviations of the appended weights."""

EDGE_POINTS = 8
"""Points a basis unit at which the appended functions are to hold the edge's value."""


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

    The curve over the former range is what it was, since all functions that reach into it were there. The appended
    weights are those of least prior norm with which g keeps its edge value beyond; their covariance is the prior's.

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

    hold_edge = _edge_holder(place, before, after, prior)

    def larger_theta(theta: Floats) -> Floats:
        larger = np.zeros(after.size)
        larger[kept] = theta
        hold_edge(larger[taps : taps + new])
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


def _edge_holder(place: Ints, before: Model, after: Model, prior: Prior) -> Callable[[Floats], None]:
    """Return what sets the appended among the weights of g, (size,), so that g is flat beyond the former range."""
    size = after.basis.size
    fresh = np.setdiff1d(np.arange(size), place)
    if not fresh.size:
        return lambda _: None
    (low, high), (lowest, highest) = before.basis.reach, after.basis.reach
    points = max(2, round(EDGE_POINTS * (after.basis.cell_count - before.basis.cell_count)))
    velocity = np.concatenate([np.linspace(lowest, low, points), np.linspace(high, highest, points)])
    index, value = after.basis.rows(velocity)
    dense = np.zeros((velocity.size, size))
    np.put_along_axis(dense, index.astype(np.int64), value, axis=1)
    held, at_edge = before.basis.rows(velocity)  # rows are held at the edge outside
    scale = prior.deviation[int(after.shape[0]) :][fresh]
    columns = dense[:, fresh] * scale
    gram = cho_factor(columns.T @ columns + EDGE_DEVIATION**2 * np.eye(fresh.size))

    def hold(weights: Floats) -> None:
        wanted = np.sum(weights[place][held] * at_edge, axis=1)
        weights[fresh] = scale * cho_solve(gram, columns.T @ (wanted - dense @ weights))

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
