"""Products of the base model's lagged columns: with them every fit on any set of blocks costs no pass over the record.

The base model is linear in its lagged columns S_j(v[k - i]), with coefficients that are themselves products of few
parameters. Gram matrix and right side of all lagged columns are formed once, by block; Gauss-Newton steps, line
searches, starts and folds then work on small matrices only.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.products import inner


def piece_starts(restart: Bools) -> Ints:
    """Return for each sample the index at which its gap-free piece begins, (n,)."""
    return np.asarray(np.maximum.accumulate(np.where(restart, np.arange(restart.size), 0)), np.int64)


def lagged(values: Floats, lag: int, start: Ints) -> Floats:
    """Return values[k - lag], held at the first value of the gap-free piece; `start` is its first index."""
    return np.asarray(values[np.maximum(np.arange(values.shape[0]) - lag, start)])


def block_edges(block: Ints) -> Ints:
    """Return the first sample of each block and the number of samples, (blocks + 1,); `block` increases."""
    return np.concatenate([np.flatnonzero(np.diff(block, prepend=-1)), [block.size]])


def force(static: Floats, start: Ints, weights: Floats, taps: Floats, own: Floats) -> Floats:
    """Return f = sum_i h_i S w[k - i] + sum_i c_i (S_0[k - i] - S_0[k]) with h_0 = 1, (n,).

    Parameters
    ----------
    static : S, (n, m). start : of each sample's gap-free piece, (n,). weights : w, (m,). taps : h_1 ..., (p,).
    own : c_1 ..., (p,) or empty: lags of the first column alone.
    """
    out = np.empty(start.size)
    _remembered(static @ weights, np.ascontiguousarray(static[:, 0]), start, taps, own, out)
    return out


@dataclass(frozen=True)
class Extra:
    """Products of further columns X (n, c) with the lagged columns M, with each other and with the force, by block.

    Attributes
    ----------
    mx : (blocks, L, c). xx : (blocks, c, c). xy : (blocks, c).
    known : (c,), what is known before of their coefficients: the inverse of the prior's variance.
    """

    mx: Floats
    xx: Floats
    xy: Floats
    known: Floats

    def __getitem__(self, columns: slice | Bools, /) -> "Extra":
        """Return the products of some of the columns."""
        xx = self.xx[:, columns][:, :, columns]
        return Extra(self.mx[:, :, columns], xx, self.xy[:, columns], self.known[columns])


class LaggedProducts:
    """Lagged columns of a record and their products, by block.

    Parameters
    ----------
    static : (n, m), columns S_j(v[k]). order : largest lag p. friction_N : (n,). used, restart : (n,) bool.
    block : (n,) int, increasing.

    Attributes
    ----------
    gram : (blocks, L, L), L = (p + 1) m, lag by lag; whole_gram : its sum. cross : (blocks, L). power : (blocks,).
    count : (blocks,).
    """

    def __init__(
        self,
        static: Floats,
        order: int,
        friction_N: Floats,
        used: Bools,
        restart: Bools,
        block: Ints,
    ) -> None:
        self.order = order
        self.start = piece_starts(restart)
        self.edges = block_edges(block)
        self._used = used
        self._force = friction_N * used
        self.power = np.add.reduceat(np.square(self._force), self.edges[:-1])
        self.count = np.add.reduceat(used.astype(np.float64), self.edges[:-1])
        self._form(static, None)

    def of(self, static: Floats, chosen: Bools | None = None) -> "LaggedProducts":
        """Return those of other columns of the same record; all else is shared.

        Parameters
        ----------
        chosen : (blocks,) bool, blocks whose products are formed, the others' are zero (default all).
        """
        other = copy(self)
        other._form(static, chosen)
        return other

    def _form(self, static: Floats, chosen: Bools | None) -> None:
        self.static = static
        self.width = static.shape[1]
        self.size = self.width * (self.order + 1)
        blocks = self.edges.size - 1
        self._chosen = np.arange(blocks) if chosen is None else np.flatnonzero(chosen)
        self.gram = np.zeros((blocks, self.size, self.size))
        self.cross = np.zeros((blocks, self.size))
        for b in self._chosen:
            begin, end = self.edges[b : b + 2]
            add_products(static, self.start, begin, end, self._used, self._force, self.gram[b], self.cross[b])
        self.whole_gram = self.gram.sum(axis=0)

    def rows(self, part: slice) -> Floats:
        """Return the lagged columns of some samples, (n_part, L); zero where a sample is not in use."""
        out = np.zeros((part.stop - part.start, self.size))
        stacked(self.static, self.start, part.start, self._used, out)
        return out

    def extra(self, columns: Sequence[Floats]) -> Extra:
        """Return the products of columns, (n, c) in all."""
        blocks, width = self.edges.size - 1, sum(c.shape[1] for c in columns)
        mx, xx = np.zeros((blocks, self.size, width)), np.zeros((blocks, width, width))
        xy = np.zeros((blocks, width))
        for b in self._chosen:
            rows = slice(self.edges[b], self.edges[b + 1])
            x = np.concatenate([c[rows] for c in columns], axis=1) * self._used[rows, None]
            mx[b] = inner(self.rows(rows), x)
            xx[b] = inner(x, x)
            xy[b] = x.T @ self._force[rows]
        return Extra(mx, xx, xy, np.zeros(width))

    def tied(self, found: Extra) -> tuple["LaggedProducts", Extra]:
        """Return the products with one column more, without a lag, added to each static column at every lag.

        The sum of a static column's coefficients over the lags is what it has in steady motion: so is the coefficient
        of the column that is added to it.

        Parameters
        ----------
        found : products of these columns, (n, m), and of further ones, (n, c). Those of the further ones are returned.
        """
        m, lags = self.width, self.order + 1
        to, rest = found[:m], found[m:]
        across = np.tile(to.mx, (1, 1, lags))
        other = copy(self)
        other.gram = self.gram + across + across.transpose(0, 2, 1) + np.tile(to.xx, (1, lags, lags))
        other.cross = self.cross + np.tile(to.xy, (1, lags))
        other.whole_gram = other.gram.sum(axis=0)
        return other, replace(rest, mx=rest.mx + np.tile(found.xx[:, :m, m:], (1, lags, 1)))

    def fitted(self, weights: Floats, taps: Floats, own: Floats) -> Floats:
        """Return the force of the base model with these parameters, (n,), N: see `force`."""
        return force(self.static, self.start, weights, taps, own)

    def derivative(self, weights: Floats, taps: Floats, own: int, part: slice = slice(None)) -> Floats:
        """Return d `fitted` / d (weights, taps, own lags) for some samples, (n_part, m + p + own).

        The column of a tap is S w[k - i] - S w[k]: it changes no static gain, which the weights do already.
        """
        m = self.width
        begin, end, _ = part.indices(self.start.size)
        # No lag reaches farther back than the order: the force of other samples is not needed.
        reach = slice(max(0, begin - self.order), end)
        force, first = self.static[reach] @ weights, np.ascontiguousarray(self.static[reach, 0])
        out = np.zeros((end - begin, m + taps.size + own))
        filtered(self.static, self.start, begin, np.concatenate([[1.0], taps]), out)
        ago(force, self.start, reach.start, begin, out[:, m : m + taps.size])
        ago(first, self.start, reach.start, begin, out[:, m + taps.size :])
        return out


@njit(cache=True)
def add_products(static, start, begin, end, used, force, gram, cross):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add the products of all lagged columns, over the samples in use of begin ... end - 1, to (L, L) and (L,).

    Only those with the columns of lag 0 are summed over the samples. Those of lags i + 1 and j + 1 are the products of
    lags i and j, a sample earlier: they differ by the samples where the block, a gap-free piece or what is in use
    begins or ends. So the cost is n m L instead of n L^2, as for the sparse rows
    of `core.fit.moments.gather`, which leave out what follows a gap. What ends there is subtracted: a value 1e4 times
    the usual costs five digits, one of 1e6 nine.
    """
    width = static.shape[1]
    lags = cross.size // width
    flat = static.ravel()
    # The last lag first, as the columns of the samples before a sample lie in memory: one long loop for all lags.
    onto, pulled = np.zeros((width, cross.size)), np.zeros(cross.size)
    held = np.zeros(cross.size)
    for k in range(begin, end):
        if not used[k]:
            continue
        row = flat[(k + 1 - lags) * width : (k + 1) * width]
        if k + 1 - lags < start[k]:
            for i in range(lags):
                back = max(k - i, start[k])
                held[(lags - 1 - i) * width : (lags - i) * width] = static[back]
            row = held
        for c in range(row.size):
            pulled[c] += force[k] * row[c]
        for j in range(width):
            value = static[k, j]
            if value != 0.0:  # a spline is, nearly everywhere
                for c in range(row.size):
                    onto[j, c] += value * row[c]
    for i in range(lags):
        last = slice((lags - 1 - i) * width, (lags - i) * width)
        cross[i * width : (i + 1) * width] += pulled[last]
        gram[:width, i * width : (i + 1) * width] += onto[:, last]
    for k in range(begin - 1, end):
        # Sample k as one of lag i + 1 of the next sample, less itself as one of lag i.
        earlier = k + 1 < end and start[k + 1] <= k and used[k + 1]
        own = k >= begin and used[k]
        if earlier != own:
            _add_lagged(static, k, start[k], 1.0 if earlier else -1.0, lags, gram)
        if k >= begin and start[k] == k and used[k]:  # where a piece begins, all lags hold its first value
            _add_lagged(static, k, k, 1.0, lags, gram)
    for row in range(width, cross.size):
        for column in range(row, cross.size):
            gram[row, column] += gram[row - width, column - width]
    for row in range(cross.size):
        for column in range(row):
            gram[row, column] = gram[column, row]


