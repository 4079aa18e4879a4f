"""Simulated contacts of another hand than the theory: elasto-slip elements, a measured table, a Stribeck formula."""

from dataclasses import replace

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.effects.trace import Trace
from friction_estimator.rig.law import Plant, static_theory

SLIP_LENGTHS_M = (4e-6, 8e-6, 16e-6, 32e-6, 64e-6, 128e-6)
"""Displacement from rest at which each element slips: presliding of polymers and oiled steel is some um to 0.1 mm."""
SLIP_SHARES = (0.10, 0.15, 0.25, 0.25, 0.15, 0.10)
"""Share of the friction that each element carries; together one."""

TABLE_SPEED_M_S = (0.0, 0.0006, 0.002, 0.005, 0.010, 0.020, 0.035, 0.055, 0.080, 0.110, 0.150)
TABLE_OUT_N = (0.0, 0.62, 1.35, 1.62, 1.58, 1.31, 1.12, 1.09, 1.18, 1.34, 1.55)
TABLE_BACK_N = (0.0, 0.55, 1.16, 1.33, 1.22, 0.98, 0.90, 0.94, 1.07, 1.26, 1.52)
"""Friction beside the theory's share over speed, out and back, as if read off a plot."""
TABLE_THEORY_SHARE = 0.7

STRIBECK_THEORY_SHARE = 0.6


class MaxwellSlipPlant(Plant):
    """Generalised Maxwell-slip: elasto-slip elements side by side in place of the sign of the velocity.

    Formula::

        f = s(v) sum_i a_i z_i,    dz_i = dx / l_i, held within [-1, 1],    sum_i a_i = 1
        s(v) = d(|v|) / tanh(|v|/v_s) + 0.5 - 2 |v|      (N, v in m/s)

    After a reversal friction builds up over the distance 2 l_i of each element, with nonlocal memory; in steady sliding
    it is s(v), the Coulomb and Stribeck level. Source: Al-Bender, Lampaert, Swevers, IEEE TAC 50 (2005) 1883.
    """

    traits = ("presliding",)

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:  # noqa: ARG002
        self.curve = SealCurve(seal)

    @staticmethod
    def elements(trace: Trace) -> Floats:
        """Return sum_i a_i z_i, (n,): 1 in steady sliding forward, -1 backward."""
        moved = np.empty_like(trace.velocity_m_s)
        moved[0] = 0.0
        moved[1:] = 0.5 * (trace.velocity_m_s[1:] + trace.velocity_m_s[:-1]) * trace.step_s
        carried = np.zeros_like(moved)
        _elasto_slip(moved, np.array(SLIP_LENGTHS_M), np.array(SLIP_SHARES), carried)
        return carried

    def level(self, trace: Trace) -> Floats:
        """Return s(v), (n,), N."""
        sign = np.tanh(trace.velocity_m_s / self.curve.seal.sign_velocity)
        theory = static_theory(self.curve, trace)
        # At rest the ratio's limit is that of a speed at which the tangent of tanh still holds to rounding.
        still = np.abs(sign) < 1e-6
        if still.any():
            creep = np.where(still, 1e-6 * self.curve.seal.sign_velocity, trace.velocity_m_s)
            theory = np.where(still, self._at(trace, creep), theory)
            sign = np.where(still, 1e-6, sign)
        return np.asarray(theory / sign + 0.5 - 2.0 * np.abs(trace.velocity_m_s))

    def _at(self, trace: Trace, velocity_m_s: Floats) -> Floats:
        return static_theory(self.curve, replace(trace, velocity_m_s=velocity_m_s))

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        return np.asarray(self.level(trace) * self.elements(trace))


class TabulatedPlant(Plant):
    """A tabulated curve with unlike directions on top of a share of the theory.

    Formula::

        f = 0.7 d + t(|v|, direction) sgn v

    with t monotone cubic between the rows of a table (Fritsch and Carlson 1980) and straight beyond the last: no
    formula of the theory's kind. Both directions start at zero with the speed.
    """

    traits = ("direction_asymmetry",)

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:  # noqa: ARG002
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - slow to import, only this plant needs it

        self.curve = SealCurve(seal)
        self._tables = [PchipInterpolator(TABLE_SPEED_M_S, rows) for rows in (TABLE_OUT_N, TABLE_BACK_N)]

    def extra(self, velocity_m_s: Floats) -> Floats:
        """Return t(|v|, direction) sgn v, (n,), N."""
        speed = np.abs(velocity_m_s)
        last = TABLE_SPEED_M_S[-1]
        beyond = np.maximum(speed - last, 0.0)
        out, back = (t(np.minimum(speed, last)) + beyond * float(t(last, 1)) for t in self._tables)
        return np.asarray(np.where(velocity_m_s > 0.0, out, -back))

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        return np.asarray(TABLE_THEORY_SHARE * static_theory(self.curve, trace) + self.extra(trace.velocity_m_s))


class StribeckPlant(Plant):
    """The textbook: Coulomb, Stribeck and viscous friction, of which the theory tells 60 %; no memory.

    Formula::

        f = 0.6 d + (1.4 + 1.2 exp(-(v/0.03)^2)) tanh(v/0.003) + 9 v      (N, v in m/s)

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083, eq. 5 with exponent 2. No effect of
    the catalogue is in it.
    """

    def __init__(self, seal: SealConfig, rate_hz: float) -> None:  # noqa: ARG002
        self.curve = SealCurve(seal)

    @staticmethod
    def extra(velocity_m_s: Floats) -> Floats:
        """Return what the theory does not tell, (n,), N."""
        level = 1.4 + 1.2 * np.exp(-np.square(velocity_m_s / 0.03))
        return np.asarray(level * np.tanh(velocity_m_s / 0.003) + 9.0 * velocity_m_s)

    def __call__(self, trace: Trace) -> Floats:
        """Return the friction, (n,), N."""
        return np.asarray(STRIBECK_THEORY_SHARE * static_theory(self.curve, trace) + self.extra(trace.velocity_m_s))


@njit(cache=True)
def _elasto_slip(moved, lengths, shares, carried):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `carried` with sum_i a_i z_i for the distances moved; the elements start slipping, as after a long run."""
    start = 0.0
    for k in range(moved.size):
        if moved[k] != 0.0:
            start = 1.0 if moved[k] > 0.0 else -1.0
            break
    for i in range(lengths.size):
        z = start
        for k in range(moved.size):
            z = min(1.0, max(-1.0, z + moved[k] / lengths[i]))
            carried[k] += shares[i] * z
