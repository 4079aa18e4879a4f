"""Numbers over a record that are looked at part by part, in memory or formed when they are wanted.

A record of hours has room in memory for its samples and what was predicted, not for each number that a figure makes of
them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Protocol

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.sample import NS_PER_S, Floats, Ints

USUAL = 0.999
"""Share of the numbers that are of usual size: the others may be spikes."""


class Series(Protocol):
    """One number a sample, (n,): an array, or what gives parts of one."""

    @property
    def size(self) -> int:
        """How many there are."""

    def __getitem__(self, part: slice, /) -> Floats:
        """Return those of a part without steps, as an array."""


@dataclass(frozen=True)
class Formed:
    """Numbers that are formed when a part of them is asked for.

    Attributes
    ----------
    size : how many there are. of : forms those of a part, whose begin and end are given.

    Examples
    --------
    >>> Formed(10, lambda part: 2.0 * np.arange(part.start, part.stop))[-3:].tolist()
    [14.0, 16.0, 18.0]
    """

    size: int
    of: Callable[[slice], Floats]

    def __getitem__(self, part: slice, /) -> Floats:
        begin, end, _ = part.indices(self.size)
        return self.of(slice(begin, max(begin, end)))


class RunningTime:
    """Time since the first sample of a record, (n,), s, without the jumps of its clock.

    Parameters
    ----------
    stamp_ns : (n,). Steps back count as none.
    starts : index of the first sample of each recording; each follows the one before after `usual_ns`.

    Examples
    --------
    >>> RunningTime(np.array([7, 8, 3, 5]) * NS_PER_S)[:].tolist()
    [0.0, 1.0, 1.0, 3.0]
    """

    def __init__(self, stamp_ns: Ints, starts: Sequence[int] = (0,), usual_ns: int = 0) -> None:
        self._stamp_ns, self._joints, self._usual_ns = stamp_ns, np.asarray(starts[1:], np.int64), usual_ns
        self.size = stamp_ns.size
        blocks = (int(self._steps(part).sum()) for part in sums.parts(self.size))
        self._before_ns = [*accumulate(blocks, initial=0)]

    def _steps(self, part: slice) -> Ints:
        """Return the steps that lead to the samples of a part, ns."""
        begin, end = part.start, part.stop
        before = max(0, begin - 1)
        step: Ints = np.diff(self._stamp_ns[begin:end], prepend=self._stamp_ns[before : before + 1])
        step[step < 0] = 0
        step[self._joints[(self._joints >= begin) & (self._joints < end)] - begin] = self._usual_ns
        return step

    def __getitem__(self, part: slice, /) -> Floats:
        begin, end, _ = part.indices(self.size)
        end = max(begin, end)
        block = begin // sums.BLOCK
        known = block * sums.BLOCK
        passed = np.cumsum(self._steps(slice(known, end)))[begin - known :]
        return np.asarray((self._before_ns[block] + passed) / NS_PER_S, np.float64)


def pieces(series: Series) -> Iterator[Floats]:
    """Yield the numbers block by block."""
    return (series[part] for part in sums.parts(series.size))


def one(series: Series, place: int) -> float:
    """Return the number at a place."""
    return float(series[place : place + 1][0])


def difference(minuend: Series, subtrahend: Series) -> Formed:
    """Return one series less another one.

    >>> difference(np.arange(3.0), np.ones(3))[:].tolist()
    [-1.0, 0.0, 1.0]
    """
    return Formed(minuend.size, lambda part: minuend[part] - subtrahend[part])


def at(series: Series, places: Ints | Sequence[int]) -> Floats:
    """Return the numbers at some places, (m,), which are in order.

    >>> at(np.arange(5.0), np.array([1, 3])).tolist()
    [1.0, 3.0]
    """
    places, found = np.asarray(places, np.int64), [np.empty(0)]
    for part in sums.parts(series.size):
        first, last = np.searchsorted(places, [part.start, part.stop])
        if last > first:
            found.append(series[part][places[first:last] - part.start])
    return np.concatenate(found)


def sizes(series: Series) -> Formed:
    """Return the numbers without their signs."""
    return Formed(series.size, lambda part: np.abs(series[part]))


def upper_quantile(series: Series, q: float) -> float:
    """Return a quantile near 1 of all of them: `np.quantile` of them as one array, to the bit."""
    return sums.upper_quantile(pieces(series), series.size, q)


def usual_size(series: Series) -> float:
    """Return the largest size but for rare spikes; 0 where all but these are 0."""
    return upper_quantile(sizes(series), USUAL)


def ends(series: Series) -> tuple[float, float]:
    """Return the lowest and the highest of them; NaN is passed over, and where there are none, NaN is returned."""
    found = [(np.fmin.reduce(piece), np.fmax.reduce(piece)) for piece in pieces(series)]
    low, high = np.array(found or [(np.nan, np.nan)]).T
    return float(np.fmin.reduce(low)), float(np.fmax.reduce(high))
