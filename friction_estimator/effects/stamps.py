"""Faults of the stamps."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Floats
from friction_estimator.effects.base import Effect, Key, Words, effect
from friction_estimator.effects.detection import COMPLETELY, MASKED, NOT_REPAIRED, DataView, Fault
from friction_estimator.effects.scatter import MAD
from friction_estimator.effects.trace import Trace

FAST = 0.05
"""Share of the top speed: slower, a gap in the data looks like a jump of the clock."""

MOST_JUMPS = 3
"""A clock is set once or twice. More are pieces put together with a gap at each joint (`import --segment`)."""

LONG_STEP = 4.0
"""Sample periods: shorter steps are lost messages."""

SUDDEN = 2.0
"""Times the largest change of the velocity in a sample elsewhere: more is none of one sample."""

SAME_PHASE = 0.05
"""Share of the period by which a gap must miss its multiples: a recorder that was off for whole periods shows the shaft
where it left it, and no clock was set."""

PERIOD_ERROR = 2e-3
"""Of a period: what the measured one is off by."""

MANY = 0.001
"""Share of samples with a repeated stamp that is worth a name."""

FEWEST = 3


@effect
class ClockJump(Effect):
    """A clock that is set while recording.

    Formula::

        stamp(t) = t + jump 1(t >= at)
    """

    name = "clock_jump"
    family = "data"
    stage = "stamps"
    detects_at = "motion"
    figure = "stamps"
    keys = (
        Key("jump", "s", 0.5, -1e6, 1e6, "by how much the stamps jump"),
        Key("at", "s", 30.0, 0.0, 1e9, "when"),
    )
    size_key = ""
    words = Words(
        "the clock that stamps the messages was set while recording",
        "one step of the stamps is far longer than the others, or negative",
        {},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Shift all later stamps."""
        shift = np.where(trace.time_s >= self["at"], round(self["jump"] * NS_PER_S), 0)
        return replace(trace, stamp_ns=trace.stamp_ns + shift, friction_stamp_ns=trace.friction_stamp_ns + shift)

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:
        """Find a gap in the stamps over which position and velocity moved on by one sample only.

        The position alone may be back by chance, where the drive has gone over to another period meanwhile.
        """
        position, context, v = view.samples.position_m, view.context, view.features.velocity_m_s
        if position is None or "position" not in context.channels:
            return None
        step = np.diff(view.samples.stamp_ns) / NS_PER_S
        same = view.recording[1:] == view.recording[:-1]
        usual = same & (step > 0.0) & (step < 2.0 * context.step_s)
        off = (np.diff(position) - 0.5 * (v[1:] + v[:-1]) * step)[usual]
        off = off[np.isfinite(off)]
        noise = MAD * float(np.median(np.abs(off))) if off.size else 0.0
        change = np.abs(np.diff(v))
        usual_change = float(np.max(change[usual & np.isfinite(change)], initial=0.0))
        jumps = []
        for k in np.flatnonzero(same & ((step > LONG_STEP * context.step_s) | (step < 0.0))):
            expected = 0.5 * (v[k] + v[k + 1])
            moved = position[k + 1] - position[k]
            slow = min(v[k] * v[k + 1], expected**2) < (FAST * context.top_speed_m_s) ** 2
            if slow or abs(expected * step[k]) < 0.05 * context.stroke_m or not np.isfinite(moved):
                continue
            if change[k] > SUDDEN * usual_change:
                continue
            if any(_whole_periods(float(step[k]), period, context.step_s) for period in context.periods_s):
                continue
            # The stamps stood for one sample: the shaft moved on by that much, to the noise of the position channel.
            one = expected * context.step_s
            if abs(moved - one) < min(0.2 * abs(moved - expected * step[k]), abs(one) + 5.0 * noise):
                jumps.append((float(step[k] - context.step_s), float(view.features.time_s[k])))
        if not 0 < len(jumps) <= MOST_JUMPS:
            return None
        jump, at = max(jumps, key=lambda pair: abs(pair[0]))
        reach = context.step_s
        return Fault(
            cls.name,
            f"the stamps jump by {jump:.4g} s while the position moves on by one sample",
            {"jump": (jump, "s", jump - reach, jump + reach), "at": (at, "s", at - reach, at + 2 * reach)},
            NOT_REPAIRED,
        )


