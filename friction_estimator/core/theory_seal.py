"""The seal curve: steady-state friction of a lubricated lip seal from published physics, as a compiled loop."""

import math

import numpy as np
from numba import njit, types

from friction_estimator.core.config import SealConfig
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Floats

LOWEST_TEMPERATURE_DEGC = -40.0
HIGHEST_TEMPERATURE_DEGC = 150.0
LOWEST_GAUGE_PRESSURE_PA = -1.1e5  # below vacuum at sea level nothing is sealed
HIGHEST_GAUGE_PRESSURE_PA = 1e9
HIGHEST_SPEED_M_S = 1e4

# ASTM D341 holds from 0.21 to 2e7 cSt; Barus' exponential is an extrapolation long before exp(40).
_LOWEST_VISCOSITY_CST = 0.21
_HIGHEST_VISCOSITY_CST = 2e7
_HIGHEST_BARUS_EXPONENT = 40.0
_GREENWOOD_TRIPP_DECAY = 1.973
KELVIN = 273.15
_M2_S_PER_CST = 1e-6

# Places in the packed parameter array of the seal kernels (one array argument costs 75 ns, twenty floats more).
(
    _WIDTH_AREA, _WIDTH_PRESSURE, _PRELOAD, _BOUNDARY, _ROUGHNESS, _REST_GAP, _GRADIENT, _VISCOUS, _DENSITY,
    _BARUS, _SIGN_VELOCITY, _ASYMMETRY, _WALTHER_A, _WALTHER_B, _LOW_PRESSURE, _DEFAULT_PRESSURE,
    _DEFAULT_TEMPERATURE, _WIDTH, _SIZE,
) = range(19)  # fmt: skip

# One compiled form for every caller: read-only arrays (bags are read without copying) take the same code.
_READ = types.Array(types.float64, 1, "C", readonly=True)
_SEAL_LOOP_SIGNATURE = types.void(
    _READ, _READ, types.boolean, _READ, _READ, types.float64[::1], types.int64[::1], types.float64[::1]
)


def walther_coefficients(viscosity_40_cSt: float, viscosity_100_cSt: float) -> tuple[float, float]:
    """Return (A, B) of log10 log10 Z = A - B log10(T/K), Z = nu + 0.7 + exp(-1.47 - 1.84 nu - 0.51 nu^2).

    Source: ASTM D341 (Walther's equation), nu in cSt, through the viscosities at 40 and 100 degC.

    Raises ConfigError where the oil does not thin with temperature.
    """
    if not viscosity_100_cSt < viscosity_40_cSt:
        raise ConfigError(
            f"seal.viscosity_100 is {viscosity_100_cSt:g} cSt, not below seal.viscosity_40 "
            f"{viscosity_40_cSt:g} cSt: an oil thins as it warms"
        )
    at_40, at_100 = (
        math.log10(math.log10(nu + 0.7 + math.exp(-1.47 - 1.84 * nu - 0.51 * nu * nu)))
        for nu in (viscosity_40_cSt, viscosity_100_cSt)
    )
    slope = (at_40 - at_100) / math.log10((100.0 + KELVIN) / (40.0 + KELVIN))
    return at_40 + slope * math.log10(40.0 + KELVIN), slope


@njit(cache=True)
def _walther(temperature_degC, a, b):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Kinematic viscosity in cSt (ASTM D341, inverse of Z), held inside the standard's range."""
    level = min(a - b * math.log10(temperature_degC + KELVIN), 1.0)  # 10**10**1 is far above the range
    z = 10.0 ** (10.0**level) - 0.7
    nu = z - math.exp(-0.7487 - 3.295 * z + 0.6119 * z * z - 0.3193 * z * z * z)
    return min(max(nu, _LOWEST_VISCOSITY_CST), _HIGHEST_VISCOSITY_CST)


def kinematic_viscosity(temperature_degC: Floats, viscosity_40_cSt: float, viscosity_100_cSt: float) -> Floats:
    """Return the kinematic viscosity nu(T) of an oil, cSt (ASTM D341).

    Parameters
    ----------
    temperature_degC : (n,) float64, -40 to 150 degC.
    viscosity_40_cSt, viscosity_100_cSt : viscosity at 40 and 100 degC.

    Raises
    ------
    ConfigError
        For a temperature outside -40 to 150 degC or an oil that does not thin as it warms.

    >>> kinematic_viscosity(np.array([40.0, 100.0]), 35.0, 7.3).round(6)
    array([35. ,  7.3])
    """
    a, b = walther_coefficients(viscosity_40_cSt, viscosity_100_cSt)
    return np.array([_walther(checked_temperature(t), a, b) for t in temperature_degC.tolist()], np.float64)


