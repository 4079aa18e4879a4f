"""The range grows with the speeds that come: functions are appended, curve and band stay what they were."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from friction_estimator.compiled import njit
from friction_estimator.core.addresses import placed
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import recovery
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.adaptation import Law, constants
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import ALONE_ABOVE, MARGIN, with_units_of

LARGEST_GROWTH = 10.0
"""Largest factor by which the range grows at once: faster drives take another twenty samples, and a burst of absurd
velocities does not make the model large."""

LEAST_GROWTH = 1.25
"""Smallest factor: a drive that runs up goes on, and each growth takes milliseconds. Companded cells are few there."""

POINTS_A_CELL = 4
"""Of the fit that carries a curve over: several for the finest function."""

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Of that fit, times its size and its largest squared column: what rounding leaves of a positive definite matrix.
Deviations of thousands of force units, which `prior.weight_deviation` allows, reach it; usual ones stay far below."""

THINNING = 16
"""Of that fit: points beyond the new edges are apart by their distance over this, once that is more than a point's."""

WITHIN_DEVIATION, BEYOND_DEVIATION = 1e-4, 0.03
"""Force units by which g may miss what it was, and its edge's value beyond, against prior deviations of weights."""


def grown_model(model: Model, velocity_m_s: float) -> Model | None:
    """Return the model whose range holds `velocity_m_s` with its margin, or None where it would grow too large."""
    low, high = model.basis.reach
    most = LARGEST_GROWTH * max(abs(low), abs(high))
    sign, edge = (1.0, high) if velocity_m_s > 0.0 else (-1.0, -low)
    reached = sign * min(max(MARGIN * abs(velocity_m_s), LEAST_GROWTH * edge), most)
    low, high = min(low, reached), max(high, reached)
    try:
        return Model(model.config.updated({"learned.velocity_range": (low, high)}), model.extension)
    except ConfigError:
        return None


