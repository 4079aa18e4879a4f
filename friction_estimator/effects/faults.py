"""Data faults: found before any model is fitted."""

from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Floats
from friction_estimator.effects.base import Effect, Key, Words, effect
from friction_estimator.effects.sensor import seen_at
from friction_estimator.effects.trace import Trace


@effect
class VelocityMismatch(Effect):
    """Reported velocity is not the derivative of position."""

    name = "velocity_mismatch"
    family = "data"
    stage = "sensor"
    detects_at = "motion"
    figure = "velocity"
    channel = "position"
    keys = (Key("gain", "", 0.03, -0.9, 10.0, "relative error of the reported velocity"),)
    size_key = "gain"
    linear = False
    reveals = "velocity_m_s"
    words = Words(
        "the reported velocity is not the derivative of the reported position",
        "velocity against the difference quotient of position has a slope other than one",
        {},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Scale the measured velocity."""
        return replace(trace, velocity_measured_m_s=trace.velocity_measured_m_s * (1.0 + self["gain"]))

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the error of the friction that belongs to the measured velocity."""
        return seen_at(after, after.velocity_measured_m_s) - seen_at(before, before.velocity_measured_m_s)


@effect
class ClockJump(Effect):
    """The clock jumps."""

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


@effect
class DuplicateStamps(Effect):
    """Stamps repeat."""

    name = "duplicate_stamps"
    family = "data"
    stage = "stamps"
    detects_at = "stamps"
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


@effect
class StampOffset(Effect):
    """Force and velocity are stamped by clocks that differ."""

    name = "stamp_offset"
    family = "data"
    stage = "stamps"
    detects_at = "stamps"
    figure = "stamps"
    keys = (Key("offset", "s", 1e-3, -10.0, 10.0, "friction stamps minus velocity stamps"),)
    size_key = "offset"
    linear = False
    words = Words(
        "force and velocity are stamped by clocks that differ by a constant",
        "nearest stamps of the two topics differ by the same time throughout",
        {"time_delay": "read the stamps: a delayed force has the right stamps"},
    )

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:  # noqa: ARG002
        """Shift the force's stamps."""
        return replace(trace, friction_stamp_ns=trace.friction_stamp_ns + round(self["offset"] * NS_PER_S))

    def change(self, before: Trace, after: Trace) -> Floats:  # noqa: ARG002
        """Return what the offset makes of the friction on the velocity's time axis."""
        late = np.interp(before.time_s - self["offset"], before.time_s, before.friction_N)
        return np.asarray(late - before.friction_N)