@njit(cache=True)
def _add_lagged(static, k, start, weight, lags, gram):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add weight static[k - i]' static[k - j] to the products of lags i + 1 and j + 1, where j >= i."""
    width = static.shape[1]
    for i in range(lags - 1):
        left = max(k - i, start)
        for a in range(width):
            value = weight * static[left, a]
            if value != 0.0:
                for j in range(i, lags - 1):
                    right = max(k - j, start)
                    for c in range(width):
                        gram[(i + 1) * width + a, (j + 1) * width + c] += value * static[right, c]


@njit(cache=True)
def stacked(static, start, begin, used, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Write static[k - i, j] to out[k - begin, i m + j] for samples in use, held as in `filtered`."""
    width = static.shape[1]
    for k in range(out.shape[0]):
        if used[begin + k]:
            for i in range(out.shape[1] // width):
                back = max(begin + k - i, start[begin + k])
                for j in range(width):
                    out[k, i * width + j] = static[back, j]


@njit(cache=True)
def ago(values, start, begin, first, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Write values[k - i - 1] - values[k] to out[k - first, i], held as in `filtered`; `values` are from `begin` on."""
    for k in range(first, first + out.shape[0]):
        for i in range(out.shape[1]):
            out[k - first, i] = values[max(k - i - 1, start[k]) - begin] - values[k - begin]


@njit(cache=True)
def _remembered(through, first, start, taps, own, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `out`, (n,), with `force` of static forces and first columns, (n,) each."""
    for k in range(out.size):
        total = through[k]
        for i in range(taps.size):
            total += taps[i] * through[max(k - i - 1, start[k])]
        for i in range(own.size):
            total += own[i] * (first[max(k - i - 1, start[k])] - first[k])
        out[k] = total


@njit(cache=True)
def filtered(static, start, begin, lags, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add sum_i lags[i] static[k - i, j] to out[k - begin, j], held at the first value of each gap-free piece."""
    for k in range(out.shape[0]):
        for i in range(lags.size):
            back = max(begin + k - i, start[begin + k])
            for j in range(static.shape[1]):
                out[k, j] += lags[i] * static[back, j]


def total(blocks: NDArray[np.float64], rows: Bools | None) -> Floats:
    """Return the sum over the chosen blocks (default all)."""
    return np.asarray(blocks.sum(axis=0) if rows is None else blocks[rows].sum(axis=0))
