"""Evidence for and against hypotheses: blocked cross-validation, family-wise gate, paired comparison.

Everything happens in the space of inner products, summed over blocks: with Z the base model's tangent, e its
residual and X the columns of a hypothesis, the joint refit of base and hypothesis on any set of blocks needs Z'Z, Z'e,
Z'X, X'X and X'e of those blocks only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.products import inner

FOLDS = 8
RELATIVE_RIDGE = 1e-7
"""Of a hypothesis' own energy: columns that the base explains to this share count as explained by it."""

GAIN_LOW, GAIN_HIGH = 0.4, 2.5
"""A hypothesis that is the whole change (a delay) must come out near coefficient one; its grid is coarse."""


@dataclass(frozen=True)
class Moments:
    """Inner products of one hypothesis' columns, by block.

    Attributes
    ----------
    zx : (blocks, q, c). xx : (blocks, c, c). xe : (blocks, c).
    """

    zx: Floats
    xx: Floats
    xe: Floats


@dataclass(frozen=True)
class Fit:
    """A hypothesis fitted jointly with the base.

    Attributes
    ----------
    weights : (c,), coefficients of the columns. base : (q,), change of the base's coefficients.
    gain : decrease of the error power in the sample, summed, N^2.
    """

    weights: Floats
    base: Floats
    gain: float


@dataclass(frozen=True)
class Rule:
    """Constraints on coefficients: signs (c,), +1, -1 or 0; and whether they must be near one."""

    signs: tuple[int, ...]
    near_one: bool = False


class Evidence:
    """Inner products of the base model's tangent and residual, by block, and what follows from them.

    Parameters
    ----------
    tangent : (n, q). penalty : (q,), ridge. residual : (n,), N. used : (n,) bool. block : (n,) int, increasing.
    seed : of folds and bootstrap.
    """

    def __init__(self, tangent: Floats, penalty: Floats, residual: Floats, used: Bools, block: Ints, seed: int) -> None:
        self._edges = np.concatenate([np.flatnonzero(np.diff(block, prepend=-1)), [block.size]])
        self.blocks = self._edges.size - 1
        self._used = used
        self._z = tangent * used[:, None]
        self.residual = residual * used
        self.penalty = penalty
        self.zz = self._by_block(self._z, self._z)
        self.ze = self._by_block(self._z, self.residual[:, None])[:, :, 0]
        self.ee = np.array([float(np.dot(p, p)) for p in self._parts(self.residual)])
        self.samples = int(used.sum())
        self.folds = folds_of(self.blocks, seed)
        self._seed = seed
        self._solved: dict[bytes, tuple[Floats, Floats]] = {}

    def _parts(self, values: NDArray[Any]) -> list[NDArray[Any]]:
        return [values[a:b] for a, b in zip(self._edges[:-1], self._edges[1:], strict=True)]

    def _by_block(self, left: NDArray[Any], right: Floats) -> Floats:
        pairs = zip(self._parts(left), self._parts(right), strict=True)
        return np.array([inner(a, b) for a, b in pairs])

    def moments(self, columns: Floats) -> Moments:
        """Return the inner products of columns (n, c)."""
        x = columns * self._used[:, None]
        zx = self._by_block(self._z, x)
        xe = self._by_block(x, self.residual[:, None])[:, :, 0]
        return Moments(zx, self._by_block(x, x), xe)

    def moments_of_many(self, groups: Sequence[Floats]) -> list[Moments]:
        """Return the inner products of several hypotheses' columns at once: fewer and larger products."""
        x = np.concatenate(groups, axis=1) * self._used[:, None]
        zx = self._by_block(self._z, x)
        starts = self._edges[:-1]
        xe = np.add.reduceat(x * self.residual[:, None], starts, axis=0)
        out = []
        place = 0
        for group in groups:
            width = group.shape[1]
            mine = x[:, place : place + width]
            xx = np.empty((self.blocks, width, width))
            for i in range(width):
                for k in range(i + 1):
                    xx[:, i, k] = xx[:, k, i] = np.add.reduceat(mine[:, i] * mine[:, k], starts)
            out.append(Moments(zx[:, :, place : place + width], xx, xe[:, place : place + width]))
            place += width
        return out

    def moments_of(self, columns: NDArray[np.float32], known: Moments) -> Moments:
        """Return the inner products with this residual, where those with the same tangent are `known`."""
        xe = np.add.reduceat(columns * self.residual[:, None], self._edges[:-1], axis=0)
        return Moments(known.zx, known.xx, xe)

    def fit(self, moments: Moments, rule: Rule, rows: Bools | None = None) -> Fit:
        """Fit base and hypothesis jointly on the chosen blocks (default all)."""
        rows = np.ones(self.blocks, np.bool_) if rows is None else rows
        inverse, alone = self._known(rows)
        zx = moments.zx[rows].sum(0)
        through = inverse @ zx
        xx = moments.xx[rows].sum(0)
        left = xx - zx.T @ through
        pull = moments.xe[rows].sum(0) - zx.T @ alone
        weights, gain = constrained(left, pull, np.diag(xx), rule)
        return Fit(weights, alone - through @ weights, gain)

    def cross_validated(self, moments: Moments, rule: Rule) -> Floats:
        """Return the decrease of the error power on each block by a fit that never saw it, (blocks,), N^2."""
        gains = np.zeros(self.blocks)
        for fold in range(int(self.folds.max()) + 1):
            test = self.folds == fold
            gains[test] = self.held_out(self.fit(moments, rule, ~test), moments, test, ~test)
        return gains

    def held_out(self, fit: Fit, moments: Moments, test: Bools, train: Bools) -> Floats:
        """Return the gain of a fit over the base alone on the test blocks, (n_test,), N^2."""
        alone = self.base_alone(train)
        return self.loss(alone, None, None, test) - self.loss(fit.base, fit.weights, moments, test)

    def base_alone(self, rows: Bools) -> Floats:
        """Return the change of the base's coefficients fitted on these blocks, (q,)."""
        return self._known(rows)[1]

    def _known(self, rows: Bools) -> tuple[Floats, Floats]:
        """Return the inverse of Z'Z and the base's own change on these blocks; each is formed once."""
        key = rows.tobytes()
        if key not in self._solved:
            zz, ze = self.zz[rows].sum(0) + np.diag(self.penalty), self.ze[rows].sum(0)
            inverse: Floats = np.asarray(np.linalg.inv(_stable(zz)), np.float64)
            self._solved[key] = inverse, np.asarray(inverse @ ze)
        return self._solved[key]

    def loss(self, base: Floats, weights: Floats | None, moments: Moments | None, rows: Bools) -> Floats:
        """Return the error power of each of these blocks, (n_rows,), N^2."""
        value = self.ee[rows] - 2.0 * self.ze[rows] @ base + (self.zz[rows] @ base) @ base
        if weights is None or moments is None:
            return np.asarray(value)
        cross = moments.zx[rows] @ weights @ base
        return np.asarray(
            value - 2.0 * moments.xe[rows] @ weights + 2.0 * cross + (moments.xx[rows] @ weights) @ weights
        )

    def base_loss(self) -> Floats:
        """Return the cross-validated error power of the base alone, (blocks,), N^2."""
        losses = np.zeros(self.blocks)
        for fold in range(int(self.folds.max()) + 1):
            test = self.folds == fold
            losses[test] = self.loss(self.base_alone(~test), None, None, test)
        return losses

    def projected(self, moments: Moments) -> tuple[Floats, Floats]:
        """Return X'X and, for each block, X'e after the base's tangent is projected out: (c, c), (blocks, c)."""
        zz = self.zz.sum(0) + np.diag(self.penalty)
        zx = moments.zx.sum(0)
        through = np.linalg.solve(_stable(zz), zx)
        return moments.xx.sum(0) - zx.T @ through, moments.xe - self.ze @ through

    def flips(self, count: int) -> Floats:
        """Return random signs (count, blocks)."""
        rng = np.random.default_rng([self._seed, 7])
        return rng.choice([-1.0, 1.0], (count, self.blocks))


