"""The runs that the claims are judged by: seeds, conditions, both models, every learner and the batch fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from friction_estimator.core.metrics import drive_cycles
from friction_estimator.core.model.structure import Model, Parameters
from friction_estimator.core.sample import Floats, Ints, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import BasisConfig, LmsConfig
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.core.settings.units import chosen
from friction_estimator.rig.drive import CONDITIONS, PA_PER_PSI, Segment, celsius, segment
from friction_estimator.rig.plants_seal import (
    RIG_ASYMMETRY,
    RIG_BOUNDARY_FACTOR,
    RIG_FILM_LAG_S,
    RIG_ROUGHNESS_FACTOR,
    RigPlant,
)
from friction_estimator.rig.simulate import Scenario, simulate

MODELS = ("hammerstein", "parallel")
BATCH = "batch"
LAST_CYCLES = 5

STEP_SIZES = (0.002, 0.005, 0.01, 0.02)
"""Of the paper's law, which names none."""

DEFAULT_STEP = LmsConfig().step_size

LEARNERS: dict[str, dict[str, object]] = {
    **{
        "lms" if step == DEFAULT_STEP else f"lms {step:g}": {"model.law": "lms", "lms.step_size": step}
        for step in STEP_SIZES
    },
    "nlms": {"model.law": "nlms"},
    "rls": {"model.law": "rls"},
}
"""Name -> settings; `lms` alone is the default step size."""

COMPANDED, PLAIN = BasisConfig().companding, 0.0
"""The bases: this project's, finer near standstill, and the paper's, even in velocity."""

FROZEN_SHARE = 0.5
"""Share of a recording that is learned from where the rest is predicted without learning."""

OTHER_DRIVES = {"triangle": (0.7, 4), "multisine": (3.0, 1)}
"""Drives that differ in kind from the sine: profile -> (its period over the condition's, cycles). The periods keep the
top speed at 0.95 of the sine's: nothing is judged at speeds that were never driven."""

CYCLES_LEARNED = (1, 2, 3, 4, 6, 8, 12, 16, 24, 30)
"""Drive cycles after which what was learned so far is judged frozen, up to the frozen share."""


@dataclass(frozen=True)
class Plan:
    """How much is run.

    Attributes
    ----------
    seeds : recordings of each condition; seeds 0 to seeds - 1.
    seconds : length of each recording.
    rate_hz : sample rate.
    noise : rms of the force noise over that of the clean friction.
    """

    seeds: int = 10
    seconds: float = 60.0
    rate_hz: float = 1000.0
    noise: float = 0.01

    def __str__(self) -> str:
        return (
            f"{self.seeds} seeds (0 to {self.seeds - 1}) of conditions a, b, c, {self.seconds:g} s at "
            f"{self.rate_hz:g} Hz, {100 * self.noise:g} % noise, plant unlike the theory (boundary friction "
            f"x{RIG_BOUNDARY_FACTOR:g}, roughness x{RIG_ROUGHNESS_FACTOR:g}, asymmetry {RIG_ASYMMETRY:g}, film lag "
            f"{1000 * RIG_FILM_LAG_S:g} ms)"
        )