def checked_temperature(temperature_degC: float, name: str = "temperature") -> float:
    """Return the temperature, or raise ConfigError where it is no number from -40 to 150 degC."""
    if not LOWEST_TEMPERATURE_DEGC <= temperature_degC <= HIGHEST_TEMPERATURE_DEGC:
        raise ConfigError(
            f"{name} is {temperature_degC:g} degC, outside {LOWEST_TEMPERATURE_DEGC:g} to "
            f"{HIGHEST_TEMPERATURE_DEGC:g} degC: the viscosity law does not hold there"
        )
    return float(temperature_degC)


@njit(cache=True)
def _entrainment(velocity, par):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """u / (1 + asym S) with u = v S, S = tanh(v/v_s): the speed that feeds the film, m/s, never negative."""
    s = math.tanh(velocity / par[_SIGN_VELOCITY])
    return velocity * s / (1.0 + par[_ASYMMETRY] * s)


@njit(_SEAL_LOOP_SIGNATURE, cache=True)
def _seal_loop(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    velocity, entrainment, steady, pressure, temperature, par, counts, friction
):
    """Fill `friction`; see SealCurve. `entrainment` is read only where not `steady`.

    What depends on p and T alone is kept from sample to sample. That is a third of the cost, and as a
    loop-carried dependence it forbids the compiler vectorised tanh and exp, whose last bit may differ from
    the scalar ones: the reason why one sample and many samples agree to the bit.
    """
    last_p = math.nan
    last_t = math.nan
    nu = 0.0
    contact = width = film_factor = eta = 0.0
    for k in range(velocity.size):
        v, p, t = velocity[k], pressure[k], temperature[k]
        outside = False
        if not abs(v) <= HIGHEST_SPEED_M_S:
            v = 0.0 if math.isnan(v) else math.copysign(HIGHEST_SPEED_M_S, v)
            outside = True
        if math.isnan(p) or math.isnan(t):
            counts[0] += 1
            p = par[_DEFAULT_PRESSURE] if math.isnan(p) else p
            t = par[_DEFAULT_TEMPERATURE] if math.isnan(t) else t
        if not par[_LOW_PRESSURE] <= p <= HIGHEST_GAUGE_PRESSURE_PA:
            p = min(max(p, par[_LOW_PRESSURE]), HIGHEST_GAUGE_PRESSURE_PA)
            outside = True
        if not LOWEST_TEMPERATURE_DEGC <= t <= HIGHEST_TEMPERATURE_DEGC:
            t = min(max(t, LOWEST_TEMPERATURE_DEGC), HIGHEST_TEMPERATURE_DEGC)
            outside = True
        if outside:
            counts[1] += 1

        if p != last_p or t != last_t:
            if t != last_t:
                nu = _M2_S_PER_CST * _walther(t, par[_WALTHER_A], par[_WALTHER_B])
            last_p, last_t = p, t
            contact = par[_PRELOAD] + p
            width = 1.0 + p / par[_WIDTH_PRESSURE]
            gradient = par[_GRADIENT] * contact / (par[_WIDTH] * width)
            eta = par[_DENSITY] * nu * math.exp(min(par[_BARUS] * contact, _HIGHEST_BARUS_EXPONENT))
            film_factor = 8.0 * eta / (9.0 * gradient)

        s = math.tanh(v / par[_SIGN_VELOCITY])
        e = _entrainment(v, par) if steady else max(entrainment[k], 0.0)
        h0 = par[_REST_GAP]
        grown = film_factor * e  # h^2 - h0^2
        h = math.sqrt(h0 * h0 + grown)
        # h - h0 without cancellation, and 1 - chi as expm1: exact near standstill.
        decay = -_GREENWOOD_TRIPP_DECAY * (grown / (h + h0)) / par[_ROUGHNESS]
        dry = math.exp(decay) * par[_BOUNDARY] * contact * s
        wet = -math.expm1(decay) * par[_VISCOUS] * eta * v / h
        friction[k] = par[_WIDTH_AREA] * width * (dry + wet)


