"""What the stamps and values of one input look like, before anything is paired."""

from dataclasses import dataclass

import numpy as np

from friction_estimator.bag.recording import Stream
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.sample import NS_PER_S, Floats
from friction_estimator.core.settings.groups import SyncConfig

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
    stamps = stream.stamp_ns[stream.stamp_ns != 0]
    step = np.diff(stamps)
    forward = step[step > 0]
    period_ns = float(np.median(forward)) if forward.size else np.nan
    regular = forward[forward <= sync.gap_factor * period_ns]
    finite = stream.value[np.abs(stream.value) <= LARGEST_VALUE]
    jump_ns = sync.jump_back * NS_PER_S
    return StreamStatistics(
        messages=len(stream),
        missing=stream.missing,
        duration_s=float(forward.sum()) / NS_PER_S if stamps.size else np.nan,
        rate_hz=NS_PER_S / period_ns,
        jitter_s=float(np.ptp(np.quantile(regular, [0.01, 0.99]))) / 2 / NS_PER_S if regular.size else np.nan,
        gaps=forward.size - regular.size,
        longest_gap_s=float(forward.max()) / NS_PER_S if forward.size else np.nan,
        zero_stamps=len(stream) - stamps.size,
        duplicate_stamps=int(np.count_nonzero(step == 0)),
        backward_stamps=int(np.count_nonzero((step < 0) & (step > -jump_ns))),
        clock_jumps=int(np.count_nonzero((step < 0) & (step <= -jump_ns))),
        delay_s=float(np.median(stream.log_time_ns - stream.stamp_ns)) / NS_PER_S if len(stream) else np.nan,
        nan=int(np.count_nonzero(np.isnan(stream.value))),
        infinite=int(np.count_nonzero(np.abs(stream.value) > LARGEST_VALUE)),
        lowest=float(finite.min()) if finite.size else np.nan,
        highest=float(finite.max()) if finite.size else np.nan,
    )


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
