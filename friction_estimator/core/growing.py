"""Numbers that come piece by piece, as many as nobody knows beforehand."""

from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Ints

SMALLEST = 1 << 14
"""Numbers that there is room for at first; from then on room is doubled."""

LARGEST_BYTES = 1 << 25
"""Room for more than these is not made at once: so little is asked for in vain."""


class Column:
    """Numbers of one kind, in one piece that grows: the system moves its pages, no number is copied.

    The piece is asked of the system by itself: it goes back there when it is let go, whatever lies beside it, where
    the C library would keep what may come to a quarter of the numbers.
    """

    def __init__(self, kind: type[np.generic]) -> None:
        self._kind = np.dtype(kind)
        self._pages: mmap | None = None
        self._room = self._filled = 0

    def __len__(self) -> int:
        return self._filled

    def extend(self, values: NDArray[np.generic]) -> None:
        """Take more."""
        if not values.size:
            return
        end = self._filled + values.size
        self._make_room(end)
        # No view outlives the statement: pages that somebody looks at cannot be moved.
        np.frombuffer(self._pages, self._kind, self._room)[self._filled : end] = values  # type: ignore[arg-type]
        self._filled = end

    def copied(self, part: slice) -> NDArray[Any]:
        """Return a part of them, in an array of its own."""
        whole = np.empty(0, self._kind) if self._pages is None else np.frombuffer(self._pages, self._kind, self._filled)
        return whole[part].copy()

    def _make_room(self, count: int) -> None:
        while self._room < count:
            self._room += min(max(SMALLEST, self._room), max(1, LARGEST_BYTES // self._kind.itemsize))
        size = self._room * self._kind.itemsize
        if self._pages is None:
            self._pages = mmap(-1, size, flags=MAP_PRIVATE | MAP_ANONYMOUS)
        elif len(self._pages) < size:
            self._pages.resize(size)

    def taken(self) -> NDArray[Any]:
        """Return all of them; nothing is left here."""
        pages, filled = self._pages, self._filled
        self._pages, self._room, self._filled = None, 0, 0
        return np.empty(0, self._kind) if pages is None else np.frombuffer(pages, self._kind, filled)


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
