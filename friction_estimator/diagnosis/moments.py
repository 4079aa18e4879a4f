"""Inner products by block, and the pieces of a record over which they are summed."""

from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.products import inner


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
class Stack:
    """Inner products of several hypotheses with c columns each and one rule, by block.

    Attributes
    ----------
    zx : (blocks, q, hypotheses, c). xx : (blocks, hypotheses, c, c). xe : (blocks, hypotheses, c).
    """

    zx: Floats
    xx: Floats
    xe: Floats

    @classmethod
    def empty(cls, blocks: int, q: int, count: int, width: int) -> "Stack":
        """Return a stack to be filled."""
        return cls(
            np.empty((blocks, q, count, width)),
            np.empty((blocks, count, width, width)),
            np.empty((blocks, count, width)),
        )

    def __getitem__(self, i: int) -> Moments:
        return Moments(self.zx[:, :, i], self.xx[:, i], self.xe[:, i])


@dataclass(frozen=True)
class Piece:
    """Some whole blocks of a record.

    Attributes
    ----------
    blocks : their numbers. part : their samples. edges : (blocks + 1,), where they begin within the part.
    z : (n_part, q), tangent, zero where samples are masked. e : (n_part,), residual. used : (n_part,) bool.
    """

    blocks: slice
    part: slice
    edges: Ints
    z: Floats
    e: Floats
    used: Bools

    def masked(self, columns: Floats) -> Floats:
        """Return columns (n_part, c) with zeros where samples are masked."""
        return columns if self.used.all() else columns * self.used[:, None]

    def by_block(self, left: Floats, right: Floats) -> Floats:
        """Return left' right of each block, (blocks, p, q)."""
        pairs = zip(self.edges[:-1], self.edges[1:], strict=True)
        return np.array([inner(left[a:b], right[a:b]) for a, b in pairs])
