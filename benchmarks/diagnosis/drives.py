"""The drives of the study: what the machine does, and how well its recorder works."""

import math
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.rig.drive import Segment, segment

LOW, HIGH, HIGHER = 50.0, 200.0, 350.0
"""Gauge pressures, psi."""


@dataclass(frozen=True)
class Drive:
    """A drive and its recorder.

    Attributes
    ----------
    name : in the tables.
    parts : (period s, pressure psi, seconds, profile) of each segment.
    rate_hz : of the recording.
    abba : whether it has two periods or more and comes back to its first pressure.
    force, motion : the machine's size against the usual one (rig.law.Scaled).
    pauses : how often the recorder is off for 1 to 30 s while the machine runs on.
    jitter : deviation of the stamps, in sample periods.
    missing : share of samples that are lost.
    """

    name: str
    parts: tuple[tuple[float, float, float, str], ...]
    rate_hz: float = 200.0
    abba: bool = True
    force: float = 1.0
    motion: float = 1.0
    pauses: int = 0
    jitter: float = 0.0
    missing: float = 0.0

    @property
    def pressures(self) -> int:
        """Number of pressures."""
        return len({part[1] for part in self.parts})

    def segments(self, stretch: float = 1.0) -> tuple[Segment, ...]:
        """Return the segments, each `stretch` times as long."""
        return tuple(segment(period, psi, stretch * s, profile) for period, psi, s, profile in self.parts)

    @property
    def duration_s(self) -> float:
        """Length of what is recorded, s."""
        return sum(part.duration_s for part in self.segments())


def abba(fast: float, slow: float, seconds: tuple[float, float], profiles=("sine", "sine")) -> tuple:
    """Return two periods at pressures low, high, high, low."""
    return tuple(
        (period, psi, length, profile)
        for psi in (LOW, HIGH, HIGH, LOW)
        for period, length, profile in zip((fast, slow), seconds, profiles, strict=True)
    )


USUAL = Drive("abba", (*abba(1.0, 5.0, (10.0, 20.0))[:-1], (5.0, LOW, 25.0, "sine")))
"""25,000 samples at 200 Hz."""

ABBA = (
    USUAL,
    replace(USUAL, name="pauses", pauses=4),
    replace(USUAL, name="jitter", jitter=0.08),
    replace(USUAL, name="missing", missing=0.02),
    Drive("100 Hz", abba(1.0, 5.0, (15.0, 35.0)), 100.0),
    Drive("1 kHz", abba(0.5, 2.0, (3.0, 4.0)), 1000.0, motion=0.4),
    Drive("5 kHz", abba(0.25, 0.5, (1.0, 1.0)), 5000.0, motion=0.15),
    Drive("crank, triangle", abba(1.3, 4.0, (13.0, 20.0), ("crank", "triangle"))),
    replace(USUAL, name="1 mm/s, 1 N", force=0.2, motion=1.0 / 126.0),
    replace(USUAL, name="1 mm/s, 5 kN", force=530.0, motion=1.0 / 126.0),
    replace(USUAL, name="1 m/s, 200 N", force=40.0, motion=8.0, pauses=2),
)
"""Two periods, and back to the first pressure."""

_IN_ORDER = tuple((t, p, s, "sine") for p in (LOW, HIGH, HIGHER) for t, s in ((1.0, 14.0), (5.0, 25.0)))

OTHER = (
    Drive("in order", _IN_ORDER, abba=False),
    Drive("in order, pauses", _IN_ORDER, abba=False, pauses=3, jitter=0.05),
    Drive("one period", ((2.0, LOW, 30.0, "sine"), (2.0, HIGH, 60.0, "sine"), (2.0, LOW, 30.0, "sine")), abba=False),
    Drive("one sine", ((2.0, LOW, 100.0, "sine"),), abba=False, missing=0.01),
    Drive("one pressure", ((1.0, LOW, 40.0, "sine"), (5.0, LOW, 80.0, "sine")), abba=False),
    Drive("speed steps, dwell", ((8.0, LOW, 64.0, "speed_steps"), (4.0, HIGH, 60.0, "dwell")), abba=False),
    Drive("multisine", ((6.0, LOW, 60.0, "multisine"), (6.0, HIGH, 60.0, "multisine")), abba=False),
    Drive("1 kHz, crank", ((0.8, LOW, 12.0, "crank"), (2.0, HIGH, 14.0, "crank")), 1000.0, abba=False, motion=0.5),
    Drive(
        "100 Hz, 30 N", ((2.0, LOW, 80.0, "sine"), (5.0, HIGH, 80.0, "sine")), 100.0, abba=False, force=6.0, motion=0.1
    ),
    # At a third of the speed at which the theory's sign is as wide as a twentieth of the top speed.
    Drive("slow", ((16.0, LOW, 64.0, "speed_steps"), (10.0, HIGH, 60.0, "sine")), abba=False),
)
"""One period, pressures in order, one pressure, or other profiles."""

BY_NAME = {drive.name: drive for drive in (*ABBA, *OTHER)}


@dataclass(frozen=True)
class Recorder:
    """What is lost of a run: the samples kept, and the error of their stamps.

    Attributes
    ----------
    stretch : how much longer the machine runs than is recorded.
    keep : (n,) bool. shift_ns : (n,) int64.
    """

    stretch: float
    off_s: tuple[tuple[float, float], ...]
    drive: Drive
    seed: int

    @classmethod
    def of(cls, drive: Drive, seed: int) -> "Recorder":
        """Draw when the recorder is off: log-uniform 1 to 30 s, never in the first or last tenth."""
        rng = np.random.default_rng([seed, 11])
        lengths = np.exp(rng.uniform(0.0, math.log(30.0), drive.pauses))
        stretch = 1.0 + float(lengths.sum()) / drive.duration_s
        # The pauses lie at sorted shares of what is recorded; each shifts those after it.
        shares = np.sort(rng.uniform(0.1, 0.9, drive.pauses)) * drive.duration_s
        before = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) if drive.pauses else np.zeros(0)
        return cls(stretch, tuple(zip(shares + before, shares + before + lengths, strict=True)), drive, seed)

    def keep(self, time_s) -> np.ndarray:
        """Return which samples are recorded, (n,) bool."""
        rng = np.random.default_rng([self.seed, 12])
        kept = np.ones(time_s.size, np.bool_)
        for begin, end in self.off_s:
            kept[(time_s >= begin) & (time_s < end)] = False
        share = self.drive.missing
        if share > 0.0:
            kept[rng.random(time_s.size) < 0.5 * share] = False
            for start in np.flatnonzero(rng.random(time_s.size) < 0.5 * share / 20.0):
                kept[start : start + int(rng.integers(2, 40))] = False
        return kept

    def shift_ns(self, n: int) -> np.ndarray:
        """Return what the stamps are off, (n,) int64 ns; stamps keep their order."""
        rng = np.random.default_rng([self.seed, 13])
        off = np.clip(self.drive.jitter * rng.standard_normal(n), -0.4, 0.4)
        return np.rint(off * 1e9 / self.drive.rate_hz).astype(np.int64)
