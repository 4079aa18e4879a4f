"""The rig simulation: a scenario in, a recording with its truth out; the same seed gives the same bits."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, PRESSURE, TEMPERATURE, VELOCITY
from friction_estimator.core.model.oil import checked_temperature
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats, Ints, Samples, in_sequence
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects import STAGES, Effect, Trace, compose
from friction_estimator.rig.drive import Segment, celsius, run_drive
from friction_estimator.rig.plant import PLANTS, Law
from friction_estimator.rig.profiles import Geometry
from friction_estimator.rig.sensors import START_NS, as_samples, force_noise, stamps

SIMULATION_RATE_HZ = 2000.0
"""The plant runs at least this fast, at a whole multiple of the recording's rate."""

BETWEEN_SAMPLES = 8
"""Steps a recorded sample at least where the force is late: what turns within a sample is not smeared."""

MOST_STEPS = 50_000_000


@dataclass(frozen=True)
class Scenario:
    """What is simulated.

    Attributes
    ----------
    segments : what the drive does; see `parse_schedule`.
    plant : name in PLANTS.
    rate_hz : of the recording.
    noise : rms of the force noise over rms of the clean friction.
    seed : of everything random.
    effects : hidden in the run, in any order; they act in the order of their stages.
    temperature_degC : of the oil.
    geometry : eccentric and rod.
    seal : the identifier's theory, from which the plants depart.
    start_ns : stamp of the first sample.
    """

    segments: tuple[Segment, ...]
    plant: str = "rig"
    rate_hz: float = 1000.0
    noise: float = 0.01
    seed: int = 0
    effects: tuple[Effect, ...] = ()
    temperature_degC: float = celsius(130.0)
    geometry: Geometry = field(default_factory=Geometry)
    seal: SealConfig = field(default_factory=SealConfig)
    start_ns: int = START_NS

    def __post_init__(self) -> None:
        if not self.segments:
            raise ConfigError("the schedule is empty: give at least one segment")
        if not 1.0 <= self.rate_hz <= 1e5:
            raise ConfigError(f"a rate of {self.rate_hz:g} Hz: give 1 to 100000 Hz")
        if not 0.0 <= self.noise <= 10.0:
            raise ConfigError(f"a noise of {self.noise:g}: give 0 to 10 times the rms of the clean friction")
        if self.seed < 0:
            raise ConfigError(f"a seed of {self.seed}: give 0 or a positive integer")
        checked_temperature(self.temperature_degC, "the temperature")
        PLANTS[self.plant]
        shortest = min(part.period_s for part in self.segments)
        if shortest * self.rate_hz < 8.0:
            raise ConfigError(
                f"a drive period of {shortest:g} s at {self.rate_hz:g} Hz has {shortest * self.rate_hz:.2g} samples: "
                "raise the rate or the period to at least 8"
            )
        if self.duration_s * self.rate_hz * self.every > MOST_STEPS:
            raise ConfigError(
                f"{self.duration_s:g} s at {self.rate_hz:g} Hz is too long for one simulation: "
                f"stay below {MOST_STEPS / self.rate_hz / self.every:.0f} s"
            )

    @property
    def duration_s(self) -> float:
        """Length of the run, s: whole cycles."""
        return sum(part.duration_s for part in self.segments)

    @property
    def every(self) -> int:
        """Simulation steps a recorded sample."""
        least = BETWEEN_SAMPLES if any(effect.delays for effect in self.effects) else 1
        return max(least, math.ceil(SIMULATION_RATE_HZ / self.rate_hz - 1e-9))


@dataclass(frozen=True)
class Simulation:
    """A simulated recording with its truth; arrays are (n,) at the recording's rate.

    Attributes
    ----------
    scenario : what was simulated.
    samples : the channels as they are recorded, stamps of the motion; `paired` gives them as a reader sees them.
    friction_stamp_ns : stamps of the force channel; they differ from the motion's where a clock is at fault.
    clean_N : friction of the plant without effects and noise, N.
    effects : as they were applied, `size` turned into values.
    changes_N : what each effect makes of the clean friction when it acts alone, N.
    noise_N : noise of the force channel, N.
    theory_N : the identifier's theory at the true motion, N.
    """

    scenario: Scenario
    samples: Samples
    friction_stamp_ns: Ints
    clean_N: Floats
    effects: tuple[Effect, ...]
    changes_N: tuple[Floats, ...]
    noise_N: Floats
    theory_N: Floats

    @property
    def sizes(self) -> tuple[float, ...]:
        """Rms of each change over rms of the clean friction."""
        power = float(np.mean(np.square(self.clean_N)))
        return tuple(math.sqrt(float(np.mean(np.square(change))) / power) for change in self.changes_N)

    @cached_property
    def _events(self) -> tuple[Ints, Ints, Floats]:
        """Messages (stream, stamp, value) in the order of their sending."""
        s = self.samples
        channels = [
            (PRESSURE, s.stamp_ns, s.pressure_Pa),
            (TEMPERATURE, s.stamp_ns, s.temperature_degC),
            (POSITION, s.stamp_ns, s.position_m),
            (VELOCITY, s.stamp_ns, s.velocity_m_s),
            (FRICTION, self.friction_stamp_ns, s.friction_N),
        ]
        shape = len(s), len(channels)
        stream = np.broadcast_to(np.array([c[0] for c in channels], np.int64), shape)
        stamp = np.column_stack([c[1] for c in channels])
        value = np.column_stack([c[2] for c in channels if c[2] is not None])
        return stream.ravel(), stamp.ravel(), value.ravel()

    def paired(self, config: Config | None = None) -> Samples:
        """Return the samples that a reader pairs and admits under `sync.*` (default configuration unless given)."""
        intake = Intake(config or Config(), capacity=len(self.samples) + 1)
        samples, last = intake.push(*self._events), intake.drain()
        return samples if last is None else in_sequence([samples, last])