@dataclass(frozen=True)
class Outcome:
    """What one learner, or the batch fit, made of one recording. Errors are rms over the std of measured friction.

    Attributes
    ----------
    cycle_rms : (cycles,), error of each drive cycle while learning.
    reached : (k,) sample, ascending, and (k,) error: from that sample on no window of one cycle errs by more.
    parameters : at the end, normalised units.
    frozen : error over what follows the frozen share, learned up to there.
    elsewhere : the same parameters on `OTHER_DRIVES`, by profile.
    by_cycles : cycles learned -> the errors of the parameters at that moment: {"frozen": .., "triangle": .., ..};
        frozen on the last cycles of the recording.
    frozen_parameters : after the frozen share.
    """

    cycle_rms: Floats
    reached: tuple[Ints, Floats]
    parameters: Parameters
    frozen: float = float("nan")
    elsewhere: Mapping[str, float] = field(default_factory=dict)
    by_cycles: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    frozen_parameters: Parameters | None = None

    @property
    def first(self) -> float:
        """Error of the first drive cycle."""
        return float(self.cycle_rms[0])

    @property
    def last(self) -> float:
        """Error of the last cycles."""
        return float(np.sqrt(np.mean(np.square(self.cycle_rms[-LAST_CYCLES:]))))

    def samples_until(self, level: float) -> float:
        """Return the samples learned from until the error of every later cycle-long window is at most `level`.

        Infinite where the last window is above it.
        """
        samples, errors = self.reached
        there = np.flatnonzero(errors <= level)
        return float(samples[there[0]]) if there.size else float("inf")

    def cycles_until(self, level: float, where: str) -> float:
        """Return the drive cycles learned from until the frozen error `where` is, and stays, at most `level`."""
        counts = sorted(self.by_cycles)
        errors = np.array([self.by_cycles[count][where] for count in counts])
        above = np.flatnonzero(~(errors <= level))
        if not above.size:
            return float(counts[0]) if counts else float("inf")
        return float("inf") if above[-1] + 1 == len(counts) else float(counts[above[-1] + 1])


@dataclass(frozen=True)
class Shown:
    """One recording with the estimates over it, for the figures.

    Attributes
    ----------
    predicted_N : by (model, learner), (n,), while learning. frozen_N : the same after `frozen_from` samples, without.
    """

    samples: Samples
    config: Config
    predicted_N: dict[tuple[str, str], Floats]
    frozen_N: dict[tuple[str, str], Floats]
    frozen_from: int


@dataclass(frozen=True)
class Study:
    """All runs in one basis: `outcomes[condition, seed, model, learner]` (learner may be "batch").

    `yardsticks[condition]` are errors without a model, a list over the seeds of {name: error}: persistence (the guess
    f[k-1], which an error while learning must be read beside), and a static Stribeck curve fitted to the frozen share,
    judged on the rest and on the other drives. `shown` are the recordings of seed 0.
    """

    plan: Plan
    outcomes: dict[tuple[str, int, str, str], Outcome]
    shown: dict[str, Shown]
    yardsticks: Mapping[str, list[dict[str, float]]] = field(default_factory=dict)

    def over_seeds(self, condition: str, model: str, learner: str) -> list[Outcome]:
        """Return the outcomes in the order of their seeds."""
        return [self.outcomes[condition, seed, model, learner] for seed in range(self.plan.seeds)]


def record(plan: Plan, condition: str, seed: int, rate_hz: float | None = None) -> Samples:
    """Return a recording of the rig under one condition."""
    period, pressure = CONDITIONS[condition]
    return _simulated(plan, (segment(period, pressure, plan.seconds),), seed, rate_hz)


def other_drives(plan: Plan, condition: str, seed: int, rate_hz: float | None = None) -> dict[str, Samples]:
    """Return a recording of each of `OTHER_DRIVES` at the pressure of a condition, with noise of its own."""
    period, pressure = CONDITIONS[condition]
    return {
        profile: _simulated(
            plan,
            (segment(factor * period, pressure, cycles * factor * period, profile),),
            1000 + seed,
            rate_hz,
        )
        for profile, (factor, cycles) in OTHER_DRIVES.items()
    }


def longer_drive(plan: Plan, condition: str, seed: int, profile: str) -> Samples:
    """Return a recording of one of `OTHER_DRIVES` as long as the plan's, to be learned from."""
    period, pressure = CONDITIONS[condition]
    factor = OTHER_DRIVES[profile][0]
    return _simulated(plan, (segment(factor * period, pressure, plan.seconds, profile),), 2000 + seed, None)


def _simulated(plan: Plan, segments: tuple[Segment, ...], seed: int, rate_hz: float | None) -> Samples:
    return simulate(Scenario(segments, rate_hz=rate_hz or plan.rate_hz, noise=plan.noise, seed=seed)).paired()


