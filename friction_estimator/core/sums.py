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


def total(pieces: Iterable[Floats], n: int) -> float:
    """Return the sum of n values that come in pieces of any length: `np.sum` of them as one array, to the bit.

    >>> x = np.random.default_rng(0).standard_normal(100_001)
    >>> bool(total((x[part] for part in parts(x.size, 777)), x.size) == np.sum(x))
    True
    """
    values = _Taken(pieces)

    def added(count: int) -> float:
        if count <= LEAF:
            return float(np.add.reduce(values.next(count)))
        half = count // 2
        half -= half % 8
        first = added(half)
        return first + added(count - half)

    return added(n)


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


class _Taken:
    """Hands out values in pieces of the lengths that are asked for."""

    def __init__(self, pieces: Iterable[Floats]) -> None:
        self._pieces = iter(pieces)
        self._rest = np.empty(0)

    def next(self, count: int) -> Floats:
        """Return the next values, as one array."""
        found, held = [self._rest], self._rest.size
        while held < count:
            found.append(next(self._pieces))
            held += found[-1].size
        whole = found[-1] if held == found[-1].size else np.concatenate(found)
        self._rest = whole[count:]
        return whole[:count]
