"""Messages of one length that stay where a chunk has them: their numbers are taken out of it in one compiled pass.

A chunk holds all topics in turn, so a row for each message of one topic would be a copy of half the file, of which a
stamp and a value are wanted. Both loops let go of the interpreter, so that what was read before is learned meanwhile.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.layout import Layout
from friction_estimator.compiled import njit
from friction_estimator.core.sample import Ints

WORD = 8
"""Bytes that are compared or taken at a time."""

OUTSIDE, ASTRAY, LONGER = range(1, 4)
"""What is wrong with the head of a message: it lies outside the chunk, is not of the channel, is longer than the
chunk."""

HEAD = 31
"""Bytes of a Message record before its payload: opcode, length (uint64), channel (uint16), sequence (uint32), time of
recording and of publication (uint64); all little-endian."""

_BEHIND_LENGTH = HEAD - 9
_MESSAGE = 0x05


@njit(cache=True, nogil=True)
def heads(records, places, channel, times, lengths):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Read the heads of the Message records at `places`: time of recording and length of the payload, each (n,).

    Returns 0, or the first of the three faults that there is.
    """
    size = records.size
    wrong = LONGER + 1
    for k in range(places.size):
        at = places[k]
        if not 0 <= at <= size - HEAD:
            return OUTSIDE
        length = np.uint64(0)
        time = np.uint64(0)
        for byte in range(8):
            length |= np.uint64(records[at + 1 + byte]) << np.uint64(8 * byte)
            time |= np.uint64(records[at + 15 + byte]) << np.uint64(8 * byte)
        if records[at] != _MESSAGE or records[at + 9] != channel & 0xFF or records[at + 10] != channel >> 8:
            wrong = min(wrong, ASTRAY)
        payload = np.int64(length) - _BEHIND_LENGTH
        if payload < 0 or payload > size - HEAD - at:
            wrong = min(wrong, LONGER)
        times[k] = np.int64(time)
        lengths[k] = payload
    return wrong if wrong <= LONGER else 0


@njit(cache=True, nogil=True)
def numbers(records, starts, word_at, word, mask, stamp_at, value_at, stamp, value):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Compare words of messages with those of a layout; take stamps and values, (n, 8) bytes each, where they are.

    Returns whether all messages have the layout. A place of -1 is not taken.
    """
    other = np.uint64(0)
    for k in range(starts.size):
        for w in range(word_at.size):
            at = starts[k] + word_at[w]
            found = np.uint64(0)
            for byte in range(8):
                found |= np.uint64(records[at + byte]) << np.uint64(8 * byte)
            other |= (found ^ word[w]) & mask[w]
        if stamp_at >= 0:
            at = starts[k] + stamp_at
            for byte in range(8):
                stamp[k, byte] = records[at + byte]
        if value_at >= 0:
            at = starts[k] + value_at
            for byte in range(8):
                value[k, byte] = records[at + byte]
    return other == 0


@dataclass(frozen=True)
class Placed:
    """Payloads of one length in the records of a chunk.

    Attributes
    ----------
    records : the chunk's bytes. starts : (n,), where the payloads begin. length : of each, bytes.
    """

    records: NDArray[np.uint8]
    starts: Ints
    length: int

    def __len__(self) -> int:
        return int(self.starts.size)

    def first(self) -> bytes:
        """Return the first payload."""
        return self.records[self.starts[0] : self.starts[0] + self.length].tobytes()

    def rows(self) -> NDArray[np.uint8]:
        """Return the payloads as rows of their own, (n, length)."""
        if self.length == 0:
            return np.zeros((self.starts.size, 0), np.uint8)
        windows = np.lib.stride_tricks.sliding_window_view(self.records, self.length)
        return np.ascontiguousarray(windows[self.starts])

    def taken(self, layout: Layout) -> "tuple[NDArray[np.uint8], NDArray[np.uint8]] | None":
        """Return the bytes of stamps and values, (n, 8) each; None where some message has another layout.

        What the layout does not have is left as it is.
        """
        words = Words.of(layout)
        if words is None or layout.length != self.length:
            return None
        stamp, value = np.empty((len(self), WORD), np.uint8), np.empty((len(self), WORD), np.uint8)
        places = (-1 if at is None else at for at in (layout.stamp_at, layout.value_at))
        same = numbers(self.records, self.starts, words.at, words.word, words.mask, *places, stamp, value)
        return (stamp, value) if same else None


def payloads(records: NDArray[np.uint8], starts: Ints, lengths: Ints) -> Placed | list[bytes]:
    """Return messages of a chunk: placed where all have one length, else as bytes.

    Parameters
    ----------
    records : the chunk's bytes. starts, lengths : where the payloads begin, how long they are, (n,) each, n > 0.
    """
    if np.all(lengths == lengths[0]):
        return Placed(records, starts, int(lengths[0]))
    ends = (starts + lengths).tolist()
    return [records[start:end].tobytes() for start, end in zip(starts.tolist(), ends, strict=True)]


@dataclass(frozen=True)
class Words:
    """The bytes that fix a layout, in words of 8 bytes: where they are, what they hold, which of their bits count."""

    at: Ints
    word: NDArray[np.uint64]
    mask: NDArray[np.uint64]

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, layout: Layout) -> "Words | None":
        """Return those of a layout; None where a message is shorter than a word."""
        if layout.length < WORD:
            return None
        held, counts = np.zeros(layout.length, np.uint8), np.zeros(layout.length, np.uint8)
        for place, content in layout.fixed:
            held[place : place + len(content)] = np.frombuffer(content, np.uint8)
            counts[place : place + len(content)] = 0xFF
        at, covered = [], 0
        for place in np.flatnonzero(counts).tolist():
            if place >= covered:
                at.append(min(place, layout.length - WORD))
                covered = at[-1] + WORD
        parts = [slice(place, place + WORD) for place in at]
        words = [
            np.concatenate([values[part] for part in parts] or [np.zeros(0, np.uint8)]) for values in (held, counts)
        ]
        return cls(np.array(at, np.int64), *(word.view("<u8").astype(np.uint64) for word in words))
