"""The recordings that are read."""

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Samples


def driven(n: int) -> Samples:
    """Return a shaft that swings at 0.5 Hz, 1 kHz, with friction of Coulomb, Stribeck and viscous kind and noise."""
    k = np.arange(n)
    time_s = 1e-3 * k
    velocity = 0.05 * np.sin(np.pi * time_s) * (1.0 + 0.5 * np.sin(0.2 * time_s))
    friction = 12.0 * np.tanh(velocity / 0.002) * (1.0 + 0.4 * np.exp(-((velocity / 0.01) ** 2))) + 80.0 * velocity
    friction += 0.1 * np.random.default_rng(1).standard_normal(n)
    return Samples(1_700_000_000 * NS_PER_S + 1_000_000 * k, velocity, friction, k == 0)
