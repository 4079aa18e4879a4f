"""Numbers that come piece by piece, as many as nobody knows beforehand."""

from mmap import mmap
from typing import cast

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Ints

SMALLEST = 1 << 14
"""Numbers in the first block; each following one is as large as all before it."""

LARGEST_BYTES = 1 << 25
"""A block beyond this many is not made: so little is asked for in vain."""


class Column:
    """Numbers of one kind, in blocks: nothing is copied until all are there.

    Each block is asked of the system by itself: it goes back there when it is let go, whatever lies beside it, where
    the C library would keep what may come to a quarter of the numbers.
    """

    def __init__(self, kind: type[np.generic]) -> None:
        self._kind = np.dtype(kind)
        self._blocks: list[NDArray[np.generic]] = []
        self._filled = self._before = 0

    def extend(self, values: NDArray[np.generic]) -> None:
        """Take more."""
        while values.size:
            if not self._blocks or self._filled == self._blocks[-1].size:
                self._before += self._filled
                size = min(max(SMALLEST, self._before), LARGEST_BYTES // self._kind.itemsize)
                self._blocks.append(np.frombuffer(mmap(-1, size * self._kind.itemsize), self._kind))
                self._filled = 0
            block = self._blocks[-1]
            fits, values = values[: block.size - self._filled], values[block.size - self._filled :]
            block[self._filled : self._filled + fits.size] = fits
            self._filled += fits.size

    def taken(self) -> NDArray[np.generic]:
        """Return all of them; nothing is left here."""
        blocks, filled = self._blocks, self._filled
        self._blocks, self._filled, self._before = [], 0, 0
        if blocks:
            blocks[-1] = blocks[-1][:filled]
        return np.concatenate(blocks) if blocks else np.empty(0, self._kind)


class WholeNumbers:
    """Whole numbers about the first one: four bytes each as long as they lie near it."""

    def __init__(self) -> None:
        self.first: int | None = None
        self._narrow = True
        self._column = Column(np.int32)

    def extend(self, values: Ints) -> None:
        """Take more."""
        if not values.size:
            return
        self.first = int(values[0]) if self.first is None else self.first
        apart = values - self.first
        ends = np.iinfo(np.int32)
        if self._narrow and not (ends.min < int(apart.min()) and int(apart.max()) < ends.max):
            former, self._column, self._narrow = self._column.taken(), Column(np.int64), False
            self._column.extend(former)
        self._column.extend(apart)

    def taken(self) -> NDArray[np.signedinteger]:
        """Return all of them less the first one; nothing is left here."""
        return cast("NDArray[np.signedinteger]", self._column.taken())
