"""Streams of a recording merged into recorded order, whole or piece by piece as they are read."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core import sums
from friction_estimator.core.intake.pairing import STREAMS
from friction_estimator.core.sample import Floats, Ints

TIE_ORDER = ("pressure", "temperature", "position", "velocity", "friction")
"""Order of messages recorded at the same time: what a sample needs comes before what completes it."""


@dataclass(frozen=True)
class Events:
    """Messages of all inputs as they were recorded, each (n,): `stream` indexes `pairing.STREAMS`."""

    stream: NDArray[np.int8]
    stamp_ns: Ints
    log_time_ns: Ints
    value: Floats

    def __len__(self) -> int:
        return int(self.value.size)

    def of(self, name: str) -> "Part":
        """Return the messages of one input."""
        return Part(self.stamp_ns, self.log_time_ns, self.value).where(self.stream == STREAMS.index(name))


@dataclass(frozen=True)
class Part:
    """Some messages of one input, in the order of the file, each (n,): stamp, time of recording, value in SI units."""

    stamp_ns: Ints
    log_time_ns: Ints
    value: Floats

    def __len__(self) -> int:
        return int(self.value.size)

    def where(self, chosen: NDArray[np.bool_]) -> "Part":
        """Return some of them."""
        return Part(self.stamp_ns[chosen], self.log_time_ns[chosen], self.value[chosen])


class OutOfOrderError(ValueError):
    """A message was recorded before those that were handed on as the earlier ones."""


class Merge:
    """Messages of several inputs, handed on in recorded order as soon as nothing earlier can come.

    At equal times held channels come first, then velocity, then friction; within an input the order is the file's.

    Parameters
    ----------
    names : the inputs.

    Attributes
    ----------
    count : messages that wait.

    Examples
    --------
    >>> merge = Merge(["friction", "velocity"])
    >>> merge.add("friction", Part(np.array([7]), np.array([5]), np.array([3.0])))
    >>> merge.add("velocity", Part(np.array([7, 8]), np.array([5, 9]), np.array([0.1, 0.2])))
    >>> merge.before(9).value.tolist(), merge.before(10).value.tolist()
    ([0.1, 3.0], [0.2])
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._waiting: dict[str, list[Part]] = {name: [] for name in TIE_ORDER if name in names}
        self._handed_on_ns: int | None = None
        self.count = 0

    def add(self, name: str, part: Part) -> None:
        """Take messages of one input.

        Raises OutOfOrderError where some were recorded before what has been handed on.
        """
        if self._handed_on_ns is not None and len(part) and int(part.log_time_ns.min()) < self._handed_on_ns:
            raise OutOfOrderError
        self._waiting[name].append(part)
        self.count += len(part)

    def before(self, log_time_ns: int) -> Events:
        """Return what waits and was recorded before a time; nothing from before it is taken afterwards."""
        self._handed_on_ns = max(log_time_ns, self._handed_on_ns or log_time_ns)
        ready: dict[str, Part] = {}
        for name, parts in self._waiting.items():
            whole = joined(parts)
            early = whole.log_time_ns < log_time_ns
            ready[name] = whole if early.all() else whole.where(early)
            self._waiting[name] = [] if early.all() else [whole.where(~early)]
            self.count -= len(ready[name])
        return merged(ready)


def joined(parts: Sequence[Part]) -> Part:
    """Return parts of one input as one."""
    if len(parts) == 1:
        return parts[0]
    nothing = Part(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    found = parts or [nothing]
    return Part(
        np.concatenate([part.stamp_ns for part in found]),
        np.concatenate([part.log_time_ns for part in found]),
        np.concatenate([part.value for part in found]),
    )


def merged(parts: dict[str, Part]) -> Events:
    """Return the messages of all inputs in recorded order, those of equal time in the order of `TIE_ORDER`."""
    names = [name for name in TIE_ORDER if name in parts]
    found = [parts[name] for name in names]
    order = recorded_order(*(part.log_time_ns for part in found))
    number = [np.full(len(part), STREAMS.index(name), np.int8) for name, part in zip(names, found, strict=True)]
    whole = joined(found)
    return Events(np.concatenate(number)[order], whole.stamp_ns[order], whole.log_time_ns[order], whole.value[order])


def recorded_order(*log_times_ns: Ints) -> NDArray[np.intp]:
    """Return the order that merges streams by time of recording.

    The indices are into the concatenated streams. Ties keep the order of the arguments, and the order within a
    stream.

    >>> recorded_order(np.array([1, 5]), np.array([1, 3])).tolist()
    [0, 2, 3, 1]
    """
    return np.argsort(np.concatenate(log_times_ns), kind="stable")


def in_order(log_time_ns: Ints) -> bool:
    """Return whether nothing was recorded before what stands ahead of it."""
    pieces = (log_time_ns[part.start : part.stop + 1] for part in sums.parts(log_time_ns.size))
    return all(bool((piece[1:] >= piece[:-1]).all()) for piece in pieces)


def merged_parts(log_times_ns: Sequence[Ints], block: int) -> Iterator[list[slice]]:
    """Yield parts of streams that are in order each, such that nothing of a later part comes before a former one.

    Merged by `recorded_order`, they are the streams merged as a whole.

    Parameters
    ----------
    log_times_ns : of each stream. block : of a stream at the most, but where more have one time.

    >>> list(merged_parts([np.array([1, 2, 5]), np.array([2, 4])], 2))
    [[slice(0, 2, None), slice(0, 1, None)], [slice(2, 3, None), slice(1, 2, None)]]
    """
    done = [0] * len(log_times_ns)
    while True:
        ends = [
            int(times[at + block - 1]) for times, at in zip(log_times_ns, done, strict=True) if times.size - at > block
        ]
        if not ends:
            yield [slice(at, times.size) for times, at in zip(log_times_ns, done, strict=True)]
            return
        until = min(ends)
        reached = [int(np.searchsorted(times, until, side="right")) for times in log_times_ns]
        yield [slice(at, end) for at, end in zip(done, reached, strict=True)]
        done = reached