class Growth:
    """A range on its way to be larger.

    All of it can be made ahead, a part at a time, since samples beyond an edge teach nothing: what they do change, the
    larger work space shares with the present one, but for the delay lines.

    Parameters
    ----------
    before, after : the model and the larger one.
    work : the present work space.
    config, law : of the estimator.
    """

    def __init__(self, before: Model, after: Model, work: Workspace, config: Config, law: type[Law]) -> None:
        self.before, self.after, self._work = before, after, work
        self._given, self._law, self._first = config, law, _first_beyond(work)
        self._asked_for = 0

    def is_under_way(self, model: Model, work: Workspace, config: Config) -> bool:
        """Return whether the samples beyond the edge that asked for this growth are still coming, and nothing else."""
        same = self.before is model and self._work is work and self._given is config
        return same and self._first == _first_beyond(work)

    def prepare(self) -> bool:
        """Make the next part, half a millisecond of work with a hundred parameters; return whether there was one."""
        parts: list[Callable[[], object]] = [
            lambda: self.prior,
            lambda: self.prior.root,
            lambda: self.prior.information,
            lambda: self.law_arrays,
            lambda: self.fit,
            lambda: self.fit.columns,
            lambda: self.fit.normal,
            lambda: self.fit.factor,
            lambda: self.fit.former,
            lambda: self.thetas,
            lambda: self.roots,
            lambda: self.larger,
            lambda: self.larger.addresses,
            lambda: (self.config, self.constants),
        ]
        if self._asked_for == len(parts):
            return False
        self._asked_for += 1
        parts[self._asked_for - 1]()
        return True

    @cached_property
    def prior(self) -> Prior:
        """The prior of `after`."""
        return Prior.of(self.after)

    @cached_property
    def law_arrays(self) -> dict[str, Any]:
        """What the law takes from it."""
        return prior_arrays(self.prior) if self._law.keeps_covariance else {}

    @cached_property
    def fit(self) -> "_CurveFit":
        """What carries curves over."""
        return _CurveFit(self.before, self.after)

    @cached_property
    def config(self) -> Config:
        """The configuration with the larger range."""
        return with_units_of(self._given, self.after.config)

    @cached_property
    def constants(self) -> Floats:
        """`Workspace.law`."""
        return constants(self._law, self.config, self.after.basis)

    @cached_property
    def _places(self) -> tuple[Ints, Ints]:
        """Where the functions of `before` stand among those of `after`, and where its parameters do."""
        taps, old, new = int(self.before.shape[0]), int(self.before.shape[1]), int(self.after.shape[1])
        place = self.after.basis.places_of(self.before.basis)
        head, tail = np.arange(taps), np.arange(self.before.size - taps - old)
        return place, np.concatenate([head, taps + place, taps + new + tail])

    @cached_property
    def thetas(self) -> Floats:
        """Parameters of the present model and of those kept aside, (models, n)."""
        taps, old, new = int(self.before.shape[0]), int(self.before.shape[1]), int(self.after.shape[1])
        kept_aside = (recovery.Kept.of(row, self._work).theta for row in self._work.kept)
        thetas = np.stack([self._work.theta, *kept_aside])
        larger = np.zeros((len(thetas), self.after.size))
        larger[:, self._places[1]] = thetas
        larger[:, taps : taps + new] = self.fit.weights(thetas[:, taps : taps + old])
        return larger

    @cached_property
    def roots(self) -> tuple[Floats, Floats]:
        """Roots of the covariance, of the present model and of those kept aside."""
        work, prior, size = self._work, self.prior, self.after.size
        if not work.root.size:
            return work.root, work.kept_root
        kept = self._places[1]
        fresh = np.setdiff1d(np.arange(size), kept)

        def larger(root: Floats) -> Floats:
            grown = np.zeros((size, size))
            grown[np.ix_(kept, kept)] = root
            grown[fresh, fresh] = prior.deviation[fresh] / np.sqrt(prior.residual_variance)
            return grown

        aside = placed(np.zeros((2, size, size)))
        for place, used in ((recovery.HELD, at.HOLDING), (recovery.FORMER, at.HAS_FORMER)):
            if work.hold[used]:
                aside[place] = larger(work.kept_root[place])
        return placed(larger(work.root)), aside

    @cached_property
    def larger(self) -> Workspace:
        """The work space of `after`, with what `before` had learned; its delay lines are empty.

        The curve over the former range is what it was, and level beyond. Functions that reach into the former range
        keep their covariance, the appended ones have the prior's.
        """
        before, after, prior, work = self.before, self.after, self.prior, self._work
        _, kept = self._places
        shift = before.basis.first_cell - after.basis.first_cell

        def larger_errors(errors: Floats) -> Floats:
            larger = np.zeros((after.basis.cell_count, 3))
            larger[shift : shift + before.basis.cell_count] = errors
            return larger

        def larger_owed(owed: Floats) -> Floats:
            larger = np.zeros(after.size if owed.size else 0)
            larger[kept[: owed.size]] = owed
            return larger

        def larger_row(model: recovery.Kept, theta: Floats) -> Floats:
            return np.concatenate([theta, larger_owed(model.owed), larger_errors(model.errors).ravel(), model.moments])

        models = [recovery.Kept.of(row, work) for row in work.kept]
        return replace(
            work,
            shape=after.shape.copy(),
            theta=self.thetas[0].copy(),
            ring=np.zeros((int(before.shape[0]), int(after.shape[1]))),
            root=self.roots[0],
            prior=prior.metric if work.prior.size else work.prior,
            errors=larger_errors(work.errors),
            owed=larger_owed(work.owed),
            kept=np.stack([larger_row(*each) for each in zip(models, self.thetas[1:], strict=True)]),
            kept_root=self.roots[1],
            trial=np.zeros((recovery.bins(after), 3)),
            **self.law_arrays,
        )

    def done(self) -> Workspace:
        """Return `larger` with the delay lines as they are."""
        self.larger.ring[:, self._places[0]] = self._work.ring
        self.larger.law[:] = self.constants
        return self.larger


def _first_beyond(work: Workspace) -> int:
    """Return the number of the sample from which on all lie beyond one edge."""
    return int(work.status[at.SEEN]) - abs(int(work.status[at.BEYOND]))


