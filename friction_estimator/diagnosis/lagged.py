"""Products of the base model's lagged columns: with them every fit on any set of blocks costs no pass over the record.

The base model is linear in its lagged columns S_j(v[k - i]), with coefficients that are themselves products of few
parameters. Gram matrix and right side of all lagged columns are formed once, by block; Gauss-Newton steps, line
searches, starts and folds then work on small matrices only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Extra:
    """Products of further columns X (n, c) with the lagged columns M, with each other and with the force, by block.

    Attributes
    ----------
    mx : (blocks, L, c). xx : (blocks, c, c). xy : (blocks, c).
    """

    mx: Floats
    xx: Floats
    xy: Floats


class LaggedProducts:
    """Lagged columns of a record and their products, by block.

    Parameters
    ----------
    static : (n, m), columns S_j(v[k]). order : largest lag p. friction_N : (n,). used, restart : (n,) bool.
    block : (n,) int, increasing. chosen : (blocks,) bool, blocks whose products are formed, the others' are zero
        (default all).

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
        chosen: Bools | None = None,
    ) -> None:
        self.static, self.order = static, order
        self.width = static.shape[1]
        self.size = self.width * (order + 1)
        self.start = piece_starts(restart)
        self.edges = block_edges(block)
        self._used = used
        self._force = friction_N * used
        blocks = self.edges.size - 1
        self._chosen = np.arange(blocks) if chosen is None else np.flatnonzero(chosen)
        self.gram = np.zeros((blocks, self.size, self.size))
        self.cross = np.zeros((blocks, self.size))
        for b in self._chosen:
            rows = slice(self.edges[b], self.edges[b + 1])
            m = self.rows(rows) * used[rows, None]
            self.gram[b] = inner(m, m)
            self.cross[b] = m.T @ self._force[rows]
        self.whole_gram = self.gram.sum(axis=0)
        self.power = np.add.reduceat(np.square(self._force), self.edges[:-1])
        self.count = np.add.reduceat(used.astype(np.float64), self.edges[:-1])

    def rows(self, part: slice) -> Floats:
        """Return the lagged columns of some samples, (n_part, L)."""
        index = np.arange(part.start, part.stop)
        start = self.start[part]
        return np.concatenate([self.static[np.maximum(index - i, start)] for i in range(self.order + 1)], axis=1)

    def extra(self, columns: Floats) -> Extra:
        """Return the products of columns (n, c)."""
        blocks, width = self.edges.size - 1, columns.shape[1]
        mx, xx = np.zeros((blocks, self.size, width)), np.zeros((blocks, width, width))
        xy = np.zeros((blocks, width))
        for b in self._chosen:
            rows = slice(self.edges[b], self.edges[b + 1])
            x = columns[rows] * self._used[rows, None]
            mx[b] = inner(self.rows(rows), x)
            xx[b] = inner(x, x)
            xy[b] = x.T @ self._force[rows]
        return Extra(mx, xx, xy)

    def combine(self, coefficients: Floats, part: slice = slice(None)) -> Floats:
        """Return the lagged columns times coefficients (L,) or (L, q), for some samples: (n_part,) or (n_part, q)."""
        index = np.arange(self.static.shape[0])[part]
        start = self.start[part]
        out = np.zeros((index.size, *coefficients.shape[1:]))
        for i, own in enumerate(coefficients.reshape(self.order + 1, self.width, *coefficients.shape[1:])):
            some = np.any(own, axis=0)  # most columns have a part in few lags
            if np.any(some):
                moved = self.static[np.maximum(index - i, start)]
                if own.ndim == 1:
                    out += moved @ own
                else:
                    out[:, some] += moved @ own[:, some]
        return out


def total(blocks: NDArray[np.float64], rows: Bools | None) -> Floats:
    """Return the sum over the chosen blocks (default all)."""
    return np.asarray(blocks.sum(axis=0) if rows is None else blocks[rows].sum(axis=0))
