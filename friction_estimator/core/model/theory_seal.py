"""The seal curve: steady-state friction of a lubricated lip seal from published physics, as a compiled loop."""

import math

import numpy as np
from numba import types

from friction_estimator.compiled import njit
from friction_estimator.core.model.oil import (
    HIGHEST_TEMPERATURE_DEGC,
    HIGHEST_VISCOSITY_CST,
    KELVIN,
    LOWEST_TEMPERATURE_DEGC,
    LOWEST_VISCOSITY_CST,
    checked_temperature,
    walther,
    walther_coefficients,
)
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.theory_groups import SealConfig

LOWEST_GAUGE_PRESSURE_PA = -1.1e5  # below vacuum at sea level nothing is sealed
HIGHEST_GAUGE_PRESSURE_PA = 1e9
HIGHEST_SPEED_M_S = 1e4

# Barus' exponential is an extrapolation long before exp(40).
_HIGHEST_BARUS_EXPONENT = 40.0
_GREENWOOD_TRIPP_DECAY = 1.973
_M2_S_PER_CST = 1e-6

# Places in the packed parameter array of the seal kernels (one array argument costs 75 ns, twenty floats more).
(
    _WIDTH_AREA, _WIDTH_PRESSURE, _PRELOAD, _BOUNDARY, _ROUGHNESS, _REST_GAP, _GRADIENT, _VISCOUS, _DENSITY,
    _BARUS, _SIGN_VELOCITY, _ASYMMETRY, _WALTHER_A, _WALTHER_B, _LOW_PRESSURE, _DEFAULT_PRESSURE,
    _DEFAULT_TEMPERATURE, _WIDTH, _SIZE,
) = range(19)  # fmt: skip

_NAMES = (
    "WIDTH_AREA", "WIDTH_PRESSURE", "PRELOAD", "BOUNDARY", "ROUGHNESS", "REST_GAP", "GRADIENT", "VISCOUS", "DENSITY",
    "BARUS", "SIGN_VELOCITY", "ASYMMETRY", "WALTHER_A", "WALTHER_B", "LOW_PRESSURE", "DEFAULT_PRESSURE",
    "DEFAULT_TEMPERATURE", "WIDTH",
)  # fmt: skip

# One compiled form for every caller: read-only arrays (bags are read without copying) take the same code.
_READ = types.Array(types.float64, 1, "C", readonly=True)
_WRITE = types.float64[::1]
_SEAL_LOOP_SIGNATURE = types.void(_READ, _READ, _READ, _READ, types.int64[::1], _WRITE)
_FILM_LOOP_SIGNATURE = types.void(_READ, _READ, _READ, _READ, _READ, _READ, _READ, _WRITE)


@njit(cache=True)
def _entrainment(velocity, par):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """u / (1 + asym S) with u = v S, S = tanh(v/v_s): the speed that feeds the film, m/s, never negative."""
    s = math.tanh(velocity / par[_SIGN_VELOCITY])
    return velocity * s / (1.0 + par[_ASYMMETRY] * s)


@njit(cache=True)
def _contact(pressure, par):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """(p_c, b/b0, w, density times Barus factor): what depends on the pressure alone."""
    contact = par[_PRELOAD] + pressure
    width = 1.0 + pressure / par[_WIDTH_PRESSURE]
    gradient = par[_GRADIENT] * contact / (par[_WIDTH] * width)
    return contact, width, gradient, par[_DENSITY] * math.exp(min(par[_BARUS] * contact, _HIGHEST_BARUS_EXPONENT))


@njit(cache=True)
def _friction(velocity, entrainment, contact, width, gradient, eta, boundary, par):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """d of one sample; see SealCurve."""
    s = math.tanh(velocity / par[_SIGN_VELOCITY])
    h0 = par[_REST_GAP]
    grown = 8.0 * eta * entrainment / (9.0 * gradient)  # h^2 - h0^2
    h = math.sqrt(h0 * h0 + grown)
    # h - h0 without cancellation, and 1 - chi as expm1: exact near standstill.
    decay = -_GREENWOOD_TRIPP_DECAY * (grown / (h + h0)) / par[_ROUGHNESS]
    dry = math.exp(decay) * boundary * contact * s
    wet = -math.expm1(decay) * par[_VISCOUS] * eta * velocity / h
    return par[_WIDTH_AREA] * width * (dry + wet)


