"""Simulated seals around the theory's film. None is the identifier's own theory, or it would win by construction."""

from dataclasses import replace

import numpy as np

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects.trace import Trace
from friction_estimator.rig.law import Plant, entrainment, filtered, lagged, on_film, static_theory

RIG_BOUNDARY_FACTOR = 1.3
RIG_ROUGHNESS_FACTOR = 1.5
RIG_ASYMMETRY = 0.3
RIG_FILM_LAG_S = 0.002

CLEAN_TAPS = (0.80, 0.15, 0.05)
"""Impulse response of the clean plant, one tap a recorded sample; its gain is one."""

FILM_GAIN = 1.15
FILM_LAG_S = 0.006

MISMATCH_TAPS = (0.40, 0.25, 0.15, 0.10, 0.06, 0.04)
"""Impulse response of the parallel plant's mismatch, one tap a recorded sample; its gain is one."""


class RigPlant(Plant):
    """The realistic plant: rougher, more boundary friction, unlike directions, and a film that lags.

    Formula::

        tau_f dE/dt = e(v) - E,    f = d(v, film built by E; mu_b x 1.3, sigma x 1.5, asym 0.3)

    with e = |v| tanh(|v|/v_s) / (1 + asym S) the speed that feeds the film (see SealCurve) and E its first-order
    lag: the film that is there was built a moment ago. The Hammerstein structures cannot represent it, since the
    lag sits in front of the nonlinearity. More boundary friction at the same viscosity is another share of the
    pressure than the theory's, too.

    Parameters
    ----------
    seal, rate_hz : see Plant; the rate is not used.
    film_lag_s : tau_f, s. 2 ms (frictional memory of line contacts is reported at a few ms, Hess and Soom 1990)
        leaves the parallel structure 2.4 % of the friction unexplained at condition b (T = 1 s) and a tenth of that
        at a and c (T = 5 s), where the motion is slow beside it.
    """

    traits = ("direction_asymmetry", "frictional_lag", "pressure_dependence")

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
        fed = lagged(entrainment(self.curve, trace), trace.step_s, self.film_lag_s)
        return on_film(self.curve, trace, fed)


class CleanPlant(Plant):
    """The plant that the diagnosis base (theory + odd static g + FIR) can learn whole, so that the truth is known.

    Formula::

        f[k] = sum_i h_i (d + g)(v[k-i]),    h = 0.80, 0.15, 0.05 at the recording's rate
        g(v) = 0.6 tanh(v/0.01) - 3 v      (N, v in m/s)

    with d the identifier's theory. g is odd and smooth: a lip that is drier than the theory says and shears less oil.
    """

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:
        self.curve = SealCurve(seal)
        self._rate_hz = rate_hz

    @staticmethod
    def extra(velocity_m_s: Floats) -> Floats:
        """Return g(v), (n,), N."""
        return np.asarray(0.6 * np.tanh(velocity_m_s / 0.01) - 3.0 * velocity_m_s)

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        static = static_theory(self.curve, trace) + self.extra(trace.velocity_m_s)
        return filtered(static, CLEAN_TAPS, trace, self._rate_hz)


class FilmLagPlant(Plant):
    """A lag in front of the nonlinearity and nothing else that the base cannot learn: symmetric, the theory's film.

    Formula::

        tau_f dE/dt = e(v) - E,    f = 1.15 d(v, film built by E) + g(v)
        g(v) = 8 v / (1 + |v|/0.05) - 0.4 tanh(v/0.02)      (N, v in m/s)

    Parameters
    ----------
    seal, rate_hz : see Plant; the rate is not used.
    film_lag_s : tau_f, s: 6 ms, within the 3 to 9 ms that Hess and Soom (1990) measured on lubricated line contacts.
    """

    traits = ("frictional_lag",)

    def __init__(self, seal: SealConfig, rate_hz: float, film_lag_s: float = FILM_LAG_S) -> None:  # noqa: ARG002
        self.curve = SealCurve(seal)
        self.film_lag_s = film_lag_s

    @staticmethod
    def extra(velocity_m_s: Floats) -> Floats:
        """Return g(v), (n,), N."""
        saturating = 8.0 * velocity_m_s / (1.0 + np.abs(velocity_m_s) / 0.05)
        return np.asarray(saturating - 0.4 * np.tanh(velocity_m_s / 0.02))

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        fed = lagged(entrainment(self.curve, trace), trace.step_s, self.film_lag_s)
        return np.asarray(FILM_GAIN * on_film(self.curve, trace, fed) + self.extra(trace.velocity_m_s))


class ParallelMemoryPlant(Plant):
    """The paper's parallel structure with unlike memories: the theory passes through, an FIR acts on the mismatch.

    Formula::

        f = d + H2 g,    h2 = 0.40, 0.25, 0.15, 0.10, 0.06, 0.04 at the recording's rate
        g(v) = 0.9 tanh(v/0.02) - 6 v      (N, v in m/s)

    One filter on the sum cannot follow it. No effect of the catalogue is in it.
    """

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:
        self.curve = SealCurve(seal)
        self._rate_hz = rate_hz

    @staticmethod
    def extra(velocity_m_s: Floats) -> Floats:
        """Return g(v), (n,), N."""
        return np.asarray(0.9 * np.tanh(velocity_m_s / 0.02) - 6.0 * velocity_m_s)

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        memory = filtered(self.extra(trace.velocity_m_s), MISMATCH_TAPS, trace, self._rate_hz)
        return np.asarray(static_theory(self.curve, trace) + memory)
