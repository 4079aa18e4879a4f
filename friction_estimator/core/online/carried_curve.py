"""A curve carried over to a larger range: what it was over the former one, and level beyond."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.model.basis import WaveletBasis
from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.triangular import inverse

POINTS_A_CELL = 4
"""Points of the fit: several for the finest function."""

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Times the size of the fit and its largest squared column: what rounding leaves of a positive definite matrix.
Deviations of thousands of force units, which `prior.weight_deviation` allows, reach it; usual ones stay far below."""

THINNING = 16
"""Points beyond the new edges are apart by their distance over this, once that is more than a point's."""

WITHIN_DEVIATION, BEYOND_DEVIATION = 1e-4, 0.03
"""Force units by which g may miss what it was, and its edge's value beyond, against prior deviations of weights."""


class CarriedCurve:
    """Weights of a larger model whose g is what it was, and flat beyond.

    A least-squares fit over velocity to the curve as it was, held at its edges beyond, against the prior's deviations
    from the weights as they were; those at the edges, of which the samples said little, move too. The fit reaches as
    far beyond the new edges as any function does: one that knew only a part of a function would give it a wild weight.

    Parameters
    ----------
    before, after : the model and the larger one.
    weights : (n, size) of `before`, one curve each.
    """

    def __init__(self, before: Model, after: Model, weights: Floats) -> None:
        assert isinstance(after.basis, WaveletBasis)
        self._before, self._basis, self._prior = before.basis, after.basis, after.config.prior
        self._weights = weights

    @cached_property
    def wide(self) -> WaveletBasis:
        """The functions of `after` and those beside them."""
        return self._basis.widened()

    @cached_property
    def places(self) -> Ints:
        """Where the functions of `after` stand among those of `wide`."""
        return self.wide.places_of(self._basis)

    @cached_property
    def points(self) -> tuple[Floats, Floats]:
        """Velocities of the points and their importance, (points,) each."""
        velocity = self.wide.cell_velocities(POINTS_A_CELL)
        if not self._basis.inside(velocity).any():  # cells that are wider than the range
            velocity = np.sort(np.concatenate([velocity, self._basis.reach]))
        inner = np.flatnonzero(self._basis.inside(velocity))
        above, apart_above = _thinning(velocity.size - 1 - inner[-1])
        below, apart_below = _thinning(inner[0])
        velocity = velocity[np.concatenate([inner[0] - below, inner, inner[-1] + above])]
        importance = np.sqrt(np.concatenate([apart_below, np.ones(inner.size), apart_above]))
        return velocity, importance / np.where(self._before.inside(velocity), WITHIN_DEVIATION, BEYOND_DEVIATION)

    @cached_property
    def functions(self) -> tuple[Ints, Ints, Floats]:
        """Those of `wide` that are fitted, the column of each or -1, and the prior deviation of its weight."""
        wide = self.wide
        # Beyond the new edges the curve is flat: there the scaling functions, whose span holds a constant, are enough.
        wanted = wide.is_scaling.copy()
        wanted[self.places] = True
        fitted, column = np.flatnonzero(wanted), np.full(wide.size, -1)
        column[fitted] = np.arange(fitted.size)
        return fitted, column, self._prior.weight_deviation * wide.prior_scale(self._prior.weight_slope)

    @cached_property
    def rows(self) -> tuple[NDArray[np.int32], Floats]:
        """What the functions of `after` are at the points, (index, value)."""
        return self.wide.rows(self.points[0])

    @cached_property
    def former_rows(self) -> tuple[NDArray[np.int32], Floats]:
        """What the functions of `before` are there; held at the edge outside."""
        return self._before.rows(self.points[0])

    @cached_property
    def normal(self) -> Floats:
        """The normal equations, the lower triangle; weights are in their prior deviations."""
        fitted, column, scale = self.functions
        normal = np.eye(fitted.size)
        _add_squares(*self.rows, column, scale, self.points[1], normal)
        least = ROUNDING * len(normal) * float(np.max(np.diag(normal)))
        if least > 1.0:
            normal[np.diag_indices_from(normal)] += least
        return normal

    @cached_property
    def factor(self) -> Floats:
        """Their Cholesky factor."""
        return np.asarray(np.linalg.cholesky(self.normal))

    @cached_property
    def inverse_factor(self) -> Floats:
        """Its inverse."""
        return inverse(self.factor)

    @cached_property
    def start(self) -> Floats:
        """Weights of the functions of `wide` that leave the curves as they are, (n, functions); appended ones are 0."""
        start = np.zeros((len(self._weights), self.wide.size))
        start[:, self.wide.places_of(self._before)] = self._weights
        return start

    @cached_property
    def missing(self) -> Floats:
        """Right-hand sides of the normal equations, (n, columns): what these curves lack beyond the former edges."""
        fitted, column, scale = self.functions
        missing = np.zeros((len(self._weights), fitted.size))
        _add_missing(*self.rows, column, scale, self.points[1], *self.former_rows, self._weights, self.start, missing)
        return missing

    @cached_property
    def weights(self) -> Floats:
        """Weights of the larger model, (n, size)."""
        fitted, _, scale = self.functions
        larger = self.start.copy()
        larger[:, fitted] += scale[fitted] * (self.missing @ self.inverse_factor.T @ self.inverse_factor)
        return np.ascontiguousarray(larger[:, self.places])


def _thinning(count: int) -> tuple[Ints, Floats]:
    """Return distances beyond an edge, from 1 to `count` at the most, and how far each is from the next.

    They thin out: of the functions of the range only broad ones reach far beyond its edge.
    """
    distances = [1]
    while distances[-1] < count:
        distances.append(distances[-1] + max(1, distances[-1] // THINNING))
    return np.array(distances[:-1], np.int64), np.diff(np.array(distances, np.float64))


@njit(cache=True)
def _add_squares(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    index, value, column, scale, importance, normal
):
    """Add X' X to the lower triangle, X the scaled rows of a basis with only the functions that have a column."""
    width = index.shape[1]
    place, entry = np.empty(width, np.int64), np.empty(width)
    for row in range(importance.size):
        count = 0
        for k in range(width):
            function = index[row, k]
            if column[function] >= 0:
                place[count] = column[function]
                entry[count] = importance[row] * scale[function] * value[row, k]
                count += 1
        for i in range(count):
            for j in range(count):
                if place[j] <= place[i]:
                    normal[place[i], place[j]] += entry[i] * entry[j]


@njit(cache=True)
def _add_missing(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    index, value, column, scale, importance, former_index, former_value, former, larger, missing
):
    """Add X' (Y w - X u) for each pair of weights w of the former basis, whose rows are Y, and u of the larger one."""
    for row in range(importance.size):
        for model in range(len(former)):
            error = 0.0
            for k in range(former_index.shape[1]):
                error += former_value[row, k] * former[model, former_index[row, k]]
            for k in range(index.shape[1]):
                error -= value[row, k] * larger[model, index[row, k]]
            error *= importance[row] ** 2
            for k in range(index.shape[1]):
                function = index[row, k]
                if column[function] >= 0:
                    missing[model, column[function]] += error * scale[function] * value[row, k]
