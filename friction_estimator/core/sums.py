"""Sums over a long record, piece by piece and to the bit what numpy gives of the whole.

numpy adds in pairs (Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., section 4.1): the first half of an
array, its length rounded down to a multiple of 8, then the rest. Here the same halves are taken of values that are made
when they are wanted, so that a squared error over a record needs no array of its length.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from friction_estimator.core.sample import Bools, Floats

BLOCK = 65_536
"""Samples of a piece: they stay in the processor's cache."""

LEAF = BLOCK
"""Values that are handed to numpy at a time: more than the 128 below which it adds otherwise."""


def parts(n: int, block: int = BLOCK) -> Iterator[slice]:
    """Yield the pieces of a record of n samples, in order."""
    for start in range(0, n, block):
        yield slice(start, min(start + block, n))


class Total:
    """The sum of n values that are told in pieces of any length: `np.sum` of them as one array, to the bit.

    Raises ValueError where more are told, and where the sum is asked for before all are.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(100_001)
    >>> total = Total(x.size)
    >>> for part in parts(x.size, 777):
    ...     total.add(x[part])
    >>> bool(total.value == np.sum(x))
    True
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._leaves = _leaves(n)
        self._wanted = next(self._leaves)
        self._held: list[Floats] = []
        self._count = 0
        self._sums: list[float] = []

    def add(self, values: Floats) -> None:
        """Take the next values."""
        while values.size:
            if not self._wanted:
                raise ValueError(f"more than {self._n} values are told")
            taken = values[: self._wanted - self._count]
            values = values[taken.size :]
            self._held.append(taken)
            self._count += taken.size
            if self._count == self._wanted:
                whole = self._held[0] if len(self._held) == 1 else np.concatenate(self._held)
                self._sums.append(float(np.add.reduce(whole)))
                self._held, self._count = [], 0
                self._wanted = next(self._leaves, 0)

    @property
    def value(self) -> float:
        """The sum, once all values are told."""
        if self._wanted:
            raise ValueError(f"fewer than {self._n} values are told")
        sums = iter(self._sums)

        def added(count: int) -> float:
            if count <= LEAF:
                return next(sums) if count else 0.0
            half = _half(count)
            first = added(half)
            return first + added(count - half)

        return added(self._n)


def _half(count: int) -> int:
    half = count // 2
    return half - half % 8


def _leaves(count: int) -> Iterator[int]:
    """Yield the lengths of the pieces that numpy is handed, in order."""
    if count <= LEAF:
        yield count
        return
    half = _half(count)
    yield from _leaves(half)
    yield from _leaves(count - half)


def total(pieces: Iterable[Floats], n: int) -> float:
    """Return the sum of n values that come in pieces of any length: `np.sum` of them as one array, to the bit.

    >>> x = np.random.default_rng(0).standard_normal(100_001)
    >>> bool(total((x[part] for part in parts(x.size, 777)), x.size) == np.sum(x))
    True
    """
    found = Total(n)
    for piece in pieces:
        found.add(piece)
    return found.value


def mean_square(piece: Callable[[slice], Floats], n: int) -> float:
    """Return the mean of the squares of n values, `piece` giving those of a part."""
    return total((np.square(piece(part)) for part in parts(n)), n) / n


def chosen(values: Floats, where: Bools) -> Iterator[Floats]:
    """Yield the values, (n,), at which `where` is True, piece by piece."""
    for part in parts(values.size):
        yield some(values[part], where[part])


def some(values: Floats, where: Bools) -> Floats:
    """Return the values, (n,), at which `where` is True; those themselves where all are, as in most pieces."""
    return values if where.all() else values[where]


def median_size(pieces: Callable[[], Iterable[Floats]]) -> float:
    """Return the median of values of at least 0 that come in pieces, again at each call: `np.median`, to the bit.

    The bits of such values are in the order of the values: sixteen of them at a time, those of the middle value are
    found by counting. Nothing of the record's length is kept. NaN of none.

    >>> x = np.abs(np.random.default_rng(0).standard_normal(10_000))
    >>> median_size(lambda: (x[part] for part in parts(x.size, 777))) == float(np.median(x))
    True
    """
    n = sum(piece.size for piece in pieces())
    if not n:
        return float("nan")
    prefix, rank = 0, (n - 1) // 2
    for shift in (48, 32, 16, 0):
        counts = np.zeros(1 << 16, np.int64)
        for piece in pieces():
            bits = piece.view(np.uint64) >> np.uint64(shift)
            if shift < 48:
                bits = bits[bits >> np.uint64(16) == prefix]
            counts += np.bincount((bits & np.uint64(0xFFFF)).astype(np.int64), minlength=counts.size)
        upto = np.cumsum(counts)
        found = int(np.searchsorted(upto, rank, side="right"))
        rank -= int(upto[found - 1]) if found else 0
        prefix = prefix << 16 | found
    middle = float(np.array([prefix], np.uint64).view(np.float64)[0])
    if n % 2 or rank + 1 < counts[found]:
        return middle
    above = min(float(rest.min()) for piece in pieces() if (rest := piece[piece > middle]).size)
    return float(np.mean([middle, above]))


def upper_quantile(pieces: Iterable[Floats], n: int, q: float) -> float:
    """Return a quantile near 1 of n values that come in pieces: `np.quantile` of them as one array, to the bit.

    Only the largest values are kept, (1 - q) n of them and four times as many at most.

    >>> x = np.random.default_rng(0).standard_normal(10_001)
    >>> upper_quantile((x[part] for part in parts(x.size, 777)), x.size, 0.99) == float(np.quantile(x, 0.99))
    True
    """
    place = q * (n - 1)
    wanted = n - int(place)
    largest, least = np.empty(0), -np.inf
    for piece in pieces:
        largest = np.concatenate([largest, piece[piece > least]])
        if largest.size > 4 * wanted + BLOCK:
            largest = np.partition(largest, largest.size - wanted)[-wanted:]
            least = float(largest[0])
    largest.sort()
    low, high = float(largest[-wanted]), float(largest[min(1 - wanted, -1)])
    share = place - int(place)
    step = high - low
    return high - step * (1.0 - share) if share >= 0.5 else low + step * share
