"""Records that recovery is measured on: a drive of two sines with a simple law, and plants that were not tuned on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.rig.drive import parse_schedule
from friction_estimator.rig.simulate import Scenario, simulate

FORCE_N, SMOOTHING_M_S, VISCOUS_N_S_M = 10.0, 0.002, 50.0
"""Coulomb level, width of its step and viscous coefficient of the law: friction of 10 N scale."""

CYCLE_S = 1.0 / 0.9

HELD_OUT_PLANTS = {
    "rig, sine 1 s": "1:50:70",
    "rig, sine 2 s, 200 psi": "2:200:70",
    "rig, triangle 1 s": "1:50:70:triangle",
    "rig, speed steps 4 s": "4:50:80:speed_steps",
}
"""Schedules of the simulated rig: a film that lags, asymmetric friction, pressure recorded. None was tuned on."""


@dataclass(frozen=True)
class Record:
    """A record without any fault.

    Attributes
    ----------
    samples : as the estimator takes them. cycle_s : of the drive. force_N : the scale of faults, 10 N on the first law.
    """

    samples: Samples
    cycle_s: float
    force_N: float


@dataclass(frozen=True)
class Law:
    """Coulomb and viscous friction; every part can be changed by a factor."""

    coulomb: float = 1.0
    viscous: float = 1.0
    forward: float = 1.0

    def __call__(self, velocity: np.ndarray) -> np.ndarray:
        """Return the friction, N, (n,)."""
        force = FORCE_N * self.coulomb * np.tanh(velocity / SMOOTHING_M_S) + VISCOUS_N_S_M * self.viscous * velocity
        return np.where(velocity > 0.0, self.forward, 1.0) * force


def drive(seconds: float, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
    """Return the velocity of the drive with two sines, m/s, from phases that are drawn."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    first, second = rng.uniform(0.0, 2.0 * np.pi, 2)
    return 0.1 * np.sin(2 * np.pi * 0.9 * time + first) + 0.02 * np.sin(2 * np.pi * 0.313 * time + second)


def synthetic(
    seconds: float, rate_hz: float, seed: int, noise: float, law: Callable[[np.ndarray], np.ndarray] | None = None
) -> Record:
    """Return a record of that drive; noise is relative to `FORCE_N`."""
    rng = np.random.default_rng(seed)
    velocity = drive(seconds, rate_hz, rng)
    force = (law or Law())(velocity) + noise * FORCE_N * rng.standard_normal(velocity.size)
    return Record(sampled(velocity, force, rate_hz), CYCLE_S, FORCE_N)


def sampled(velocity: np.ndarray, force: np.ndarray, rate_hz: float) -> Samples:
    stamps = NS_PER_S + np.round(np.arange(velocity.size) * (NS_PER_S / rate_hz)).astype(np.int64)
    return Samples(stamps, velocity, force, np.arange(velocity.size) == 0)


def rig(schedule: str, rate_hz: float, seed: int, noise: float, plant: str = "rig") -> Record:
    """Return a record of the simulated rig."""
    segments = parse_schedule(schedule)
    samples = simulate(Scenario(segments, plant=plant, rate_hz=rate_hz, noise=noise, seed=seed)).paired()
    return Record(samples, segments[0].period_s, float(np.sqrt(np.mean(np.square(samples.friction_N)))))
