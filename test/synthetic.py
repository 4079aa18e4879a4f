"""Drives and known systems that several rooms' tests share: plain arrays, no simulation."""

import numpy as np
from scipy.signal import lfilter

from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import chosen

RATE = 500
MODELS = ("hammerstein", "parallel")


def sine(cycles: float, period_s: float = 5.0, stroke_m: float = 0.02, rate_hz: float = RATE) -> np.ndarray:
    """Velocity of an eccentric, from its fastest point."""
    t = np.arange(int(cycles * period_s * rate_hz)) / rate_hz
    return stroke_m * 2 * np.pi / period_s * np.cos(2 * np.pi * t / period_s)


def samples_of(
    velocity: np.ndarray, friction: np.ndarray, rate_hz: float = RATE, restart_at: tuple[int, ...] = (0,)
) -> Samples:
    stamps = 1 + np.round(np.arange(velocity.size) * 1e9 / rate_hz).astype(np.int64)
    return Samples(stamps, velocity, friction, np.isin(np.arange(velocity.size), restart_at))


def stribeck(velocity: np.ndarray) -> np.ndarray:
    """An odd curve with a Stribeck bend, N."""
    return 4.0 * np.tanh(velocity / 0.004) * (0.4 + 0.6 * np.exp(-np.abs(velocity) / 0.01)) + 20.0 * velocity


def known_system(model_type: str, velocity: np.ndarray) -> np.ndarray:
    """A smooth Stribeck-like map behind a short FIR; the parallel one adds the filtered theory."""
    friction = _filtered([0.6, 0.3, 0.1], stribeck(velocity))
    if model_type == "parallel":
        config = Config.from_mapping({"theory.kind": "seal", "basis.velocity_range": [-1, 1], "force_unit": 1.0})
        d = Model(config).theoretical_friction(samples_of(velocity, velocity))
        friction = 0.3 * friction + _filtered([0.9, 0.2], d)
    return friction


def _filtered(taps: list[float], values: np.ndarray) -> np.ndarray:
    hold = np.concatenate([np.full(8, values[0]), values])
    return lfilter(taps, [1.0], hold)[8:]


def noisy(clean: np.ndarray, noise: float = 0.01, seed: int = 0) -> np.ndarray:
    """Add white noise of `noise` times the rms."""
    sigma = noise * np.sqrt(np.mean(np.square(clean)))
    return clean + sigma * np.random.default_rng(seed).standard_normal(clean.size)


def config_for(samples: Samples, **settings: object) -> Config:
    """Return settings (`__` for `.`) with range and units from the record, and the seal for theory."""
    given = {name.replace("__", "."): value for name, value in settings.items()}
    config = Config.from_mapping({"theory.kind": "seal", **given})
    return chosen(config, samples.velocity_m_s, samples.friction_N)