@njit(_SEAL_LOOP_SIGNATURE, cache=True, nogil=True)
def seal_loop(velocity, pressure, temperature, par, counts, friction):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `friction`, (n,), with the steady state.

    What depends on p and T alone is kept from sample to sample. That is two thirds of the cost, and as a
    loop-carried dependence it forbids the compiler vectorised tanh and exp, whose last bit may differ from
    the scalar ones: the reason why one sample and many samples agree to the bit.
    """
    last_p = math.nan
    last_t = math.nan
    nu = contact = width = gradient = thickening = 0.0
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
        if t != last_t:
            nu = _M2_S_PER_CST * walther(t, par[_WALTHER_A], par[_WALTHER_B])
            last_t = t
        if p != last_p:
            contact, width, gradient, thickening = _contact(p, par)
            last_p = p
        friction[k] = _friction(v, _entrainment(v, par), contact, width, gradient, nu * thickening, par[_BOUNDARY], par)


@njit(_FILM_LOOP_SIGNATURE, cache=True)
def _film_loop(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    velocity, entrainment, pressure, temperature, viscosity_factor, boundary_factor, par, friction
):
    """Fill `friction`, (n,), on a given film with a changed oil and surface."""
    for k in range(velocity.size):
        p = min(max(pressure[k], par[_LOW_PRESSURE]), HIGHEST_GAUGE_PRESSURE_PA)
        t = min(max(temperature[k], LOWEST_TEMPERATURE_DEGC), HIGHEST_TEMPERATURE_DEGC)
        contact, width, gradient, thickening = _contact(p, par)
        nu = _M2_S_PER_CST * walther(t, par[_WALTHER_A], par[_WALTHER_B]) * viscosity_factor[k]
        boundary = par[_BOUNDARY] * boundary_factor[k]
        e = max(entrainment[k], 0.0)
        friction[k] = _friction(velocity[k], e, contact, width, gradient, nu * thickening, boundary, par)


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

    loop = staticmethod(seal_loop)

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
    def constants(self) -> dict[str, float]:
        """The numbers of the formula and its limits by name, SI units: what another language needs to evaluate it."""
        return {
            **dict(zip(_NAMES, self._par.tolist(), strict=True)),
            "HIGHEST_SPEED": HIGHEST_SPEED_M_S,
            "HIGHEST_PRESSURE": HIGHEST_GAUGE_PRESSURE_PA,
            "LOWEST_TEMPERATURE": LOWEST_TEMPERATURE_DEGC,
            "HIGHEST_TEMPERATURE": HIGHEST_TEMPERATURE_DEGC,
            "HIGHEST_BARUS": _HIGHEST_BARUS_EXPONENT,
            "GREENWOOD_TRIPP": _GREENWOOD_TRIPP_DECAY,
            "KELVIN": KELVIN,
            "LOWEST_VISCOSITY": LOWEST_VISCOSITY_CST,
            "HIGHEST_VISCOSITY": HIGHEST_VISCOSITY_CST,
        }

    @property
    def defaulted(self) -> int:
        """Samples so far whose pressure or temperature was NaN and was replaced by the default."""
        return int(self._counts[0])

    @property
    def held(self) -> int:
        """Samples so far with an input outside the curve's range, held at the nearest limit."""
        return int(self._counts[1])

    @property
    def sign_velocity_m_s(self) -> float:
        """Velocity v_s of its smooth sign, m/s."""
        return self.seal.sign_velocity

    def evaluate(self, velocity_m_s: Floats, gauge_pressure_Pa: Floats, temperature_degC: Floats) -> Floats:
        """Return the steady-state friction, (n,) N; see TheoryCurve.evaluate."""
        velocity, pressure, temperature = _same_length(velocity_m_s, gauge_pressure_Pa, temperature_degC)
        friction = np.empty(velocity.shape, np.float64)
        seal_loop(*self.arguments(velocity, pressure, temperature, friction))
        return friction

    def arguments(
        self, velocity_m_s: Floats, gauge_pressure_Pa: Floats, temperature_degC: Floats, friction_N: Floats
    ) -> tuple[Floats | Ints, ...]:
        """Return what `loop` takes to fill `friction_N`, (n,)."""
        return velocity_m_s, gauge_pressure_Pa, temperature_degC, self._par, self._counts, friction_N

    def entrainment(self, velocity_m_s: Floats) -> Floats:
        """Return e = v S / (1 + asym S), (n,) m/s: the speed that feeds the film in the steady state."""
        s = np.tanh(velocity_m_s / self.seal.sign_velocity)
        return np.asarray(velocity_m_s * s / (1.0 + self.seal.asymmetry * s))

    def on_film(
        self,
        velocity_m_s: Floats,
        entrainment_m_s: Floats,
        gauge_pressure_Pa: Floats,
        temperature_degC: Floats,
        viscosity_factor: Floats,
        boundary_factor: Floats,
    ) -> Floats:
        """Return the friction on a film that another speed than the present one has built.

        The shear is the present velocity's, the film thickness that of the entrainment. With ``entrainment(v)``
        and factors of one it is ``evaluate(v)`` to rounding.

        Parameters
        ----------
        velocity_m_s : (n,).
        entrainment_m_s : (n,), the speed e that built the film; negative values count as zero.
        gauge_pressure_Pa, temperature_degC : (n,), held inside the range of the curve without being counted.
        viscosity_factor, boundary_factor : (n,), multiply eta and mu_b.

        Returns
        -------
        (n,) float64, N.
        """
        velocity, film, pressure, temperature, viscosity, boundary = _same_length(
            velocity_m_s, entrainment_m_s, gauge_pressure_Pa, temperature_degC, viscosity_factor, boundary_factor
        )
        friction = np.empty(velocity.shape, np.float64)
        _film_loop(velocity, film, pressure, temperature, viscosity, boundary, self._par, friction)
        return friction


def _same_length(*arrays: Floats) -> tuple[Floats, ...]:
    """Return contiguous arrays (mostly themselves); ValueError where they differ in shape."""
    shape = arrays[0].shape
    for array in arrays:
        if array.shape != shape:
            raise ValueError(f"the inputs differ in shape: {', '.join(str(a.shape) for a in arrays)}")
    return tuple(map(np.ascontiguousarray, arrays))
