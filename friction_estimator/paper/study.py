"""The runs behind Figs. 4 to 6: both models and every law on the three conditions, beside the batch fit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.metrics import drive_cycles
from friction_estimator.core.model.structure import Model, Parameters
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import chosen
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.simulate import Scenario, simulate

MODELS = ("hammerstein", "parallel")
BATCH = "batch"
LAST_CYCLES = 5


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
            f"{self.rate_hz:g} Hz, {100 * self.noise:g} % noise, plant unlike the theory (boundary friction x1.3, "
            "roughness x1.5, asymmetry 0.3, film lag 10 ms)"
        )


@dataclass(frozen=True)
class Outcome:
    """What one law, or the batch fit, made of one recording.

    Attributes
    ----------
    cycle_rms : (cycles,), rms error of each drive cycle over the std of friction in the recording.
    window_rms : (n - cycle + 1,), the same over the window of one cycle that starts at each sample.
    start_nrmse : over the first tenth of the first cycle.
    parameters : at the end, normalised units.
    """

    cycle_rms: Floats
    window_rms: Floats
    start_nrmse: float
    parameters: Parameters

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
        above = np.flatnonzero(~(self.window_rms <= level))
        if not above.size:
            return 0.0
        return float("inf") if above[-1] + 1 >= self.window_rms.size else float(above[-1] + 1)


@dataclass(frozen=True)
class Shown:
    """One recording with the estimates over it, for the figures."""

    samples: Samples
    config: Config
    predicted_N: dict[tuple[str, str], Floats]


@dataclass(frozen=True)
class Study:
    """All runs: `outcomes[condition, seed, model, law]` (law may be "batch") and the recordings of seed 0."""

    plan: Plan
    outcomes: dict[tuple[str, int, str, str], Outcome]
    shown: dict[str, Shown]

    def over_seeds(self, condition: str, model: str, law: str) -> list[Outcome]:
        """Return the outcomes in the order of their seeds."""
        return [self.outcomes[condition, seed, model, law] for seed in range(self.plan.seeds)]


def record(plan: Plan, condition: str, seed: int, rate_hz: float | None = None) -> Samples:
    """Return a recording of the rig under one condition."""
    period, pressure = CONDITIONS[condition]
    scenario = Scenario(
        (segment(period, pressure, plan.seconds),), rate_hz=rate_hz or plan.rate_hz, noise=plan.noise, seed=seed
    )
    return simulate(scenario).paired()


def derived(samples: Samples, model: str, **changes: object) -> Config:
    """Return the default configuration with units from the recording."""
    values = {"model.type": model, "theory.kind": "seal"} | {
        name.replace("__", "."): value for name, value in changes.items()
    }
    return chosen(Config.from_mapping(values), samples.velocity_m_s, samples.friction_N)


def outcome(samples: Samples, predicted_N: Floats, parameters: Parameters) -> Outcome:
    """Score one estimate of a periodic recording."""
    spread = float(np.std(samples.friction_N))
    error = (samples.friction_N - predicted_N) / spread
    cycles = drive_cycles(samples.velocity_m_s)
    length = int(np.median([part.stop - part.start for part in cycles]))
    # Whole cycles from the first sample on: the record starts at a dead centre.
    starts = np.arange(0, len(samples) - length + 1, length)
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    window = np.sqrt(np.maximum(energy[length:] - energy[:-length], 0.0) / length)
    begin = error[: max(1, length // 10)]
    return Outcome(window[starts], window, float(np.sqrt(np.mean(np.square(begin)))), parameters)


@dataclass(frozen=True)
class Recorded:
    """What every model and law made of one recording; `shown` is kept for seed 0 only."""

    outcomes: dict[tuple[str, str], Outcome]
    shown: Shown | None


def run_recording(plan: Plan, condition: str, seed: int) -> Recorded:
    """Simulate one recording and run both models over it: every law, and the batch fit."""
    samples = record(plan, condition, seed)
    outcomes: dict[tuple[str, str], Outcome] = {}
    predictions: dict[tuple[str, str], Floats] = {}
    config = derived(samples, MODELS[0])
    for model in MODELS:
        config = derived(samples, model)
        fit = fit_batch(samples, config)
        predictions[model, BATCH] = fit.predicted_N
        outcomes[model, BATCH] = outcome(samples, fit.predicted_N, fit.parameters)
        for law in LAWS:
            estimator = Estimator(config.updated({"model.law": law}))
            predictions[model, law] = estimator.run(samples)
            outcomes[model, law] = outcome(samples, predictions[model, law], estimator.parameters)
    return Recorded(outcomes, Shown(samples, config, predictions) if seed == 0 else None)


def assemble(plan: Plan, recorded: Mapping[tuple[str, int], Recorded]) -> Study:
    """Return the study from its recordings, by condition and seed."""
    outcomes = {
        (condition, seed, model, law): result
        for (condition, seed), one in recorded.items()
        for (model, law), result in one.outcomes.items()
    }
    shown = {condition: one.shown for (condition, _), one in recorded.items() if one.shown is not None}
    return Study(plan, outcomes, shown)


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
