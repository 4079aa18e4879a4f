"""The signals of a simulated run, which effects change stage by stage."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from friction_estimator.core.sample import Floats, Ints

STAGES = ("lubrication", "friction", "mechanics", "transmission", "sensor", "stamps")
"""Order in which effects act. The friction law is evaluated after `lubrication`; sampling at the recording's
rate and the sensor noise come between `transmission` and `sensor`."""


@dataclass(frozen=True)
class Trace:
    """A simulated run as arrays of one length, SI units.

    Stages up to `transmission` see it at the simulation's rate (2 kHz or more, eight steps a sample or more where the
    force is late, so that reversals and delays below a sample period are resolved), the later ones at the recording's.

    Attributes
    ----------
    time_s : (n,), s, from 0.
    position_m, velocity_m_s, acceleration_m_s2 : (n,), the true motion.
    pressure_Pa : (n,), sealed gauge pressure, Pa.
    temperature_degC : (n,), degree Celsius.
    friction_N : (n,), running force, N: what the sensor will show at the end.
    velocity_measured_m_s, position_measured_m : (n,), what those channels show.
    stamp_ns, friction_stamp_ns : (n,) int64, header stamps of the motion channels and of the force channel.
    film_speed_m_s : (n,), speed (>= 0) that the lubricating film follows; |v| unless the film lags.
    viscosity_factor, boundary_factor : (n,), multiply the oil's viscosity and the boundary friction coefficient.
    law : friction law of the plant: a trace to friction (n,), N, from velocity, film speed, factors, pressure and
        temperature. Pure.
    period_s : (n,), period of the drive, s; 0 where it has none.
    """

    time_s: Floats
    position_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats
    pressure_Pa: Floats
    temperature_degC: Floats
    friction_N: Floats
    velocity_measured_m_s: Floats
    position_measured_m: Floats
    stamp_ns: Ints
    friction_stamp_ns: Ints
    film_speed_m_s: Floats
    viscosity_factor: Floats
    boundary_factor: Floats
    period_s: Floats
    law: Callable[["Trace"], Floats]

    def __post_init__(self) -> None:
        n = self.time_s.size
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "law" and value.shape != (n,):
                raise ValueError(f"Trace.{item.name} has shape {value.shape}, expected ({n},)")

    @property
    def step_s(self) -> float:
        """Time step, s."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def distance_m(self) -> Floats:
        """Distance run since the start, (n,), m."""
        return np.cumsum(np.abs(self.velocity_m_s)) * self.step_s

    def lubricated(self) -> "Trace":
        """Return the trace with the friction law evaluated anew."""
        return replace(self, friction_N=self.law(self))

    def with_friction(self, friction_N: Floats) -> "Trace":
        """Return the trace with another running force."""
        return replace(self, friction_N=friction_N)

    def sampled(self, every: int) -> "Trace":
        """Return every `every`-th sample."""
        cut = {f.name: getattr(self, f.name)[::every] for f in fields(self) if f.name != "law"}
        return replace(self, **cut)
