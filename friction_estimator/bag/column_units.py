"""Units of columns: in the map's brackets, or at the end of a column's own name: `v [mm/s]`, `Force (N)`."""

import re
from dataclasses import dataclass, replace
from functools import lru_cache

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import (
    ACCELERATION,
    FORCE,
    POSITION,
    PRESSURE,
    ROTARY,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Quantities,
    Unit,
    channel_unit,
)
from friction_estimator.core.sample import Floats

_OWN = re.compile(r"(?P<name>.*?\S)\s*(?:\[(?P<square>[^\[\]]+)\]|\((?P<round>[^()]+)\))")

_WORDS = {
    VELOCITY: "velocity",
    FORCE: "force",
    POSITION: "position",
    ACCELERATION: "acceleration",
    PRESSURE: "pressure",
    TEMPERATURE: "temperature",
    TIME: "time",
}

_RATES = {POSITION: VELOCITY, VELOCITY: ACCELERATION}

_INPUTS = {
    "time": TIME,
    "velocity": VELOCITY,
    "friction": FORCE,
    "position": POSITION,
    "pressure": PRESSURE,
    "temperature": TEMPERATURE,
}
"""What each input is, as `core.quantities` has it."""


@dataclass(frozen=True)
class Kind:
    """What numbers are of: a quantity of `core.quantities`, and the motion that it tells of (empty: of none)."""

    quantity: str
    motion: str

    def __str__(self) -> str:
        if self.quantity == FORCE and self.motion == ROTARY:
            return "a torque"
        return " ".join(filter(None, ("a", self.motion, _WORDS[self.quantity])))

    @property
    def rate(self) -> "Kind | None":
        """What its derivative is of."""
        quantity = _RATES.get(self.quantity)
        return None if quantity is None else replace(self, quantity=quantity)

    def fits(self, name: str) -> bool:
        """Whether it is what an input, or the time, is."""
        return self.quantity == _INPUTS[name]

    @classmethod
    def wanted(cls, name: str) -> str:
        """Return what an input is, in words, with the unit of a linear and of a rotary drive."""
        linear = _INPUTS[name]
        rotary = Quantities(ROTARY).unit(linear) if linear in (VELOCITY, FORCE, POSITION) else ""
        return f"{_WORDS[linear]} ({linear}{f' or {rotary}' if rotary else ''})"


def kind_of(unit: Unit) -> Kind:
    """Return what a unit measures."""
    return Kind(unit.quantity, unit.motion)


def si(unit: Unit, values: Floats) -> Floats:
    """Return values in this unit in SI units (a temperature in degC)."""
    return unit.factor * values + unit.zero


@lru_cache(maxsize=4096)
def unit_of(text: str) -> Unit | None:
    """Return the unit of this name; None where there is none."""
    try:
        return channel_unit(text)
    except ConfigError:
        return None


def plain_name(column: str) -> str:
    """Return a column's name without the unit at its end.

    >>> plain_name("Motor speed [rpm]"), plain_name("log[0]"), header_unit("Force (kN)").factor
    ('Motor speed', 'log[0]', 1000.0)
    """
    match = _OWN.fullmatch(column)
    return match["name"] if match and unit_of(match["square"] or match["round"]) else column


def header_unit(column: str) -> Unit | None:
    """Return the unit at the end of a column's name; None where there is none."""
    match = _OWN.fullmatch(column)
    return unit_of(match["square"] or match["round"]) if match else None
