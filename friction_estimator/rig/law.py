"""What a plant is: a friction law that says which effects of the catalogue it has of its own."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects.trace import Trace

Law = Callable[[Trace], Floats]
"""Friction, (n,), N, of a trace. Pure."""


class Plant:
    """A friction law built from the identifier's theory, from which it departs.

    Parameters
    ----------
    seal : the identifier's theory.
    rate_hz : of the recording, Hz.

    Attributes
    ----------
    traits : effects of the catalogue (ids) that the plant has by itself: a diagnosis may name them with nothing hidden.
        What else it differs in from the theory is odd, static or a short memory, which the diagnosis base can learn.
    motion : LINEAR or ROTARY.
    """

    traits: ClassVar[tuple[str, ...]] = ()
    motion: ClassVar[str] = LINEAR

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:
        raise NotImplementedError

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        raise NotImplementedError


class Scaled:
    """A law on a machine of another size: force times F, motion times s, in the same time.

    Formula::

        f(x, v, p, T) = F law(x/s, v/s, p, T)

    `scaled_theory` is the identifier's theory on that machine.

    Parameters
    ----------
    law : of the usual machine.
    force, motion : the factors F and s.
    """

    def __init__(self, law: Law, force: float, motion: float) -> None:
        for name, factor in (("force", force), ("motion", motion)):
            if not 0.0 < factor < math.inf:
                raise ConfigError(f"a factor of {factor:g} on the {name}: give a positive number")
        self._law, self._force, self._motion = law, force, motion

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        s = self._motion
        usual = replace(
            trace,
            position_m=trace.position_m / s,
            velocity_m_s=trace.velocity_m_s / s,
            acceleration_m_s2=trace.acceleration_m_s2 / s,
            film_speed_m_s=trace.film_speed_m_s / s,
        )
        return np.asarray(self._force * self._law(usual))


def scaled_theory(seal: SealConfig, force: float, motion: float) -> SealConfig:
    """Return the theory with d'(v) = F d(v/s): a wider lip with the film of the usual one.

    Formula::

        b0' = F b0,   v_s' = s v_s,   k_w' = F s k_w,   phi' = phi / s

    since eta e / w with w = k_w p_c / b, and phi eta v / h, then stay what they were (SealCurve).
    """
    return replace(
        seal,
        contact_width=seal.contact_width * force,
        sign_velocity=seal.sign_velocity * motion,
        inlet_gradient=seal.inlet_gradient * force * motion,
        viscous_factor=seal.viscous_factor / motion,
    )


def entrainment(curve: SealCurve, trace: Trace) -> Floats:
    """Return the speed that feeds the film: film speed times its smooth sign, by the direction's share, (n,), m/s."""
    fed = trace.film_speed_m_s * np.tanh(trace.film_speed_m_s / curve.seal.sign_velocity)
    way = np.tanh(trace.velocity_m_s / curve.seal.sign_velocity)
    return np.asarray(fed / (1.0 + curve.seal.asymmetry * way))


def on_film(curve: SealCurve, trace: Trace, entrainment_m_s: Floats) -> Floats:
    """Return the curve's friction on a film that the given speed has built, (n,), N."""
    return curve.on_film(
        trace.velocity_m_s,
        entrainment_m_s,
        trace.pressure_Pa,
        trace.temperature_degC,
        trace.viscosity_factor,
        trace.boundary_factor,
    )


def static_theory(curve: SealCurve, trace: Trace) -> Floats:
    """Return the curve on the film of the trace, (n,), N."""
    return on_film(curve, trace, entrainment(curve, trace))


def lagged(signal: Floats, step_s: float, lag_s: float) -> Floats:
    """Return the first-order lag of a signal, (n,), started in equilibrium."""
    out = np.empty_like(signal)
    _first_order_lag(signal, math.exp(-step_s / lag_s), out)
    return out


def filtered(signal: Floats, taps: tuple[float, ...], trace: Trace, rate_hz: float) -> Floats:
    """Return the signal through an FIR with one tap a recorded sample, (n,), started in equilibrium."""
    every = max(1, round(1.0 / rate_hz / trace.step_s))
    out = np.zeros_like(signal)
    for i, tap in enumerate(taps):
        lag = min(i * every, signal.size)
        out[:lag] += tap * signal[0]
        out[lag:] += tap * signal[: signal.size - lag]
    return out


@njit(cache=True)
def _first_order_lag(signal, decay, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `out`: y += (1 - decay)(x - y), started in equilibrium."""
    y = signal[0]
    for k in range(signal.size):
        y += (1.0 - decay) * (signal[k] - y)
        out[k] = y