def next_growth(
    model: Model, work: Workspace, config: Config, law: type[Law], under_way: Growth | None
) -> Growth | None:
    """Return the growth that the first velocities in a row beyond an edge ask for, or None: too large a basis.

    Parameters
    ----------
    model, work, config, law : of the estimator. under_way : returned if it is the one.
    """
    if under_way is not None and under_way.is_under_way(model, work, config):
        return under_way
    nearest, farthest = float(work.moments[at.NEAREST]), float(work.moments[at.FARTHEST])
    # All of them lie beyond the edge; one that stands far out among them is a wild value.
    velocity = farthest if abs(farthest) <= ALONE_ABOVE * abs(nearest) else nearest
    after = grown_model(model, velocity)
    return Growth(model, after, work, config, law) if after else None


def prior_arrays(prior: Prior) -> dict[str, Floats]:
    """Return the constants of `Workspace` that rls takes from the prior, in units of the residual variance."""
    return {
        "mean": prior.mean.copy(),
        "information": placed(prior.information * prior.residual_variance),
        "prior_root": placed(prior.root / np.sqrt(prior.residual_variance)),
    }


class _CurveFit:
    """Weights of a larger model whose g is what it was, and flat beyond.

    A least-squares fit over velocity to the curve as it was, held at its edges beyond, against the prior's deviations
    from the weights as they were; those at the edges, of which the samples said little, move too. The fit reaches as
    far beyond the new edges as any function does: one that knew only a part of a function would give it a wild weight.
    """

    def __init__(self, before: Model, after: Model) -> None:
        basis = after.basis
        assert isinstance(basis, WaveletBasis)
        wide = self._wide = basis.widened()
        velocity = wide.cell_velocities(POINTS_A_CELL)
        if not basis.inside(velocity).any():  # cells that are wider than the range
            velocity = np.sort(np.concatenate([velocity, basis.reach]))
        inner = np.flatnonzero(basis.inside(velocity))
        above, apart_above = _thinning(velocity.size - 1 - inner[-1])
        below, apart_below = _thinning(inner[0])
        velocity = velocity[np.concatenate([inner[0] - below, inner, inner[-1] + above])]
        importance = np.sqrt(np.concatenate([apart_below, np.ones(inner.size), apart_above]))
        importance /= np.where(before.basis.inside(velocity), WITHIN_DEVIATION, BEYOND_DEVIATION)
        self._velocity, self._importance = velocity, importance
        self._scale = after.config.prior.weight_deviation * wide.prior_scale(after.config.prior.weight_slope)
        self._before, self._theirs = before.basis, wide.places_of(basis)
        # Beyond the new edges the curve is flat: there the scaling functions, whose span holds a constant, are enough.
        self._fitted = np.union1d(self._theirs, np.flatnonzero(wide.is_scaling))

    @cached_property
    def columns(self) -> csr_array:
        """What the functions of `after` are at the points, in prior deviations of their weights."""
        index, value = self._wide.rows(self._velocity)
        return _matrix(index, self._importance[:, None] * value * self._scale[index], self._wide.size)[:, self._fitted]

    @cached_property
    def normal(self) -> Floats:
        """The normal equations, the lower triangle."""
        normal = np.eye(self._fitted.size)
        columns = self.columns
        _add_products(columns.indptr, columns.indices, columns.data, normal)
        least = ROUNDING * len(normal) * float(np.max(np.diag(normal)))
        if least > 1.0:
            normal[np.diag_indices_from(normal)] += least
        return normal

    @cached_property
    def factor(self) -> tuple[Floats, bool]:
        """Their Cholesky factor."""
        return cho_factor(self.normal, lower=True)

    @cached_property
    def former(self) -> csr_array:
        """What the functions of `before` are at the points; rows are held at the edge outside."""
        held, at_edge = self._before.rows(self._velocity)
        return _matrix(held, self._importance[:, None] * at_edge, self._before.size)

    def weights(self, weights: Floats) -> Floats:
        """Return weights of the larger model, (n, size), from those of the former one, (n, former size)."""
        larger = np.zeros((self._wide.size, len(weights)))
        larger[self._wide.places_of(self._before)] = weights.T
        start = (larger / self._scale[:, None])[self._fitted]
        missing = self.columns.T @ (self.former @ weights.T - self.columns @ start)
        larger[self._fitted] += self._scale[self._fitted, None] * cho_solve(self.factor, missing)
        return np.ascontiguousarray(larger[self._theirs].T)


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
