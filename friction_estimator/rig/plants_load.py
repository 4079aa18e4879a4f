"""Simulated joints that turn a weight: what the drive measures is friction, inertia and gravity together."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from friction_estimator.core.quantities import ROTARY
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects.trace import Trace
from friction_estimator.rig.law import Plant


class LoadedPlant(Plant):
    """A rotary plant: friction, and a load of the terms in `loads`.

    Attributes
    ----------
    loads : coefficients by their names in `load.terms`, SI.
    """

    motion = ROTARY
    loads: ClassVar[Mapping[str, float]] = {}

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:
        pass

    def friction(self, trace: Trace) -> Floats:
        """Return the friction alone, (n,), N m."""
        raise NotImplementedError

    def load(self, trace: Trace) -> Floats:
        """Return inertia and gravity, (n,), N m."""
        q = trace.position_m
        gravity = self.loads["gravity:sin"] * np.sin(q) + self.loads["gravity:cos"] * np.cos(q)
        return np.asarray(self.loads["inertia"] * trace.acceleration_m_s2 + gravity)

    def __call__(self, trace: Trace) -> Floats:
        """Return the measured effort, (n,), N m."""
        return self.friction(trace) + self.load(trace)


class PendulumPlant(LoadedPlant):
    """A weight on a lever, driven directly: 0.5 kg at 0.16 m.

    Formula::

        f = (0.10 + 0.05 exp(-(w/0.6)^2)) tanh(w/0.04) + 0.015 w      (N m, w in rad/s)
        effort = f + 0.021 a + 0.78 sin q

    Source of the friction: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083, eq. 5.
    """

    traits = ("inertia", "gravity")
    loads: ClassVar[Mapping[str, float]] = {"inertia": 0.021, "gravity:sin": 0.78, "gravity:cos": 0.0}

    def friction(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N m."""
        w = trace.velocity_m_s
        return np.asarray((0.10 + 0.05 * np.exp(-np.square(w / 0.6))) * np.tanh(w / 0.04) + 0.015 * w)


class GearedJointPlant(LoadedPlant):
    """A robot's joint behind a gear: unlike directions, and teeth that rub more the more they carry.

    Formula::

        f = (4.0 + 1.5 exp(-|w|/0.3) + 0.03 |load|) tanh(w/0.03) (1 + 0.1 sgn w) + 3 |w|^0.7 sgn w
        effort = f + 1.9 a + 11 sin q + 6 cos q      (N m, w in rad/s)

    with the load that of the lines before last. The share of the load is a few per cent, as in harmonic and planetary
    gears (Hamon, Gautier, Garrec, IROS 2010).
    """

    traits = ("inertia", "gravity", "load_dependence", "direction_asymmetry")
    loads: ClassVar[Mapping[str, float]] = {"inertia": 1.9, "gravity:sin": 11.0, "gravity:cos": 6.0}

    def friction(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N m."""
        w = trace.velocity_m_s
        sign, speed = np.tanh(w / 0.03), np.abs(w)
        coulomb = 4.0 + 1.5 * np.exp(-speed / 0.3) + 0.03 * np.abs(self.load(trace))
        return np.asarray(coulomb * sign * (1.0 + 0.1 * np.sign(w)) + 3.0 * speed**0.7 * np.sign(w))