def folds_of(blocks: int, seed: int) -> Ints:
    """Return the fold of each block: of every `FOLDS` neighbours, each goes into another fold.

    >>> sorted(folds_of(8, 0).tolist())
    [0, 1, 2, 3, 4, 5, 6, 7]
    """
    count = min(FOLDS, blocks)
    rng = np.random.default_rng([seed, 3])
    order = np.concatenate([rng.permutation(count) for _ in range(-(-blocks // count))])
    return np.asarray(order[:blocks], np.int64)


def _stable(gram: Floats) -> Floats:
    """Return the matrix with its diagonal lifted by rounding's share."""
    diagonal = np.diag(gram)
    return gram + np.diag(1e-10 * diagonal + 1e-9 * float(diagonal.max()) * (diagonal < 1e-9 * diagonal.max()))


def constrained(inner: Floats, pull: Floats, energy: Floats, rule: Rule) -> tuple[Floats, float]:
    """Return coefficients within the rule, and the decrease of error power they bring.

    Parameters
    ----------
    inner : (c, c), projected X'X. pull : (c,), projected X'e. energy : (c,), diagonal of X'X before projection.
    """
    inner = inner + np.diag(RELATIVE_RIDGE * np.maximum(energy, 1e-300))
    if pull.size == 1:
        weight = float(pull[0] / inner[0, 0])
        if rule.signs[0] and weight * rule.signs[0] < 0.0:
            weight = 0.0
        if rule.near_one:
            weight = float(np.clip(weight, GAIN_LOW, GAIN_HIGH)) if weight > 0.0 else 0.0
        weights = np.array([weight])
    else:
        weights = np.linalg.solve(inner, pull)
    return weights, float(2.0 * pull @ weights - weights @ inner @ weights)


def null_maximum(
    evidence: Evidence, projections: Sequence[tuple[Floats, Floats]], rules: Sequence[Rule], count: int
) -> Floats:
    """Return the largest gain among hypotheses for each sign flip of the blocks, (count,), N^2.

    Parameters
    ----------
    projections : `Evidence.projected` of each hypothesis, from the residual without the best candidates' share.
    """
    signs = evidence.flips(count)
    best = np.zeros(count)
    for (left, pulls), rule in zip(projections, rules, strict=True):
        power = np.diag(left)
        if not power.size or not np.isfinite(left).all() or power.min() <= 0.0:
            continue
        scale = np.sqrt(power)
        values, vectors = np.linalg.eigh(left / np.outer(scale, scale))
        keep = values > 1e-6
        white = (signs @ (pulls / scale)) @ vectors[:, keep] / np.sqrt(values[keep])
        if rule.signs[0] and scale.size == 1:
            white = np.maximum(white * rule.signs[0] * np.sign(vectors[0, 0]), 0.0)
        best = np.maximum(best, np.square(white).sum(axis=1))
    return best