def simulate(scenario: Scenario, law: Law | None = None) -> Simulation:
    """Run the rig.

    Order: drive; lubrication effects; the plant's law; effects of friction, mechanics and transmission; sampling
    and noise; effects of the sensor and of the stamps.

    Parameters
    ----------
    scenario : what to simulate.
    law : friction law in place of the plant that the scenario names.

    Raises
    ------
    ConfigError : an effect cannot reach its size on this drive.

    >>> from friction_estimator.rig.drive import segment
    >>> run = simulate(Scenario((segment(1.0, 50.0, 2.0),), rate_hz=200.0))
    >>> len(run.samples), run.samples.sample_rate_hz
    (400, 200.0)
    """
    clean = clean_trace(scenario, law or PLANTS[scenario.plant](scenario.seal, scenario.rate_hz))
    recorded = clean.sampled(scenario.every)
    noise = force_noise(recorded.friction_N, scenario.noise, scenario.seed)
    trace, effects = compose(clean, scenario.effects, noise=noise, every=scenario.every, seed=scenario.seed)
    return Simulation(
        scenario=scenario,
        samples=as_samples(trace),
        friction_stamp_ns=trace.friction_stamp_ns,
        clean_N=recorded.friction_N,
        effects=tuple(effects),
        changes_N=tuple(
            change_alone(effect, clean, scenario.every, np.random.default_rng(seed))
            for effect, seed in zip(effects, effect_seeds(scenario.seed, len(effects)), strict=True)
        ),
        noise_N=noise,
        theory_N=SealCurve(scenario.seal).evaluate(
            recorded.velocity_m_s, recorded.pressure_Pa, recorded.temperature_degC
        ),
    )


def clean_trace(scenario: Scenario, law: Law) -> Trace:
    """Return the run without effects and noise, at the simulation's rate."""
    rate = scenario.rate_hz * scenario.every
    drive = run_drive(scenario.segments, scenario.geometry, rate)
    n = drive.time_s.size
    stamp_ns = stamps(n, rate, scenario.start_ns)
    return Trace(
        time_s=drive.time_s,
        position_m=drive.position_m,
        velocity_m_s=drive.velocity_m_s,
        acceleration_m_s2=drive.acceleration_m_s2,
        pressure_Pa=drive.pressure_Pa,
        temperature_degC=np.full(n, scenario.temperature_degC),
        friction_N=np.zeros(n),
        velocity_measured_m_s=drive.velocity_m_s,
        position_measured_m=drive.position_m,
        stamp_ns=stamp_ns,
        friction_stamp_ns=stamp_ns,
        film_speed_m_s=np.abs(drive.velocity_m_s),
        viscosity_factor=np.ones(n),
        boundary_factor=np.ones(n),
        period_s=drive.period_s,
        law=law,
    ).lubricated()


def change_alone(effect: Effect, clean: Trace, every: int, rng: np.random.Generator) -> Floats:
    """Return what one effect makes of the friction of a clean run, (n,) at the recording's rate, N.

    Parameters
    ----------
    effect : with its size resolved.
    clean : at the simulation's rate.
    every : simulation steps a recorded sample.
    rng : for effects with chance in them.
    """
    coarse = STAGES.index(effect.stage) >= STAGES.index("sensor")
    before = clean.sampled(every) if coarse else clean
    after = effect.apply(before, rng)
    if effect.stage == "lubrication":
        after = after.lubricated()
    change = effect.change(before, after)
    return change if coarse else change[::every]


def effect_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds that `effects.compose` gives to its effects: the truth is about the same draws."""
    return [int(own.generate_state(1)[0]) for own in np.random.SeedSequence(seed).spawn(count + 1)[1:]]
