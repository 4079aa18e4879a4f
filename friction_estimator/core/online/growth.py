"""The range grows with the speeds that come: functions are appended, curve and band stay what they were."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from friction_estimator.compiled import njit
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.basis import WaveletBasis
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

LEAST_GROWTH = 1.25
"""Smallest factor: a drive that runs up goes on, and each growth takes milliseconds. Companded cells are few there."""

POINTS_A_CELL = 4
"""Of the fit that carries a curve over: several for the finest function."""

THINNING = 16
"""Of that fit: points beyond the new edges are apart by their distance over this, once that is more than a point's."""

WITHIN_DEVIATION, BEYOND_DEVIATION = 1e-4, 0.03
"""Force units by which g may miss what it was, and its edge's value beyond, against prior deviations of weights."""


def grown_model(model: Model, velocity_m_s: float, extension: Extension | None) -> Model | None:
    """Return the model whose range holds `velocity_m_s` with its margin, or None where it would grow too large."""
    low, high = model.basis.reach
    most = LARGEST_GROWTH * max(abs(low), abs(high))
    edge = high if velocity_m_s > 0.0 else low
    further = max(MARGIN * abs(velocity_m_s), LEAST_GROWTH * edge * np.sign(velocity_m_s))
    reached = float(min(further, most) * np.sign(velocity_m_s))
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

    models = [recovery.Kept.of(row, work) for row in work.kept]
    thetas = np.stack([work.theta, *(model.theta for model in models)])
    larger_thetas = np.zeros((len(thetas), after.size))
    larger_thetas[:, kept] = thetas
    larger_thetas[:, taps : taps + new] = _held_at_edges(before, after, thetas[:, taps : taps + old])

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

    def larger_row(model: recovery.Kept, theta: Floats) -> Floats:
        return np.concatenate([theta, larger_owed(model.owed), larger_errors(model.errors).ravel(), model.moments])

    ring = np.zeros((taps, new))
    ring[:, place] = work.ring
    constants: dict[str, Any] = prior_arrays(prior) if work.root.size else {}
    return replace(
        work,
        shape=after.shape.copy(),
        theta=larger_thetas[0].copy(),
        ring=ring,
        root=larger_root(work.root) if work.root.size else work.root,
        prior=prior.metric if work.prior.size else work.prior,
        errors=larger_errors(work.errors),
        owed=larger_owed(work.owed),
        kept=np.stack([larger_row(*each) for each in zip(models, larger_thetas[1:], strict=True)]),
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


def _held_at_edges(before: Model, after: Model, weights: Floats) -> Floats:
    """Return weights of `after`, (n, size), from those of `before`, (n, former size): g is what it was, flat beyond.

    A least-squares fit over velocity to the curve as it was, held at its edges beyond, against the prior's deviations
    from the weights as they were; those at the edges, of which the samples said little, move too. The fit reaches as
    far beyond the new edges as any function does: one that knew only a part of a function would give it a wild weight.
    """
    basis = after.basis
    assert isinstance(basis, WaveletBasis)
    wide = basis.widened()
    velocity = wide.cell_velocities(POINTS_A_CELL)
    inner = np.flatnonzero(basis.inside(velocity))
    above, apart_above = _thinning(velocity.size - 1 - inner[-1])
    below, apart_below = _thinning(inner[0])
    velocity = velocity[np.concatenate([inner[0] - below, inner, inner[-1] + above])]
    index, value = wide.rows(velocity)
    held, at_edge = before.basis.rows(velocity)  # rows are held at the edge outside
    importance = np.sqrt(np.concatenate([apart_below, np.ones(inner.size), apart_above]))
    importance /= np.where(before.basis.inside(velocity), WITHIN_DEVIATION, BEYOND_DEVIATION)
    scale = after.config.prior.weight_deviation * wide.prior_scale(after.config.prior.weight_slope)
    # Beyond the new edges the curve is flat: there the scaling functions, whose span holds a constant, are enough.
    theirs = wide.places_of(basis)
    fitted = np.union1d(theirs, np.flatnonzero(wide.is_scaling))
    columns = _matrix(index, importance[:, None] * value * scale[index], wide.size)[:, fitted]
    curves = _matrix(held, importance[:, None] * at_edge, before.basis.size) @ weights.T
    larger = np.zeros((wide.size, len(weights)))
    larger[wide.places_of(before.basis)] = weights.T
    missing = columns.T @ (curves - columns @ (larger / scale[:, None])[fitted])
    normal = np.eye(fitted.size)
    _add_products(columns.indptr, columns.indices, columns.data, normal)
    larger[fitted] += scale[fitted, None] * cho_solve(cho_factor(normal, lower=True, overwrite_a=True), missing)
    return np.ascontiguousarray(larger[theirs].T)


def _thinning(count: int) -> tuple[Ints, Floats]:
    """Return distances beyond an edge, from 1 to `count` at the most, and how far each is from the next.

    They thin out: of the functions of the range only broad ones reach far beyond its edge.
    """
    distances = [1]
    while distances[-1] < count:
        distances.append(distances[-1] + max(1, distances[-1] // THINNING))
    return np.array(distances[:-1], np.int64), np.diff(np.array(distances, np.float64))


def _matrix(index: NDArray[np.int32], value: Floats, size: int) -> csr_array:
    """Return rows of a basis as a matrix, (n, size): at any velocity a few functions differ from zero."""
    begins = np.arange(0, index.size + 1, index.shape[1])
    return csr_array((value.ravel(), index.ravel(), begins), shape=(len(index), size))


@njit(cache=True)
def _add_products(begins, index, value, total):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add X' X of a sparse X in compressed rows to the lower triangle of `total`."""
    for row in range(begins.size - 1):
        for i in range(begins[row], begins[row + 1]):
            for j in range(begins[row], begins[row + 1]):
                if index[j] <= index[i]:
                    total[index[i], index[j]] += value[i] * value[j]


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
