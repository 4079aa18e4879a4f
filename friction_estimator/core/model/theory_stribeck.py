"""The Stribeck curve: Coulomb, Stribeck and viscous friction, unlike in the two directions, as a compiled loop."""

import math
from dataclasses import astuple, dataclass, fields, replace

import numpy as np
from numba import types

from friction_estimator.compiled import njit
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Floats, Ints

# Places in the packed parameter array; the order is that of the fields of Stribeck.
(
    _COULOMB_NEG, _COULOMB_POS, _STRIBECK_NEG, _STRIBECK_POS, _VISCOUS_NEG, _VISCOUS_POS, _SIGN_VELOCITY,
    _STRIBECK_VELOCITY, _EXPONENT, _LOW, _HIGH,
) = range(11)  # fmt: skip

_READ = types.Array(types.float64, 1, "C", readonly=True)
_LOOP_SIGNATURE = types.void(_READ, _READ, types.int64[::1], types.float64[::1])


@dataclass(frozen=True)
class Stribeck:
    """Parameters of the curve, negative direction first; forces act against the motion, so each is usually positive.

    Attributes
    ----------
    coulomb_neg, coulomb_pos : Coulomb friction Fc, N.
    stribeck_neg, stribeck_pos : what friction exceeds it by at breakaway, dF, N.
    viscous_neg, viscous_pos : viscous friction Fv, N s/m.
    sign_velocity : velocity w of the smooth sign, m/s.
    stribeck_velocity : velocity vs at which the excess has fallen to 1/e of it, m/s.
    exponent : p of the fall.
    low, high : velocities, m/s, beyond which friction stays what it is there: what was not seen is not extrapolated.
    """

    coulomb_neg: float
    coulomb_pos: float
    stribeck_neg: float
    stribeck_pos: float
    viscous_neg: float
    viscous_pos: float
    sign_velocity: float
    stribeck_velocity: float
    exponent: float
    low: float
    high: float

    @classmethod
    def of(cls, values: tuple[float, ...], where: str) -> "Stribeck":
        """Return the parameters in the order of the fields; ConfigError names `where` they come from.

        >>> Stribeck.of((1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.1, 1.0, -1.0, 1.0), "learned.stribeck").coulomb_pos
        1.0
        """
        names = [item.name for item in fields(cls)]
        if len(values) != len(names):
            raise ConfigError(f"{where} has {len(values)} values: give {len(names)}, {', '.join(names)}")
        found = cls(*values)
        for name in ("sign_velocity", "stribeck_velocity", "exponent"):
            if not getattr(found, name) > 0.0:
                raise ConfigError(f"{where}: {name} is {getattr(found, name):g}: give a positive number")
        if not found.low < found.high:
            raise ConfigError(f"{where}: low is {found.low:g} and high {found.high:g}: give the lower one first")
        return found

    @property
    def odd(self) -> "Stribeck":
        """The curve that is alike in both directions: the mean of the two."""
        pairs = ("coulomb", "stribeck", "viscous")
        mean = {name: 0.5 * (getattr(self, f"{name}_neg") + getattr(self, f"{name}_pos")) for name in pairs}
        return replace(self, **{f"{name}_{side}": mean[name] for name in pairs for side in ("neg", "pos")})

    @property
    def values(self) -> tuple[float, ...]:
        """The parameters in the order of the fields."""
        return astuple(self)


@njit(_LOOP_SIGNATURE, cache=True, nogil=True)
def stribeck_loop(velocity, par, counts, friction):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `friction`, (n,); see StribeckCurve.

    A velocity that stays is not evaluated again: the loop-carried dependence keeps the compiler from vectorised tanh
    and exp, whose last bit may differ from the scalar ones (see `theory_seal.seal_loop`).
    """
    last = math.nan
    value = 0.0
    for k in range(velocity.size):
        v = velocity[k]
        if not par[_LOW] <= v <= par[_HIGH]:
            counts[0] += 1
            v = 0.0 if math.isnan(v) else min(max(v, par[_LOW]), par[_HIGH])
        if v != last:
            side = 1 if v >= 0.0 else 0
            fall = math.exp(-math.pow(abs(v) / par[_STRIBECK_VELOCITY], par[_EXPONENT]))
            level = par[_COULOMB_NEG + side] + par[_STRIBECK_NEG + side] * fall
            value = math.tanh(v / par[_SIGN_VELOCITY]) * level + par[_VISCOUS_NEG + side] * v
            last = v
        friction[k] = value


class StribeckCurve:
    """Coulomb, Stribeck and viscous friction, each direction its own.

    Formula::

        f = tanh(v/w) (Fc + dF exp(-(abs(v)/vs)^p)) + Fv v

    with v held to [low, high] and Fc, dF and Fv those of its direction. Sources: Armstrong-Helouvry, Dupont and Canudas
    de Wit, Automatica 30 (1994) 1083; Bo and Pavelescu 1982 for the exponent. Pressure and temperature play no part.

    >>> curve = StribeckCurve(Stribeck(2.0, 3.0, 0.0, 1.0, 0.0, 10.0, 0.001, 0.01, 2.0, -0.1, 0.1))
    >>> curve.evaluate(np.array([-5.0, 0.0, 0.1, 5.0])).tolist()
    [-2.0, 0.0, 4.0, 4.0]
    """

    loop = staticmethod(stribeck_loop)

    def __init__(self, stribeck: Stribeck) -> None:
        self.stribeck = stribeck
        self._par = np.array(stribeck.values)
        self._counts = np.zeros(1, np.int64)

    @property
    def constants(self) -> dict[str, float]:
        """The numbers of the formula by name: what another language needs to evaluate it."""
        return {item.name.upper(): float(getattr(self.stribeck, item.name)) for item in fields(Stribeck)}

    @property
    def defaulted(self) -> int:
        """Samples whose pressure or temperature was replaced: none, the curve needs neither."""
        return 0

    @property
    def held(self) -> int:
        """Samples so far with a velocity beyond what the curve was found from."""
        return int(self._counts[0])

    @property
    def sign_velocity_m_s(self) -> float:
        """Velocity w of its smooth sign, m/s."""
        return self.stribeck.sign_velocity

    def evaluate(
        self, velocity_m_s: Floats, gauge_pressure_Pa: Floats | None = None, temperature_degC: Floats | None = None
    ) -> Floats:
        """Return the steady-state friction, (n,) N; see TheoryCurve.evaluate."""
        velocity = np.ascontiguousarray(velocity_m_s, np.float64)
        for other in (gauge_pressure_Pa, temperature_degC):
            if other is not None and other.shape != velocity.shape:
                raise ValueError(f"the inputs differ in shape: {velocity.shape}, {other.shape}")
        friction = np.empty(velocity.shape, np.float64)
        stribeck_loop(velocity, self._par, self._counts, friction)
        return friction

    def arguments(
        self,
        velocity_m_s: Floats,
        gauge_pressure_Pa: Floats,  # noqa: ARG002 - every curve is asked alike
        temperature_degC: Floats,  # noqa: ARG002
        friction_N: Floats,
    ) -> tuple[Floats | Ints, ...]:
        """Return what `loop` takes to fill `friction_N`, (n,)."""
        return velocity_m_s, self._par, self._counts, friction_N
