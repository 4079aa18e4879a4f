"""What is read in words: units of linear and rotary drives, and those that the reader chose."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import FORCE, LINEAR, POSITION, ROTARY, VELOCITY, Quantities, unit_named
from friction_estimator.core.settings.config import PARAMETERS, Config

UNITS = ("m", "m/s", "m/s2", "N", "N/m", "N s/m", "N s^2/m^2", "kg", "N/Pa", "N s/m/Pa", "N/Pa^2", "1/m", "s", "Hz", "")


def test_a_linear_drive_keeps_its_units() -> None:
    """Every unit is asked for by what it is of a linear drive."""
    assert [Quantities(LINEAR).unit(unit) for unit in UNITS] == list(UNITS)


def test_a_rotary_drive_has_units_of_its_own() -> None:
    """Lengths are angles, forces torques, masses moments of inertia."""
    told = ["rad", "rad/s", "rad/s2", "N m", "N m/rad", "N m s/rad", "N m s^2/rad^2", "kg m2"]
    told += ["N m/Pa", "N m s/rad/Pa", "N m/Pa^2", "1/rad", "s", "Hz", ""]
    assert [Quantities(ROTARY).unit(unit) for unit in UNITS] == told


@given(st.sampled_from(UNITS), st.sampled_from([LINEAR, ROTARY]), st.floats(-1e6, 1e6))
def test_numbers_in_si_units_stay(unit: str, motion: str, value: float) -> None:
    """Without a choice of the reader there is nothing to convert."""
    assert Quantities(motion).value(value, unit) == value


@pytest.mark.parametrize(
    ("motion", "names", "unit", "told"),
    [
        (LINEAR, ["mm/s", "N"], VELOCITY, "20 mm/s"),
        (LINEAR, ["mm/s"], POSITION, "20 mm"),
        (LINEAR, ["mm/s"], "N/m", "2e-05 N/mm"),
        (LINEAR, ["um", "mm/s"], POSITION, "20000 um"),
        (LINEAR, ["m/min"], VELOCITY, "1.2 m/min"),
        (LINEAR, ["m/min"], POSITION, "0.02 m"),
        (LINEAR, ["kN"], "N s/m", "2e-05 kN s/m"),
        (ROTARY, ["rpm"], VELOCITY, "0.191 rpm"),
        (ROTARY, ["rpm"], POSITION, "0.02 rad"),
        (ROTARY, ["deg/s", "mNm"], "N/m", "0.3491 mN m/deg"),
        (ROTARY, ["°/s"], VELOCITY, "1.146 deg/s"),
        (ROTARY, ["N-m"], FORCE, "0.02 N m"),
        (LINEAR, ["mm/s", "kN"], "kg", "0.02 kg"),
    ],
)
def test_the_reader_chooses_units(motion: str, names: list[str], unit: str, told: str) -> None:
    """0.02 in SI units, in words."""
    assert Quantities(motion).in_units(names).text(0.02, unit) == told


@pytest.mark.parametrize(
    ("motion", "names", "reason"),
    [
        (LINEAR, ["rpm"], "rpm is a unit of rotary motion; this drive is linear: m, m/s and N"),
        (ROTARY, ["kN"], "kN is a unit of linear motion; this drive is rotary: rad, rad/s and N m"),
        (LINEAR, ["mm/s", "um/s"], "mm/s and um/s are given"),
        (LINEAR, ["furlong"], "'furlong' is no unit"),
        (LINEAR, ["mm/kg"], "'mm/kg' is no unit"),
        (LINEAR, [""], "'' is no unit"),
    ],
)
def test_a_unit_that_does_not_fit_is_refused(motion: str, names: list[str], reason: str) -> None:
    """One line says why."""
    with pytest.raises(ConfigError, match=reason):
        Quantities(motion).in_units(names)


def test_si_units_are_those_of_the_json() -> None:
    """The reader's choice leaves the JSON alone."""
    quantities = Quantities(ROTARY).in_units(["rpm", "mN m"])
    assert quantities.names == {"velocity": "rad/s", "friction": "N m"}
    assert (quantities.velocity, quantities.force) == ("rpm", "mN m")


def test_spellings_of_one_unit_agree() -> None:
    """What people write is understood."""
    assert {unit_named(text).symbol for text in ("Nm", "N m", "N*m", "N·m", "N-m", " N.m ")} == {"N m"}
    assert unit_named("rpm") == unit_named("rev/min")
    assert unit_named("m/s^2") == unit_named("m/s²")
    assert unit_named("lbf in") == unit_named("in-lbf")
    assert unit_named("rpm").factor == pytest.approx(2.0 * math.pi / 60.0)


@pytest.mark.parametrize(
    ("values", "motion"),
    [
        ({}, LINEAR),
        ({"input.mode": "joint_state"}, ROTARY),
        ({"input.mode": "joint_state", "input.motion": "linear"}, LINEAR),
        ({"input.motion": "rotary"}, ROTARY),
        ({"input.mode": "float64"}, LINEAR),
    ],
)
def test_the_configuration_says_what_moves(values: dict[str, object], motion: str) -> None:
    """By `input.motion`, else by the mode."""
    assert Config.from_mapping(values).quantities.motion == motion


def test_settings_of_the_drive_have_its_units() -> None:
    """The seal's own sizes stay in metres."""
    rotary = Quantities(ROTARY)
    assert PARAMETERS["basis.velocity_unit"].unit_in(rotary) == "rad/s per basis unit"
    assert PARAMETERS["force_unit"].unit_in(rotary) == "N m"
    assert PARAMETERS["seal.shaft_diameter"].unit_in(rotary) == "m"
    with pytest.raises(ConfigError, match=r"out of range .* m/s or rad/s$"):
        Config.from_mapping({"basis.velocity_range": [-1e12, 1.0]})
