"""What the stamps and values of one input look like, before anything is paired."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.merge import OutOfOrderError, Part
from friction_estimator.bag.read import Progress, Reading, read_recording
from friction_estimator.bag.recording import Described, Outline, Recorded, Stream
from friction_estimator.bag.source import Source
from friction_estimator.core.growing import WholeNumbers
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.sample import NS_PER_S, Floats
from friction_estimator.core.settings.groups import InputConfig, SyncConfig

MOVING = 0.15
"""Share of the top speed above which the shaft counts as moving."""


@dataclass(frozen=True)
class StreamStatistics:
    """Figures of one input; NaN where there are too few messages.

    Attributes
    ----------
    messages, missing : with a value; without one (another joint's).
    duration_s, rate_hz : sum of the steps forward; reciprocal of the median period.
    jitter_s : half of the range that holds 98 % of the periods that are no gaps.
    gaps, longest_gap_s : periods longer than `sync.gap_factor` median periods; the longest period.
    zero_stamps, duplicate_stamps, backward_stamps, clock_jumps : stamps of zero, equal to the one before, before it
        by less than `sync.jump_back`, by at least that.
    delay_s : median of time of recording less stamp.
    nan, infinite : values; infinite is whatever exceeds `LARGEST_VALUE`, as in the intake.
    lowest, highest : of the finite values, in SI units.
    """

    messages: int
    missing: int
    duration_s: float
    rate_hz: float
    jitter_s: float
    gaps: int
    longest_gap_s: float
    zero_stamps: int
    duplicate_stamps: int
    backward_stamps: int
    clock_jumps: int
    delay_s: float
    nan: int
    infinite: int
    lowest: float
    highest: float


def describe(stream: Stream, sync: SyncConfig) -> StreamStatistics:
    """Return the figures of a stream.

    >>> k = np.arange(5)
    >>> figures = describe(Stream("/v", "", k * 1_000_000 + 1, k * 1_000_000 + 1, k - 2.0), SyncConfig())
    >>> figures.rate_hz, figures.lowest, figures.highest
    (1000.0, -2.0, 2.0)
    """
    account = Account(sync)
    account.add(Part(stream.stamp_ns, stream.log_time_ns, stream.value))
    return account.figures(stream)


def read_described(
    path: str | PurePath | Source,
    config: InputConfig,
    sync: SyncConfig,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> tuple[Recorded, dict[str, StreamStatistics]]:
    """Read a recording as `read_recording` does, in less memory; return it with the figures of its streams."""
    with Reading(path, config, topics, progress) as reading:
        accounts = {name: Account(sync) for name in reading.names}
        try:
            for events in reading.events():
                for name, account in accounts.items():
                    account.add(events.of(name))
            outline: Outline | None = reading.outline()
        except OutOfOrderError:
            outline = None
    if outline is None:
        recording = read_recording(path, config, topics, progress)
        return recording, {name: describe(stream, sync) for name, stream in recording.streams.items()}
    return outline, {name: accounts[name].figures(heard) for name, heard in outline.streams.items()}


def figures_of(recording: Recorded, sync: SyncConfig) -> dict[str, StreamStatistics]:
    """Return the figures of all streams of a recording, which is read again where its numbers were not kept."""
    if isinstance(recording, Outline):
        return read_described(recording.path, recording.config, sync, recording.asked)[1]
    return {name: describe(stream, sync) for name, stream in recording.whole().streams.items()}


class Account:
    """The figures of one input while its messages come, in the order of recording; eight bytes a message are kept."""

    def __init__(self, sync: SyncConfig) -> None:
        self._gap_factor, self._jump_ns = sync.gap_factor, sync.jump_back * NS_PER_S
        self._forward, self._delay = WholeNumbers(), WholeNumbers()
        self._last_ns: int | None = None
        self._duration_ns = self._longest_ns = 0
        self._stamped = self._zero = self._equal = self._backward = self._jumps = self._nan = self._infinite = 0
        self._lowest, self._highest = np.inf, -np.inf

    def add(self, part: Part) -> None:
        """Take messages."""
        self._delay.extend(part.log_time_ns - part.stamp_ns)
        stamps = part.stamp_ns[part.stamp_ns != 0]
        self._zero += len(part) - stamps.size
        self._stamped += stamps.size
        if stamps.size:
            step = np.diff(stamps, prepend=stamps[:1] if self._last_ns is None else np.int64(self._last_ns))
            step = step[1:] if self._last_ns is None else step
            self._last_ns = int(stamps[-1])
            forward = step[step > 0]
            self._forward.extend(forward)
            self._duration_ns += int(forward.sum())
            self._longest_ns = max(self._longest_ns, int(forward.max(initial=0)))
            self._equal += int(np.count_nonzero(step == 0))
            self._backward += int(np.count_nonzero((step < 0) & (step > -self._jump_ns)))
            self._jumps += int(np.count_nonzero((step < 0) & (step <= -self._jump_ns)))
        finite = part.value[np.abs(part.value) <= LARGEST_VALUE]
        self._nan += int(np.count_nonzero(np.isnan(part.value)))
        self._infinite += int(np.count_nonzero(np.abs(part.value) > LARGEST_VALUE))
        self._lowest = min(self._lowest, float(finite.min(initial=np.inf)))
        self._highest = max(self._highest, float(finite.max(initial=-np.inf)))

    def figures(self, stream: Described) -> StreamStatistics:
        """Return the figures of the stream whose messages have all come."""
        first = self._forward.first or 0
        steps = self._forward.taken()
        period_ns = _middle(steps, first) if steps.size else np.nan
        regular = steps[steps <= self._gap_factor * period_ns - first]
        about = first + np.quantile(regular, [0.01, 0.99], overwrite_input=True) if regular.size else np.zeros(2)
        finite = self._lowest <= self._highest
        return StreamStatistics(
            messages=len(stream),
            missing=stream.missing,
            duration_s=self._duration_ns / NS_PER_S if self._stamped else np.nan,
            rate_hz=NS_PER_S / period_ns,
            jitter_s=float(np.ptp(about)) / 2 / NS_PER_S if regular.size else np.nan,
            gaps=steps.size - regular.size,
            longest_gap_s=self._longest_ns / NS_PER_S if steps.size else np.nan,
            zero_stamps=self._zero,
            duplicate_stamps=self._equal,
            backward_stamps=self._backward,
            clock_jumps=self._jumps,
            delay_s=_middle(self._delay.taken(), self._delay.first or 0) / NS_PER_S if len(stream) else np.nan,
            nan=self._nan,
            infinite=self._infinite,
            lowest=self._lowest if finite else np.nan,
            highest=self._highest if finite else np.nan,
        )


def _middle(apart: NDArray[np.signedinteger], first: int) -> float:
    """Return the median of `first` + `apart`, (n,), which is put in another order."""
    half = apart.size // 2
    apart.partition([half - 1, half] if apart.size > 1 else [half])
    middle = apart[half - 1 : half + 1] if apart.size % 2 == 0 else apart[half : half + 1]
    return float(np.median(first + middle.astype(np.int64)))


def moving_speeds(velocity_m_s: Floats) -> list[tuple[float, float]]:
    """Return the usual velocities of each direction of motion, m/s: the range that holds nine tenths of the samples.

    Standstill (below `MOVING` of the top speed) is left out, and so is a direction with less than a twentieth of the
    rest. Ranges are (nearest to zero, farthest from zero).

    >>> moving_speeds(np.array([0.0, 0.01, 0.01, -0.02, -0.02]))
    [(0.01, 0.01), (-0.02, -0.02)]
    """
    top = float(np.quantile(np.abs(velocity_m_s), 0.99)) if velocity_m_s.size else 0.0
    moving = velocity_m_s[np.abs(velocity_m_s) > MOVING * top]
    ranges = []
    for sign in (1.0, -1.0):
        speed = sign * moving[sign * moving > 0.0]
        if speed.size > 0.05 * moving.size:
            low, high = np.quantile(speed, [0.05, 0.95]).tolist()
            ranges.append((sign * low, sign * high))
    return ranges