class SealCurve:
    """Mixed to hydrodynamic friction of a reciprocating lip seal on the inverse hydrodynamic film.

    Formula::

        p_c = p0 + p;   b = b0 (1 + p/p_b);   N = pi D b p_c;   w = k_w p_c / b
        eta = rho nu(T) exp(alpha p_c)
        S = tanh(v/v_s);   u = v S;   e = u / (1 + asym S)
        h^2 = h0^2 + 8 eta e / (9 w)
        chi = exp(-1.973 (h - h0)/sigma)
        d = pi D b [ chi mu_b p_c S + (1 - chi) phi eta v / h ]

    Sources: Blok's inverse problem of hydrodynamic lubrication for the film under the inlet pressure gradient
    w; exponential fit of the Greenwood-Tripp integral for the asperities' load share chi; ASTM D341 for nu(T);
    Barus for the pressure. Geometry, p0, mu_b and phi are assumptions, each good to a factor of two: the
    shape is physics, the force scale is not measured.

    Parameters
    ----------
    seal : parameters, see SealConfig.
    default_pressure_Pa : gauge pressure of samples without one, Pa.
    default_temperature_degC : temperature of samples without one, degC.

    Raises
    ------
    ConfigError
        For a default temperature outside -40 to 150 degC or an oil that does not thin as it warms.

    >>> curve = SealCurve(SealConfig())
    >>> v = np.array([-0.1, 0.0, 0.1])
    >>> curve.evaluate(v, np.full(3, 344738.0), np.full(3, 54.444)).round(2)
    array([-1.23,  0.  ,  1.23])
    """

    def __init__(
        self,
        seal: SealConfig,
        default_pressure_Pa: float = 344737.8646584,
        default_temperature_degC: float = 54.444444444444,
    ) -> None:
        a, b = walther_coefficients(seal.viscosity_40, seal.viscosity_100)
        par = np.zeros(_SIZE, np.float64)
        par[_WIDTH_AREA] = math.pi * seal.shaft_diameter * seal.contact_width
        par[_WIDTH] = seal.contact_width
        par[_WIDTH_PRESSURE] = seal.width_pressure
        par[_PRELOAD] = seal.preload_pressure
        par[_BOUNDARY] = seal.boundary_friction
        par[_ROUGHNESS] = seal.roughness
        par[_REST_GAP] = seal.rest_gap
        par[_GRADIENT] = seal.inlet_gradient
        par[_VISCOUS] = seal.viscous_factor
        par[_DENSITY] = seal.density
        par[_BARUS] = seal.pressure_viscosity
        par[_SIGN_VELOCITY] = seal.sign_velocity
        par[_ASYMMETRY] = seal.asymmetry
        par[_WALTHER_A], par[_WALTHER_B] = a, b
        # Contact pressure and width stay positive: the lip keeps at least a tenth of its preload.
        lowest = max(LOWEST_GAUGE_PRESSURE_PA, -0.9 * seal.preload_pressure, -0.9 * seal.width_pressure)
        par[_LOW_PRESSURE] = lowest
        par[_DEFAULT_PRESSURE] = default_pressure_Pa
        par[_DEFAULT_TEMPERATURE] = checked_temperature(default_temperature_degC, "theory.default_temperature")
        self.seal = seal
        self._par = par
        self._counts = np.zeros(2, np.int64)

    @property
    def defaulted(self) -> int:
        """Samples so far whose pressure or temperature was NaN and was replaced by the default."""
        return int(self._counts[0])

    @property
    def held(self) -> int:
        """Samples so far with an input outside the curve's range, held at the nearest limit."""
        return int(self._counts[1])

    def evaluate(self, velocity_m_s: Floats, gauge_pressure_Pa: Floats, temperature_degC: Floats) -> Floats:
        """Return the steady-state friction, (n,) N; see TheoryCurve.evaluate."""
        return self._run(velocity_m_s, velocity_m_s, True, gauge_pressure_Pa, temperature_degC)

    def entrainment(self, velocity_m_s: Floats) -> Floats:
        """Return e = v S / (1 + asym S), (n,) m/s: the speed that feeds the film in the steady state."""
        s = np.tanh(velocity_m_s / self.seal.sign_velocity)
        return velocity_m_s * s / (1.0 + self.seal.asymmetry * s)

    def on_film(
        self,
        velocity_m_s: Floats,
        entrainment_m_s: Floats,
        gauge_pressure_Pa: Floats,
        temperature_degC: Floats,
    ) -> Floats:
        """Return the friction on a film that another speed than the present one has built.

        The shear is the present velocity's, the film thickness that of `entrainment_m_s` (n,), m/s, negative
        values counting as zero. With ``entrainment(v)`` it equals ``evaluate(v)`` to rounding.
        """
        return self._run(velocity_m_s, entrainment_m_s, False, gauge_pressure_Pa, temperature_degC)

    def _run(self, velocity: Floats, film: Floats, steady: bool, pressure: Floats, temperature: Floats) -> Floats:
        if not velocity.shape == film.shape == pressure.shape == temperature.shape:
            raise ValueError(
                f"velocity, pressure and temperature differ in shape: {velocity.shape}, {pressure.shape}, "
                f"{temperature.shape}"
            )
        friction = np.empty(velocity.shape, np.float64)
        velocity, film, pressure, temperature = map(np.ascontiguousarray, (velocity, film, pressure, temperature))
        _seal_loop(velocity, film, steady, pressure, temperature, self._par, self._counts, friction)
        return friction
