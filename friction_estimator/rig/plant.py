"""The simulated seal. It differs from the identifier's own theory, or Parallel would win by construction."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numba import njit

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.groups import SealConfig
from friction_estimator.effects.trace import Trace

Law = Callable[[Trace], Floats]

RIG_BOUNDARY_FACTOR = 1.3
RIG_ROUGHNESS_FACTOR = 1.5
RIG_ASYMMETRY = 0.3
RIG_FILM_LAG_S = 0.002

CLEAN_TAPS = (0.80, 0.15, 0.05)
"""Impulse response of the clean plant, one tap a recorded sample; its gain is one."""


class RigPlant:
    """The realistic plant: rougher, more boundary friction, unlike directions, and a film that lags.

    Formula::

        tau_f dE/dt = e(v) - E,    f = d(v, film built by E; mu_b x 1.3, sigma x 1.5, asym 0.3)

    with e = |v| tanh(|v|/v_s) / (1 + asym S) the speed that feeds the film (see SealCurve) and E its first-order
    lag: the film that is there was built a moment ago. The Hammerstein structures cannot represent it, since the
    lag sits in front of the nonlinearity.

    Parameters
    ----------
    seal : the identifier's theory, from which the plant departs.
    rate_hz : of the recording; not used.
    film_lag_s : tau_f, s. 2 ms (frictional memory of line contacts is reported at a few ms, Hess and Soom 1990)
        leaves the parallel structure 2.4 % of the friction unexplained at condition b (T = 1 s) and a tenth of that
        at a and c (T = 5 s), where the motion is slow beside it.
    """

    def __init__(self, seal: SealConfig, rate_hz: float, film_lag_s: float = RIG_FILM_LAG_S) -> None:  # noqa: ARG002
        self.curve = SealCurve(
            replace(
                seal,
                boundary_friction=seal.boundary_friction * RIG_BOUNDARY_FACTOR,
                roughness=seal.roughness * RIG_ROUGHNESS_FACTOR,
                asymmetry=RIG_ASYMMETRY,
            )
        )
        self.film_lag_s = film_lag_s

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        fed = _entrainment(self.curve, trace)
        lagged = np.empty_like(fed)
        _first_order_lag(fed, math.exp(-trace.step_s / self.film_lag_s), lagged)
        return _on_film(self.curve, trace, lagged)


class CleanPlant:
    """The plant that the diagnosis base (theory + odd static g + FIR) can learn whole, so that the truth is known.

    Formula::

        f[k] = sum_i h_i (d + g)(v[k-i]),    h = 0.80, 0.15, 0.05 at the recording's rate
        g(v) = 0.6 tanh(v/0.01) - 3 v      (N, v in m/s)

    with d the identifier's theory. g is odd and smooth: a lip that is drier than the theory says and shears less oil.

    Parameters
    ----------
    seal : the identifier's theory.
    rate_hz : of the recording, Hz.
    """

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:
        self.curve = SealCurve(seal)
        self._spacing_s = 1.0 / rate_hz

    @staticmethod
    def extra(velocity_m_s: Floats) -> Floats:
        """Return g(v), (n,), N."""
        return np.asarray(0.6 * np.tanh(velocity_m_s / 0.01) - 3.0 * velocity_m_s)

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        static = _on_film(self.curve, trace, _entrainment(self.curve, trace)) + self.extra(trace.velocity_m_s)
        every = max(1, round(self._spacing_s / trace.step_s))
        friction = np.zeros_like(static)
        for i, tap in enumerate(CLEAN_TAPS):
            lag = min(i * every, static.size)
            friction[:lag] += tap * static[0]
            friction[lag:] += tap * static[: static.size - lag]
        return friction


def _entrainment(curve: SealCurve, trace: Trace) -> Floats:
    """Return the speed that feeds the film: film speed times its smooth sign, by the direction's share."""
    fed = trace.film_speed_m_s * np.tanh(trace.film_speed_m_s / curve.seal.sign_velocity)
    way = np.tanh(trace.velocity_m_s / curve.seal.sign_velocity)
    return np.asarray(fed / (1.0 + curve.seal.asymmetry * way))


def _on_film(curve: SealCurve, trace: Trace, entrainment_m_s: Floats) -> Floats:
    return curve.on_film(
        trace.velocity_m_s,
        entrainment_m_s,
        trace.pressure_Pa,
        trace.temperature_degC,
        trace.viscosity_factor,
        trace.boundary_factor,
    )


@njit(cache=True)
def _first_order_lag(signal, decay, lagged):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `lagged`: y += (1 - decay)(x - y), started in equilibrium."""
    y = signal[0]
    for k in range(signal.size):
        y += (1.0 - decay) * (signal[k] - y)
        lagged[k] = y


PLANTS: Registry[Callable[[SealConfig, float], Law]] = Registry("plant")
"""Builders of friction laws by name, from the theory's parameters and the recording's rate."""

PLANTS.register("rig", RigPlant)
PLANTS.register("clean", CleanPlant)
