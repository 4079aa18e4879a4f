"""Evidence for and against hypotheses: blocked cross-validation, family-wise gate, paired comparison.

Everything happens in the space of inner products, summed over blocks: with Z the base model's tangent, e its
residual and X the columns of a hypothesis, the joint refit of base and hypothesis on any set of blocks needs Z'Z, Z'e,
Z'X, X'X and X'e of those blocks only.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.lagged import block_edges
from friction_estimator.diagnosis.moments import Moments, Piece, Stack
from friction_estimator.diagnosis.tangent import Rows, piece_edges

FOLDS = 8
RELATIVE_RIDGE = 1e-7
"""Of a hypothesis' own energy: columns that the base explains to this share count as explained by it."""

GAIN_LOW, GAIN_HIGH = 0.4, 2.5
"""A hypothesis that is the whole change (a delay) must come out near coefficient one; its grid is coarse."""


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
    tangent : (n, q), an array or what makes it piece by piece. penalty : (q,), ridge. residual : (n,), N.
    used : (n,) bool. block : (n,) int, increasing. seed : of folds and bootstrap.
    """

    def __init__(self, tangent: Rows, penalty: Floats, residual: Floats, used: Bools, block: Ints, seed: int) -> None:
        self._edges = block_edges(block)
        self.blocks = self._edges.size - 1
        self.used = used
        self._tangent = tangent
        self.residual = residual * used
        self.penalty = penalty
        self.width = tangent.shape[1]
        self.zz = np.empty((self.blocks, self.width, self.width))
        self.ze = np.empty((self.blocks, self.width))
        for piece in self.pieces():
            self.zz[piece.blocks] = piece.by_block(piece.z, piece.z)
            self.ze[piece.blocks] = piece.by_block(piece.z, piece.e[:, None])[:, :, 0]
        self.ee = np.add.reduceat(np.square(self.residual), self._edges[:-1])
        self.samples = int(used.sum())
        self.folds = folds_of(self.blocks, seed)
        self._seed = seed
        self._solved: dict[bytes, tuple[Floats, Floats]] = {}

    def pieces(self) -> Iterator[Piece]:
        """Yield the record in pieces of whole blocks."""
        for first, last in piece_edges(self._edges):
            part = slice(int(self._edges[first]), int(self._edges[last]))
            used = self.used[part]
            z = self._tangent[part]
            edges = self._edges[first : last + 1] - self._edges[first]
            z = z if used.all() else z * used[:, None]
            yield Piece(slice(first, last), part, edges, z, self.residual[part], used)

    def moments(self, columns: Rows) -> Moments:
        """Return the inner products of columns (n, c), an array or what makes them piece by piece."""
        width = columns.shape[1]
        zx, xx = np.empty((self.blocks, self.width, width)), np.empty((self.blocks, width, width))
        xe = np.empty((self.blocks, width))
        for piece in self.pieces():
            x = piece.masked(columns[piece.part])
            zx[piece.blocks] = piece.by_block(piece.z, x)
            xx[piece.blocks] = piece.by_block(x, x)
            xe[piece.blocks] = piece.by_block(x, piece.e[:, None])[:, :, 0]
        return Moments(zx, xx, xe)

    def by_block(self, left: Floats, right: Floats) -> Floats:
        """Return the sum of left right over the samples in use of each block, (n,) and (n,): (blocks,)."""
        return np.add.reduceat(left * right * self.used, self._edges[:-1])

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
        return Fit(weights, alone - through @ weights, float(gain))

    def gains(self, stack: Stack, rule: Rule, rows: Bools | None = None) -> Floats:
        """Return the decrease of the error power that each hypothesis of a stack brings, (hypotheses,), N^2."""
        rows = np.ones(self.blocks, np.bool_) if rows is None else rows
        inverse, alone = self._known(rows)
        zx, xx, xe = (_summed(values, rows) for values in (stack.zx, stack.xx, stack.xe))
        through = np.tensordot(inverse, zx, 1)
        left = xx - np.einsum("qhc,qhd->hcd", zx, through)
        pull = xe - np.tensordot(alone, zx, 1)
        return np.asarray(constrained(left, pull, np.einsum("hcc->hc", xx), rule)[1])

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

    def projections(self, stack: Stack) -> list[tuple[Floats, Floats]]:
        """Return `projected` of each hypothesis of a stack."""
        zz = self.zz.sum(0) + np.diag(self.penalty)
        zx = stack.zx.sum(0)
        through = np.linalg.solve(_stable(zz), zx.reshape(self.width, -1)).reshape(zx.shape)
        left = stack.xx.sum(0) - np.einsum("qhc,qhd->hcd", zx, through)
        pulls = stack.xe - np.tensordot(self.ze, through, 1)
        return [(left[i], pulls[:, i]) for i in range(left.shape[0])]

    def with_residual(self, residual: Floats) -> "Evidence":
        """Return the evidence about another residual (n,) of the same model; products with it are formed anew."""
        other = copy(self)
        other.residual = residual * self.used
        other._solved = {}
        other.ze = np.empty_like(self.ze)
        for piece in other.pieces():
            other.ze[piece.blocks] = piece.by_block(piece.z, piece.e[:, None])[:, :, 0]
        other.ee = np.add.reduceat(np.square(other.residual), self._edges[:-1])
        return other

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


def _summed(values: Floats, rows: Bools) -> Floats:
    """Return the sum over the chosen blocks: one product with a vector, which copies nothing."""
    flat = rows.astype(np.float64) @ values.reshape(values.shape[0], -1)
    return np.asarray(flat.reshape(values.shape[1:]))


def constrained(left: Floats, pull: Floats, energy: Floats, rule: Rule) -> tuple[Floats, Floats]:
    """Return coefficients within the rule, and the decrease of error power they bring: (..., c), (...).

    Parameters
    ----------
    left : (..., c, c), projected X'X. pull : (..., c), projected X'e. energy : (..., c), diagonal of X'X before
        projection.
    """
    left = left + RELATIVE_RIDGE * np.maximum(energy, 1e-300)[..., None] * np.eye(pull.shape[-1])
    weights: Floats
    if pull.shape[-1] == 1:
        weights = pull / left[..., 0]
        if rule.signs[0]:
            weights = np.where(weights * rule.signs[0] < 0.0, 0.0, weights)
        if rule.near_one:
            weights = np.where(weights > 0.0, np.clip(weights, GAIN_LOW, GAIN_HIGH), 0.0)
    else:
        weights = np.asarray(np.linalg.solve(left, pull[..., None])[..., 0], np.float64)
    taken = (left @ weights[..., None])[..., 0]
    return weights, np.asarray(((2.0 * pull - taken) * weights).sum(axis=-1))


def null_maximum(signs: Floats, projections: Sequence[tuple[Floats, Floats]], rules: Sequence[Rule]) -> Floats:
    """Return the largest gain among hypotheses for each choice of the blocks' signs, (count,), N^2.

    Parameters
    ----------
    signs : (count, blocks), `Evidence.flips`.
    projections : `Evidence.projected` of each hypothesis, from the residual without the best candidates' share.
    """
    best = np.zeros(signs.shape[0])
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
