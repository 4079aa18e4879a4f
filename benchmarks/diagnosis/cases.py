"""Hidden cases by seed: off the regressors' grids, and half of them in another functional form than the regressor."""

from collections.abc import Sequence

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.groups import SealConfig
from friction_estimator.effects import EFFECTS, Effect, compose
from friction_estimator.rig.drive import Segment, segment
from friction_estimator.rig.plant import PLANTS
from friction_estimator.rig.sensors import as_samples
from friction_estimator.rig.simulate import Scenario, Simulation, clean_trace, simulate

RATE_HZ = 200.0
FAULTS = ("velocity_mismatch", "clock_jump", "duplicate_stamps", "stamp_offset")
CATALOGUE = tuple(name for name in EFFECTS if name not in FAULTS)
"""The 26 effects that a diagnosis names after looking at the fit."""


def abba(rate_hz: float = RATE_HZ, samples: int = 25_000) -> tuple[Segment, ...]:
    """Periods 1 s and 5 s at 50 and 200 psi, pressures in ABBA order; the last segment fills up to the length."""
    parts = [(period, psi) for psi in (50.0, 200.0, 200.0, 50.0) for period in (1.0, 5.0)]
    seconds = [10.0 if period == 1.0 else 20.0 for period, _ in parts]
    seconds[-1] += 5.0 * round((samples / rate_hz - sum(seconds)) / 5.0)
    return tuple(segment(period, psi, s) for (period, psi), s in zip(parts, seconds, strict=True))


def duration_s() -> float:
    """Length of an ABBA run, s."""
    return sum(part.duration_s for part in abba())


def hidden(name: str, seed: int, size: float) -> Effect:
    """Draw an effect of a given size: keys at random, log-uniform, and either functional form."""
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    length = duration_s()

    def wide(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    draws: dict[str, dict[str, float]] = {
        "viscosity_drift": {"time_constant": wide(15.0, 80.0)},
        "wear": {"length": wide(0.7, 5.0)},
        "bias_step": {"at": rng.uniform(0.15, 0.85) * length},
        "gain_step": {"at": rng.uniform(0.15, 0.85) * length},
        "breakaway": {"length": wide(1.2e-5, 8e-5), "rest_speed": wide(1e-3, 4e-3)},
        "presliding": {"length": wide(1e-5, 8e-5)},
        "stick_slip": {"frequency": wide(15.0, 60.0), "decay": wide(0.03, 0.15)},
        "squeeze_film": {"speed": wide(5e-3, 3e-2)},
        "viscoelastic_relaxation": {"time_constant": wide(0.1, 1.5)},
        "periodic_disturbance": {"frequency": wide(3.0, 60.0)},
        "position_dependence": {"wavelength": wide(1.5e-3, 1.5e-2), "phase": rng.uniform(-3.1, 3.1)},
        "dropout": {"length": float(rng.integers(3, 13))},
        "outliers": {"fraction": wide(2e-4, 1e-3)},
    }
    values: dict[str, float] = draws.get(name, {})
    cls = EFFECTS[name]
    if any(key.name == "form" for key in cls.keys):
        values["form"] = float(rng.integers(0, 2))
    return cls(size=size, **values)


def record(
    effects: Sequence[Effect],
    noise: float,
    seed: int,
    *,
    segments: tuple[Segment, ...] | None = None,
    plant: str = "clean",
    rate_hz: float = RATE_HZ,
) -> Simulation:
    """Simulate one recording."""
    return simulate(
        Scenario(
            segments=segments or abba(rate_hz),
            plant=plant,
            rate_hz=rate_hz,
            noise=noise,
            seed=seed,
            effects=tuple(effects),
        )
    )


def record_ar(noise: float, seed: int, pole: float = 0.7) -> Simulation:
    """Simulate a recording with nothing hidden and AR(1) noise of the given size."""
    run = record((), noise, seed)
    rng = np.random.default_rng([seed, 9])
    white = rng.standard_normal(run.noise_N.size + 200)
    coloured: Floats = np.zeros(white.size)
    for k in range(1, white.size):
        coloured[k] = pole * coloured[k - 1] + white[k]
    coloured = coloured[200:] * np.sqrt(1.0 - pole**2)
    scenario = run.scenario
    clean = clean_trace(scenario, PLANTS[scenario.plant](SealConfig(), scenario.rate_hz))
    level = noise * float(np.sqrt(np.mean(np.square(run.clean_N))))
    trace, _ = compose(clean, (), noise=level * coloured, every=scenario.every, seed=seed)
    return Simulation(
        scenario=scenario,
        samples=as_samples(trace),
        friction_stamp_ns=trace.friction_stamp_ns,
        clean_N=run.clean_N,
        effects=(),
        changes_N=(),
        noise_N=level * coloured,
        theory_N=run.theory_N,
    )
