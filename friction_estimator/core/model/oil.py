"""Viscosity of an oil against temperature: ASTM D341 (Walther) through two given viscosities."""

import math

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Floats

LOWEST_TEMPERATURE_DEGC = -40.0
HIGHEST_TEMPERATURE_DEGC = 150.0
KELVIN = 273.15

# The range of the standard.
LOWEST_VISCOSITY_CST = 0.21
HIGHEST_VISCOSITY_CST = 2e7


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
def walther(temperature_degC, a, b):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Kinematic viscosity in cSt (ASTM D341, inverse of Z), held inside the standard's range.

    Compiled into the kernels of theory_seal.py: touch that file after a change here, numba's cache looks at it alone.
    """
    level = min(a - b * math.log10(temperature_degC + KELVIN), 1.0)  # 10**10**1 is far above the range
    z = 10.0 ** (10.0**level) - 0.7
    nu = z - math.exp(-0.7487 - 3.295 * z + 0.6119 * z * z - 0.3193 * z * z * z)
    return min(max(nu, LOWEST_VISCOSITY_CST), HIGHEST_VISCOSITY_CST)


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
    return np.array([walther(checked_temperature(t), a, b) for t in temperature_degC.tolist()], np.float64)


def checked_temperature(temperature_degC: float, name: str = "temperature") -> float:
    """Return the temperature, or raise ConfigError where it is no number from -40 to 150 degC."""
    if not LOWEST_TEMPERATURE_DEGC <= temperature_degC <= HIGHEST_TEMPERATURE_DEGC:
        raise ConfigError(
            f"{name} is {temperature_degC:g} degC, outside {LOWEST_TEMPERATURE_DEGC:g} to "
            f"{HIGHEST_TEMPERATURE_DEGC:g} degC: the viscosity law does not hold there"
        )
    return float(temperature_degC)