def derived(samples: Samples, model: str, **changes: object) -> Config:
    """Return the default configuration with units from the recording."""
    values = {"model.type": model, "theory.kind": "seal"} | {
        name.replace("__", "."): value for name, value in changes.items()
    }
    return chosen(Config.from_mapping(values), samples.velocity_m_s, samples.friction_N)


def outcome(samples: Samples, predicted_N: Floats, parameters: Parameters) -> Outcome:
    """Score the errors while learning of one estimate of a periodic recording."""
    spread = float(np.std(samples.friction_N))
    error = (samples.friction_N - predicted_N) / spread
    cycles = drive_cycles(samples.velocity_m_s)
    length = int(np.median([part.stop - part.start for part in cycles]))
    # Whole cycles from the first sample on: the record starts at a dead centre.
    starts = np.arange(0, len(samples) - length + 1, length)
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    window = np.sqrt(np.maximum(energy[length:] - energy[:-length], 0.0) / length)
    return Outcome(window[starts], reached(window), parameters)


def reached(window: Floats) -> tuple[Ints, Floats]:
    """Return at which samples the largest error from there on falls, and to what; nothing is below a NaN.

    >>> at, errors = reached(np.array([5.0, 2.0, 3.0, 1.0, 1.0]))
    >>> at.tolist(), errors.tolist()
    ([0, 1, 3], [5.0, 3.0, 1.0])
    """
    later = np.maximum.accumulate(np.where(np.isnan(window), np.inf, window)[::-1])[::-1]
    at = np.concatenate([[0], np.flatnonzero(later[1:] < later[:-1]) + 1]).astype(np.int64)
    return at, later[at]


def assemble(plan: Plan, recorded: Mapping[tuple[str, int], "Recorded"]) -> Study:
    """Return the study from its recordings, by condition and seed."""
    outcomes = {
        (condition, seed, model, learner): result
        for (condition, seed), one in recorded.items()
        for (model, learner), result in one.outcomes.items()
    }
    shown = {condition: one.shown for (condition, _), one in recorded.items() if one.shown is not None}
    yardsticks = {
        condition: [recorded[condition, seed].yardsticks for seed in range(plan.seeds)] for condition in CONDITIONS
    }
    return Study(plan, outcomes, shown, yardsticks)


@dataclass(frozen=True)
class Recorded:
    """What every model and learner made of one recording; `shown` is kept for seed 0 only."""

    outcomes: dict[tuple[str, str], Outcome]
    yardsticks: dict[str, float]
    shown: Shown | None


def static_curves(config: Config, parameters: Parameters, samples: Samples, points: int = 401) -> tuple[Floats, ...]:
    """Return (v, g(v) times the static gain of H, d(v)), N, over the velocities of a recording.

    d is the theoretical curve at the recording's median pressure and temperature.
    """
    model = Model(config)
    v = np.linspace(float(samples.velocity_m_s.min()), float(samples.velocity_m_s.max()), points)
    held = {
        name: np.full(points, float(np.nanmedian(channel)))
        for name in ("pressure_Pa", "temperature_degC")
        if (channel := getattr(samples, name)) is not None
    }
    probe = Samples(np.arange(points), v, np.zeros(points), np.ones(points, np.bool_), **held)
    # A Hammerstein model has no theory of its own; the claims compare its g with that of the parallel one.
    theory = Model(config.updated({"model.type": "parallel"}))
    return v, model.static_map(parameters.theta, v), theory.theoretical_friction(probe)


def plant_curve(condition: str, velocity_m_s: Floats) -> Floats:
    """Return the friction of the simulated seal at constant velocity, (n,), N: what there is to be learned."""
    curve = RigPlant(SealConfig(), 1.0).curve
    pressure = np.full(velocity_m_s.size, CONDITIONS[condition][1] * PA_PER_PSI)
    return curve.evaluate(velocity_m_s, pressure, np.full(velocity_m_s.size, celsius(130.0)))