def _whole_periods(gap_s: float, period_s: float, step_s: float) -> bool:
    """Return whether a gap is a whole number of periods of the drive, as far as the period is known."""
    count = round(gap_s / period_s)
    reach = min(0.5, SAME_PHASE + step_s / period_s) * period_s + PERIOD_ERROR * abs(gap_s)
    return count >= 1 and abs(gap_s - count * period_s) < reach


@effect
class DuplicateStamps(Effect):
    """Messages that carry the stamp of the one before.

    Formula::

        stamp[k] = t[k-1]    at a share `fraction` of the samples
    """

    name = "duplicate_stamps"
    family = "data"
    stage = "stamps"
    figure = "stamps"
    keys = (Key("fraction", "", 0.01, 0.0, 0.5, "share of samples that carry the stamp of the one before"),)
    size_key = ""
    words = Words(
        "messages carry the stamp of the one before (a driver that stamps twice)",
        "steps of zero length between stamps",
        {},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Repeat stamps."""
        hit = np.flatnonzero(rng.random(trace.time_s.size) < self["fraction"])
        hit = hit[hit > 0]
        stamps, friction = trace.stamp_ns.copy(), trace.friction_stamp_ns.copy()
        stamps[hit] = trace.stamp_ns[hit - 1]
        friction[hit] = trace.friction_stamp_ns[hit - 1]
        return replace(trace, stamp_ns=stamps, friction_stamp_ns=friction)

    @classmethod
    def counted(cls, facts: Mapping[str, float]) -> Fault | None:
        """More than a thousandth of the samples were refused for a repeated stamp; refused, they harm nothing else."""
        count, read = facts.get("duplicate_stamp", 0.0), facts.get("read", 0.0)
        if read <= 0.0 or count < max(FEWEST, MANY * read):
            return None
        share = count / read
        reach = 2.0 * float(np.sqrt(count)) / read
        return Fault(
            cls.name,
            f"{count:.0f} of {read:.0f} samples carry the stamp of the one before",
            {"fraction": (share, "", max(0.0, share - reach), share + reach)},
            MASKED,
        )


@effect
class StampOffset(Effect):
    """Two clocks: force and velocity are stamped by different ones.

    Formula::

        stamp_force(t) = t + offset
    """

    name = "stamp_offset"
    family = "data"
    stage = "stamps"
    figure = "stamps"
    keys = (Key("offset", "s", 1e-3, -10.0, 10.0, "friction stamps minus velocity stamps"),)
    size_key = "offset"
    linear = False
    words = Words(
        "{force} and velocity are stamped by clocks that differ by a constant",
        "nearest stamps of the two topics differ by the same time throughout",
        {"time_delay": "read the stamps: a delayed {force} has the right stamps"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Shift the force's stamps."""
        return replace(trace, friction_stamp_ns=trace.friction_stamp_ns + round(self["offset"] * NS_PER_S))

    def change(self, before: Trace, after: Trace) -> Floats:  # noqa: ARG002
        """Return what the offset makes of the friction on the velocity's time axis."""
        late = np.interp(before.time_s - self["offset"], before.time_s, before.friction_N)
        return np.asarray(late - before.friction_N)

    @classmethod
    def counted(cls, facts: Mapping[str, float]) -> Fault | None:
        """A steady offset of the stamps, which is taken out while reading."""
        value, period = facts.get("stamp_offset_s", 0.0), facts.get("period_s", 0.0)
        if value == 0.0:
            return None
        reach = 0.01 * period
        return Fault(
            cls.name,
            f"friction is stamped {1e3 * value:.3g} ms from the nearest velocity throughout",
            {"offset": (value, "s", value - reach, value + reach)},
            COMPLETELY,
        )
