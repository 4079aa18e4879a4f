"""The drive: what the shaft does, segment by segment, and under which pressure."""

import math
import re
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Floats
from friction_estimator.rig.profiles import PROFILES, Geometry

PA_PER_PSI = 6894.757293168
PRESSURE_RAMP_S = 0.1
"""The pressure of a new segment is reached after this time (or a quarter of the cycle, whichever is shorter)."""

_LONGEST_S = 1e6


def celsius(fahrenheit: float) -> float:
    """Return degree Celsius.

    >>> round(celsius(130.0), 3)
    54.444
    """
    return (fahrenheit - 32.0) / 1.8


@dataclass(frozen=True)
class Segment:
    """Whole cycles of one profile at one pressure.

    Attributes
    ----------
    period_s : period T of the drive, s.
    pressure_Pa : sealed gauge pressure, Pa.
    cycles : number of whole cycles.
    profile : name in PROFILES.
    """

    period_s: float
    pressure_Pa: float
    cycles: int
    profile: str = "sine"

    def __post_init__(self) -> None:
        if not 1e-3 <= self.period_s <= _LONGEST_S:
            raise ConfigError(f"a drive period of {self.period_s:g} s: give 0.001 to {_LONGEST_S:g} s")
        if not -1.1e5 <= self.pressure_Pa <= 1e9:
            raise ConfigError(f"a gauge pressure of {self.pressure_Pa:g} Pa: give -1.1e5 to 1e9 Pa")
        if self.cycles < 1:
            raise ConfigError(f"{self.cycles} cycles: give at least 1")
        PROFILES[self.profile]

    @property
    def duration_s(self) -> float:
        """Length, s."""
        return self.cycles * self.period_s


def segment(period_s: float, pressure_psi: float, seconds: float, profile: str = "sine") -> Segment:
    """Return the segment whose whole cycles come nearest to `seconds`, one at least.

    >>> segment(5.0, 50.0, 12.0).cycles
    2
    """
    if not 0.0 < seconds <= _LONGEST_S:
        raise ConfigError(f"a segment of {seconds:g} s: give more than 0 and at most {_LONGEST_S:g} s")
    cycles = max(1, math.floor(seconds / period_s + 0.5)) if period_s > 0.0 else 1
    return Segment(period_s, pressure_psi * PA_PER_PSI, cycles, profile)


CONDITIONS = {"a": (5.0, 50.0), "b": (1.0, 50.0), "c": (5.0, 200.0)}
"""The paper's Fig. 4: period in s and gauge pressure in psi, all at 130 degF."""
CONDITION_SECONDS = 60.0
"""Length of a condition where none is asked for."""


def parse_schedule(text: str) -> tuple[Segment, ...]:
    """Return the segments of `PERIOD:PRESSURE_PSI:SECONDS[:PROFILE],...` (gauge pressure).

    Each segment holds the number of whole cycles nearest to its SECONDS, one at least: strokes are never cut, and
    position and velocity stay continuous, since every profile starts and ends at rest in the lower dead centre.

    Raises
    ------
    ConfigError
        Naming the part that cannot be read.

    >>> [(s.period_s, s.cycles, s.profile) for s in parse_schedule("5:50:20,1:50:10:crank")]
    [(5.0, 4, 'sine'), (1.0, 10, 'crank')]
    """
    segments = []
    for part in text.split(","):
        words = part.strip().split(":")
        if not 3 <= len(words) <= 4:
            raise ConfigError(f"schedule part {part.strip()!r}: write PERIOD:PRESSURE_PSI:SECONDS[:PROFILE]")
        numbers = []
        for name, word in zip(("PERIOD", "PRESSURE_PSI", "SECONDS"), words, strict=False):
            if not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word.strip()):
                raise ConfigError(f"schedule part {part.strip()!r}: {name} is {word!r}, not a number")
            numbers.append(float(word))
        try:
            profile = words[3].strip() if len(words) > 3 else "sine"
            segments.append(segment(numbers[0], numbers[1], numbers[2], profile))
        except ConfigError as error:
            raise ConfigError(f"schedule part {part.strip()!r}: {error}") from None
    return tuple(segments)


@dataclass(frozen=True)
class Drive:
    """The motion and pressure of a run, arrays (n,).

    Attributes
    ----------
    time_s, position_m, velocity_m_s, acceleration_m_s2 : motion, with its analytic derivatives.
    pressure_Pa : gauge pressure.
    period_s : period of the drive.
    """

    time_s: Floats
    position_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats
    pressure_Pa: Floats
    period_s: Floats


def run_drive(segments: tuple[Segment, ...], geometry: Geometry, rate_hz: float) -> Drive:
    """Return the motion of the segments one after the other, sampled at k / rate_hz.

    Parameters
    ----------
    segments : at least one.
    geometry : of the drive.
    rate_hz : samples a second.

    Returns
    -------
    Drive of floor(total duration * rate_hz) samples, the end point excluded.
    """
    ends = np.cumsum([s.duration_s for s in segments])
    starts = ends - [s.duration_s for s in segments]
    n = math.floor(ends[-1] * rate_hz * (1.0 + 1e-12))
    time = np.arange(n) / rate_hz
    number = np.minimum(np.searchsorted(ends, time, side="right"), len(segments) - 1)
    position, velocity, acceleration, pressure, period = np.empty((5, n))
    before = segments[0].pressure_Pa
    for i, (part, start) in enumerate(zip(segments, starts, strict=True)):
        here = slice(*np.searchsorted(number, [i, i + 1]))
        since = time[here] - start
        cycle = np.floor(since / part.period_s)
        phase = np.clip(since / part.period_s - cycle, 0.0, np.nextafter(1.0, 0.0))
        motion = PROFILES[part.profile](phase, cycle.astype(np.int64), geometry)
        position[here] = motion.position
        velocity[here] = motion.rate / part.period_s
        acceleration[here] = motion.curvature / part.period_s**2
        ramp = np.clip(since / min(PRESSURE_RAMP_S, 0.25 * part.period_s), 0.0, 1.0)
        pressure[here] = before + (part.pressure_Pa - before) * 0.5 * (1.0 - np.cos(np.pi * ramp))
        period[here] = part.period_s
        before = part.pressure_Pa
    return Drive(time, position, velocity, acceleration, pressure, period)
