"""Theoretical steady-state friction d(v; p, T) of a lubricated lip seal, and the registry of such curves.

A curve maps velocity, sealed gauge pressure and temperature to friction force, sample by sample and without
memory. The sample loops are compiled, scalar and free of fast-math: one sample at a time (the live node) and
whole recordings at once (replay) give the same bits.

What a recording may contain never raises here; every curve keeps to one rule:

- a pressure or temperature that is NaN (no value received yet) is replaced by the curve's default, and counted
  in `defaulted`;
- one outside the curve's range is held at the nearest limit, and counted in `held`; so is a velocity that is
  not finite or above 10 km/s (NaN counts as standstill).

What a user writes into a configuration does raise: ConfigError, at construction.
"""

from collections.abc import Callable
from typing import Protocol

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.model.theory_stribeck import Stribeck, StribeckCurve
from friction_estimator.core.model.theory_table import TableCurve
from friction_estimator.core.model.theory_table_file import read_table
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import LARGEST_SPEED
from friction_estimator.core.settings.units import NO_VELOCITY

SIGN_SHARE, FALL_SHARE = 0.01, 0.1
"""Of a Stribeck curve that is given without them: velocity of the smooth sign and Stribeck velocity over the scale."""


class TheoryCurve(Protocol):
    """What every theoretical curve offers."""

    @property
    def defaulted(self) -> int:
        """Samples so far whose pressure or temperature was NaN and was replaced by the default."""

    @property
    def held(self) -> int:
        """Samples so far with an input outside the curve's range, held at the nearest limit."""

    @property
    def sign_velocity_m_s(self) -> float | None:
        """Velocity v_s of its smooth sign tanh(v / v_s), m/s; None where it is of no such form."""

    def evaluate(self, velocity_m_s: Floats, gauge_pressure_Pa: Floats, temperature_degC: Floats) -> Floats:
        """Return the steady-state friction.

        Parameters
        ----------
        velocity_m_s, gauge_pressure_Pa, temperature_degC : (n,) float64.

        Returns
        -------
        (n,) float64, friction in N, positive at positive velocity; finite whatever the inputs.

        Raises
        ------
        ValueError
            Where the arrays differ in length (a fault of the caller, not of the data).
        """


THEORIES: Registry[Callable[[Config], TheoryCurve | None]] = Registry("theoretical curve")
"""Builders of curves by `theory.kind`; `none` builds None."""


@THEORIES.named("seal")
def _seal(config: Config) -> TheoryCurve:
    return SealCurve(config.seal, config.theory.default_pressure, config.theory.default_temperature)


@THEORIES.named("stribeck")
def _stribeck(config: Config) -> TheoryCurve:
    return StribeckCurve(given_stribeck(config) or Stribeck.of(config.learned.stribeck, "learned.stribeck"))


@THEORIES.named("table")
def _table(config: Config) -> TheoryCurve:
    return TableCurve(
        read_table(config.theory.table), config.theory.default_pressure, config.theory.default_temperature
    )


@THEORIES.named("none")
def _none(config: Config) -> None:  # noqa: ARG001 - every builder takes the configuration
    return None


def theory_from_config(config: Config) -> TheoryCurve | None:
    """Return the curve that `theory.kind` names, or None for none.

    Raises
    ------
    ConfigError
        For an unknown kind, parameters that make no curve, a table that cannot be used (names file and row), or auto
        before it is known what that comes to.
    """
    if config.theory_kind == "auto" or not config.has_theory:
        raise ConfigError(
            f"theory.kind is {config.theory.kind} and no first contact was made: give samples to choose by, set "
            "theory.kind to seal or table, or stribeck.coulomb"
        )
    return THEORIES[config.theory_kind](config)


def given_stribeck(config: Config) -> Stribeck | None:
    """Return the curve of `stribeck.*`, or None where that leaves it to the samples; raises ConfigError."""
    given, scale = config.stribeck, config.velocity_scale or NO_VELOCITY
    if not given.coulomb:
        return None
    sides: list[float] = []
    for name in ("coulomb", "breakaway", "viscous"):
        values = getattr(given, name) or (0.0,)
        sides += [values[0], values[-1]]
    sign, fall = given.sign_velocity or SIGN_SHARE * scale, given.velocity or FALL_SHARE * scale
    return Stribeck.of((*sides, sign, fall, given.exponent, -LARGEST_SPEED, LARGEST_SPEED), "stribeck")
