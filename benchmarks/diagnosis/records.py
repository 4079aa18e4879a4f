"""Recordings of the study, with their truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from drives import Drive, Recorder

from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects import Effect, Trace, compose
from friction_estimator.rig.law import Law, Scaled, scaled_theory
from friction_estimator.rig.plant import PLANTS
from friction_estimator.rig.profiles import Geometry
from friction_estimator.rig.sensors import as_samples, force_noise
from friction_estimator.rig.simulate import Scenario, Simulation, change_alone, clean_trace, effect_seeds

AR_POLE = 0.7

WRONG_THEORIES = {
    "40 % low": {"contact_width": 0.6, "inlet_gradient": 0.6},
    "40 % high": {"contact_width": 1.4, "inlet_gradient": 1.4},
    "boundary 40 % high": {"boundary_friction": 1.4},
    "viscosity 40 % low": {"viscosity_40": 0.6, "viscosity_100": 0.6},
    "without its dip": {"roughness": 1e3},
}
"""Factors on the parameters of the theory that the diagnosis is given. A rough seal is all boundary: Coulomb."""


@dataclass(frozen=True)
class Made:
    """A recording with its truth; arrays are those of the samples.

    Attributes
    ----------
    samples : as a reader gives them. config : what the user of the diagnosis would give.
    effects : hidden, resolved. changes_N : what each makes of the clean friction. clean_N, noise_N : of the force.
    law : of the plant, with its scale.
    """

    samples: Samples
    config: Config
    effects: tuple[Effect, ...]
    changes_N: tuple[np.ndarray, ...]
    clean_N: np.ndarray
    noise_N: np.ndarray
    law: Law

    @property
    def sizes(self) -> tuple[float, ...]:
        """Rms of each change over that of the clean friction."""
        rms = np.sqrt(np.mean(np.square(self.clean_N)))
        return tuple(float(np.sqrt(np.mean(np.square(change))) / rms) for change in self.changes_N)


def make(
    drive: Drive,
    plant: str,
    effects: Sequence[Effect],
    noise: float,
    seed: int,
    *,
    coloured: bool = False,
    theory: str = "",
) -> Made:
    """Simulate a recording.

    Parameters
    ----------
    drive, plant : what runs. effects : hidden in it.
    noise : rms over that of the clean friction; white, or AR(1) where it is `coloured`.
    theory : a key of WRONG_THEORIES, or nothing for the right one.
    """
    recorder = Recorder.of(drive, seed)
    seal = scaled_theory(SealConfig(), drive.force, drive.motion)
    geometry = Geometry(0.020 * drive.motion, 0.100 * drive.motion)
    scenario = Scenario(
        drive.segments(recorder.stretch),
        plant=plant,
        rate_hz=drive.rate_hz,
        seed=seed,
        effects=tuple(effects),
        geometry=geometry,
        seal=seal,
    )
    law = Scaled(PLANTS[plant](SealConfig(), drive.rate_hz), drive.force, drive.motion)
    clean, every = clean_trace(scenario, law), scenario.every
    recorded = clean.sampled(every)
    noise_N = _noise(recorded, noise, seed, coloured)
    trace, ready = compose(clean, effects, noise=noise_N, every=every, seed=seed)
    changes = [
        change_alone(effect, clean, every, np.random.default_rng(own))
        for effect, own in zip(ready, effect_seeds(seed, len(ready)), strict=True)
    ]
    kept = recorder.keep(recorded.time_s)
    shift = recorder.shift_ns(recorded.time_s.size)
    trace = replace(trace, stamp_ns=trace.stamp_ns + shift, friction_stamp_ns=trace.friction_stamp_ns + shift)
    samples = as_samples(trace)
    run = Simulation(
        scenario=scenario,
        samples=_part(samples, kept),
        friction_stamp_ns=trace.friction_stamp_ns[kept],
        clean_N=recorded.friction_N[kept],
        effects=tuple(ready),
        changes_N=tuple(change[kept] for change in changes),
        noise_N=noise_N[kept],
        theory_N=np.zeros(int(kept.sum())),
    )
    paired = run.paired()
    if len(paired) != len(run.samples):
        raise RuntimeError(f"the reader left out {len(run.samples) - len(paired)} samples")
    return Made(paired, _config(seal, theory), run.effects, run.changes_N, run.clean_N, run.noise_N, law)


def _config(seal: SealConfig, theory: str) -> Config:
    factors = WRONG_THEORIES[theory] if theory else {}
    return replace(Config(), seal=replace(seal, **{name: getattr(seal, name) * by for name, by in factors.items()}))


def _noise(recorded: Trace, noise: float, seed: int, coloured: bool):
    """Return white noise, or AR(1) noise of the same rms, (n,), N."""
    white = force_noise(recorded.friction_N, noise, seed)
    if not coloured:
        return white
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to import

    return np.sqrt(1.0 - AR_POLE**2) * lfilter([1.0], [1.0, -AR_POLE], white)


def _part(samples: Samples, kept) -> Samples:
    """Return the samples kept."""
    names = ("stamp_ns", "velocity_m_s", "friction_N", "pressure_Pa", "temperature_degC", "position_m")
    restart = np.zeros(int(kept.sum()), np.bool_)
    return Samples(restart=restart, **{name: getattr(samples, name)[kept] for name in names})
