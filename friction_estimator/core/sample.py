"""Samples as structure of arrays, in SI units: what every room of the house hands to the next."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

NS_PER_S = 1_000_000_000

_BLOCK = 65_536

_LONGEST_STEP = 2**31 - 1
"""What half of an int64 holds, ns."""

_LOWER_BITS = 16
"""Of a step, by which it is counted apart from its upper ones."""


@dataclass(frozen=True)
class Samples:
    """Paired samples of one recording, in the order in which they are processed.

    Attributes
    ----------
    stamp_ns : (n,) int64, header stamp, ns.
    velocity_m_s : (n,) float64, shaft velocity, m/s.
    friction_N : (n,) float64, measured friction, N; it has the sign of the velocity that it opposes.
    restart : (n,) bool, True where the delay lines start anew (first sample, gap, backward jump).
    pressure_Pa : (n,) float64 or None, absolute pressure held at the sample, Pa; NaN before the first value.
    temperature_degC : (n,) float64 or None, held at the sample, degree Celsius; NaN before the first value.
    position_m : (n,) float64 or None, shaft position at the sample, m; NaN before the first value.
    position_shift_m : (n,) float64 or None, what was added to the recorded position where its encoder had wrapped, m.
    acceleration_m_s2 : (n,) float64 or None, of the same instant, from velocity (`intake.acceleration`), m/s^2; made
        where `load.terms` needs it.
    acceleration_variance : (n,) float64 or None, of the noise in it, (m/s^2)^2.
    acceleration_doubt : (n,) float64 or None, square of what a corner of the velocity may have done to it, (m/s^2)^2; 0
        where there is no sign of one.
    """

    stamp_ns: Ints
    velocity_m_s: Floats
    friction_N: Floats
    restart: Bools
    pressure_Pa: Floats | None = None
    temperature_degC: Floats | None = None
    position_m: Floats | None = None
    position_shift_m: Floats | None = None
    acceleration_m_s2: Floats | None = None
    acceleration_variance: Floats | None = None
    acceleration_doubt: Floats | None = None

    def __post_init__(self) -> None:
        n = self.stamp_ns.size
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and value.shape != (n,):
                raise ValueError(f"Samples.{field.name} has shape {value.shape}, expected ({n},)")

    def __len__(self) -> int:
        return int(self.stamp_ns.size)

    def __getitem__(self, part: slice) -> "Samples":
        """Return a part; its arrays are views."""
        cut: dict[str, Any] = {f.name: None if (v := getattr(self, f.name)) is None else v[part] for f in fields(self)}
        return replace(self, **cut)

    def beginning(self, most: int) -> "Samples":
        """Return the first samples, at most so many, in arrays of their own where there are more."""
        if len(self) <= most:
            return self
        first = {f.name: getattr(self[:most], f.name) for f in fields(self)}
        own: dict[str, Any] = {name: None if values is None else values.copy() for name, values in first.items()}
        return Samples(**own)

    @property
    def time_s(self) -> Floats:
        """Time since the first sample, s."""
        return (self.stamp_ns - self.stamp_ns[:1]) / NS_PER_S

    @property
    def duration_s(self) -> float:
        """Time that passed from the first to the last sample, s; backward jumps of the clock do not count."""
        forward = 0
        for start in range(0, len(self) - 1, _BLOCK):
            step = np.diff(self.stamp_ns[start : start + _BLOCK + 1])
            forward += int(step[step > 0].sum())
        return float(np.int64(forward) / NS_PER_S)

    @property
    def sample_rate_hz(self) -> float:
        """Median sample rate inside gap-free pieces, Hz; NaN below two samples."""

        def steps() -> Iterator[Ints]:
            for start in range(0, len(self) - 1, _BLOCK):
                step = np.diff(self.stamp_ns[start : start + _BLOCK + 1])
                step = step[~self.restart[start + 1 : start + 1 + step.size] & (step > 0)]
                yield np.minimum(step, _LONGEST_STEP)

        period = _median(steps)
        if np.isnan(period):
            return period
        if period > _LONGEST_STEP // 2:  # a second or more: such a recording is short
            step = np.diff(self.stamp_ns)[~self.restart[1:]]
            period = float(np.median(step[step > 0]))
        return float(NS_PER_S / period)


def _median(pieces: Callable[[], Iterable[Ints]]) -> float:
    """Return the median of whole numbers from 0 to below 2^31 that come in pieces, again at each call; NaN of none.

    They are counted by their upper bits, then those about the middle by their lower ones: nothing of their number is
    kept.
    """

    def counted(pieces: Iterable[Ints]) -> Ints:
        counts = np.zeros(1 << _LOWER_BITS, np.int64)
        for piece in pieces:
            counts += np.bincount(piece, minlength=counts.size)
        return counts

    def at(counts: Ints, rank: int) -> int:
        return int(np.searchsorted(np.cumsum(counts), rank, side="right"))

    upper = counted(piece >> _LOWER_BITS for piece in pieces())
    total = int(upper.sum())
    if not total:
        return float("nan")
    ranks = ((total - 1) // 2, total // 2)
    bits = [at(upper, rank) for rank in ranks]
    lower = {
        high: counted(piece[piece >> _LOWER_BITS == high] & (1 << _LOWER_BITS) - 1 for piece in pieces())
        for high in set(bits)  # one, but where a step lies between the two
    }
    middle = [
        (high << _LOWER_BITS) + at(lower[high], rank - int(upper[:high].sum()))
        for high, rank in zip(bits, ranks, strict=True)
    ]
    return float(np.mean(middle))


def joined(recordings: Sequence[Samples]) -> Samples:
    """Return several recordings one after the other, (sum of n,); the delay lines restart at each joint.

    Stamps stay as they were recorded, so they may jump either way at a joint. A channel that some recordings lack is
    NaN there; one that all lack is None.

    >>> one = Samples(np.array([5]), np.array([0.1]), np.array([3.0]), np.array([False]))
    >>> both = joined([one, replace(one, pressure_Pa=np.array([2e5]))])
    >>> both.restart.tolist(), both.pressure_Pa.tolist()
    ([True, True], [nan, 200000.0])

    Raises ValueError where there is none.
    """
    if not recordings:
        raise ValueError("no recording to join")
    if len(recordings) == 1 and recordings[0].restart[:1].all():
        return recordings[0]
    whole: dict[str, Any] = {}
    for field in fields(Samples):
        values = [getattr(part, field.name) for part in recordings]
        if any(value is not None for value in values):
            filled = [
                np.full(len(part), np.nan) if value is None else value
                for part, value in zip(recordings, values, strict=True)
            ]
            whole[field.name] = np.concatenate(filled)
    begins = np.cumsum([0, *(len(part) for part in recordings[:-1])])
    whole["restart"][begins[begins < whole["restart"].size]] = True
    return Samples(**whole)


def in_sequence(parts: list[Samples]) -> Samples:
    """Return parts of one stream as one, restarts where they are."""
    if not parts:
        empty = np.zeros(0)
        return Samples(np.zeros(0, np.int64), empty, empty, np.zeros(0, np.bool_))
    return replace(joined(parts), restart=np.concatenate([part.restart for part in parts]))
