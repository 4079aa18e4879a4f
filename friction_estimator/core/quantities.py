"""What a drive's numbers are: of a linear drive m, m/s and N, of a rotary one rad, rad/s and N m.

Names in the code and keys of the JSON say `_m_s` and `_N` whatever moves; what a person reads says the true unit,
through `Quantities`. A unit is asked for by what it is of a linear drive: ``quantities.unit("N s/m")`` is "N m s/rad"
where the drive is rotary, and `value` and `text` convert to the units that the reader chose (`in_units`).

Who does not know the drive says only what is meant: ``quantity(0.02, "m/s")`` for a number and `{force}` or `{mass}`
for the noun. `Quantities.worded` makes words of them where they are shown.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.text import number

LINEAR, ROTARY = "linear", "rotary"

VELOCITY, FORCE, POSITION, ACCELERATION = "m/s", "N", "m", "m/s2"
"""The unit of each on a linear drive, by which the true one is asked for."""

PRESSURE, TEMPERATURE, TIME = "Pa", "degC", "s"
"""The units of what is no motion, in which it is recorded."""

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "ft": 0.3048}
_ANGLES = {
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": math.pi / 180.0,
    "rev": 2.0 * math.pi,
}
_FORCES = {"N": 1.0, "uN": 1e-6, "mN": 1e-3, "kN": 1e3, "MN": 1e6, "lbf": 4.4482216152605, "kgf": 9.80665}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_PRESSURES = {
    "Pa": 1.0,
    "hPa": 1e2,
    "kPa": 1e3,
    "MPa": 1e6,
    "mbar": 1e2,
    "bar": 1e5,
    "psi": 6894.757293168361,
    "atm": 101325.0,
}
_TEMPERATURES = {
    "degC": (1.0, 0.0),
    "C": (1.0, 0.0),
    "K": (1.0, -273.15),
    "degF": (5.0 / 9.0, -160.0 / 9.0),
    "F": (5.0 / 9.0, -160.0 / 9.0),
}
_SPELT = {"µ": "u", "μ": "u", "°": "deg", "·": " ", "*": " ", "²": "2", "^": "", "rpm": "rev/min"}
_TORQUE = re.compile(rf"({'|'.join(_FORCES)})[ .-]?({'|'.join(_LENGTHS)})|({'|'.join(_LENGTHS)})[ .-]?lbf")
_MEANT = re.compile(r"\{(?:(force|mass)|([^{} ]+) \|([^{}|]+)\|([^{}|]+))\}")
_TOKEN = re.compile(r"(/?)([A-Za-z]+)(?:\^?(\d))?")


@dataclass(frozen=True)
class Unit:
    """A unit of position, velocity, acceleration or force.

    Attributes
    ----------
    symbol : as it is written.
    factor : its value in SI units.
    quantity : what it is a unit of, by that quantity's unit on a linear drive: one of `POSITION`, `VELOCITY`,
        `ACCELERATION` and `FORCE`.
    motion : `LINEAR` or `ROTARY`.
    base : the unit of position in a velocity or acceleration.
    zero : what 0 of it is in SI units (degC for a temperature).
    """

    symbol: str
    factor: float
    quantity: str
    motion: str
    base: "Unit | None" = None
    zero: float = 0.0


def unit_named(text: str) -> Unit:
    """Return the unit of position, velocity, acceleration or force of this name.

    >>> unit_named("mm/s").factor, unit_named("mNm").symbol, unit_named("rpm").motion
    (0.001, 'mN m', 'rotary')

    Raises ConfigError where there is none.
    """
    name = text.strip()
    for written, plain in _SPELT.items():
        name = name.replace(written, plain)
    name = re.sub(r"(?<=[A-Za-z])-(?=[A-Za-z])", " ", name)
    for names, motion in ((_LENGTHS, LINEAR), (_ANGLES, ROTARY)):
        base, slash, time = name.partition("/")
        if base in names:
            position = Unit(base, names[base], POSITION, motion)
            if not slash:
                return position
            square = time.endswith("2")
            per = _TIMES.get(time.removesuffix("2"))
            if per is not None:
                symbol = "rpm" if name == "rev/min" else name
                power, quantity = (2, ACCELERATION) if square else (1, VELOCITY)
                return Unit(symbol, names[base] / per**power, quantity, motion, position)
    if name in _FORCES:
        return Unit(name, _FORCES[name], FORCE, LINEAR)
    if torque := _TORQUE.fullmatch(name):
        force, length = torque[1] or "lbf", torque[2] or torque[3]
        return Unit(f"{force} {length}", _FORCES[force] * _LENGTHS[length], FORCE, ROTARY)
    raise ConfigError(
        f"{text!r} is no unit of position, velocity, acceleration or force: write for instance mm/s, um, rpm, deg/s, "
        "kN or mN m"
    )


def quantity(si: float | Iterable[float], linear: str, digits: str = ".4g") -> str:
    """Return a number in SI units, or the ends of a range, for a text that `Quantities.worded` will make words of.

    >>> Quantities(ROTARY).worded(f"the {{force}} reaches {quantity(12.34, FORCE, '.3g')}")
    'the torque reaches 12.3 N m'
    >>> Quantities(LINEAR).worded(f"runs at {quantity((0.1, 0.25), VELOCITY)}")
    'runs at 0.1 to 0.25 m/s'
    """
    ends = list(si) if isinstance(si, Iterable) else [si]
    return f"{{{':'.join(repr(float(end)) for end in ends)} |{linear}|{digits}}}"


def either(linear: str) -> str:
    """Return a unit in words where it is not known what moves.

    >>> either("m/s"), either("Pa")
    ('m/s or rad/s', 'Pa')
    """
    return " or ".join(dict.fromkeys(Quantities(motion).unit(linear) for motion in (LINEAR, ROTARY)))


def channel_unit(text: str) -> Unit:
    """Return the unit of this name of whatever is recorded: pressure, temperature and time too.

    The motion of these is empty: they say nothing of it.

    >>> channel_unit("bar").factor, round(channel_unit("degF").zero, 3), channel_unit("deg/s").motion
    (100000.0, -17.778, 'rotary')

    Raises ConfigError where there is none.
    """
    name = text.strip().replace("°", "deg").replace("µ", "u").replace("μ", "u")
    if name in _PRESSURES:
        return Unit(name, _PRESSURES[name], PRESSURE, "")
    if name in _TEMPERATURES:
        factor, zero = _TEMPERATURES[name]
        return Unit(name, factor, TEMPERATURE, "", zero=zero)
    if name in _TIMES:
        return Unit(name, _TIMES[name], TIME, "")
    return unit_named(text)


@dataclass(frozen=True)
class Quantities:
    """The units of one drive, and how its numbers are shown.

    Parameters
    ----------
    motion : `LINEAR` or `ROTARY`.
    shown : the units that the reader chose instead of SI, at most one a quantity; see `in_units`.

    Examples
    --------
    >>> Quantities(ROTARY).unit("N s/m"), Quantities(ROTARY).unit("kg"), Quantities(LINEAR).unit("N/m")
    ('N m s/rad', 'kg m2', 'N/m')
    >>> Quantities(LINEAR).in_units(["mm/s"]).text(0.0123, VELOCITY), Quantities(ROTARY).text(2.0, FORCE)
    ('12.3 mm/s', '2 N m')
    """

    motion: str = LINEAR
    shown: tuple[Unit, ...] = ()

    @property
    def is_rotary(self) -> bool:
        """Whether the drive turns."""
        return self.motion == ROTARY

    @property
    def si(self) -> "Quantities":
        """The same drive in SI units, whatever the reader chose."""
        return replace(self, shown=())

    def of(self, motion: str) -> "Quantities":
        """Return those of a drive of another motion, shown in the reader's units where they are of that motion."""
        return Quantities(motion, tuple(unit for unit in self.shown if unit.motion == motion))

    @property
    def velocity(self) -> str:
        """Unit of velocity: m/s, rad/s, or what the reader chose."""
        return self.unit(VELOCITY)

    @property
    def force(self) -> str:
        """Unit of friction: N, N m, or what the reader chose."""
        return self.unit(FORCE)

    @property
    def position(self) -> str:
        """Unit of position: m, rad, or what the reader chose."""
        return self.unit(POSITION)

    @property
    def force_noun(self) -> str:
        """What friction is: a force or a torque."""
        return "torque" if self.is_rotary else "force"

    @property
    def mass_noun(self) -> str:
        """What resists acceleration: a mass or a moment of inertia."""
        return "moment of inertia" if self.is_rotary else "mass"

    @property
    def names(self) -> dict[str, str]:
        """`units` of the JSON: SI, whatever the reader chose."""
        return {"velocity": self.si.velocity, "friction": self.si.force}

    def in_units(self, names: Iterable[str]) -> "Quantities":
        """Return these quantities shown in the units of these names.

        A unit of velocity or acceleration brings its unit of position along where none is named: with mm/s, a
        stiffness is in N/mm. Minutes and revolutions (rpm) count for the velocity alone.

        Raises ConfigError for what is no unit, or a unit of the other kind of motion.
        """
        chosen: dict[str, Unit] = {}
        for name in names:
            unit = unit_named(name)
            if unit.motion != self.motion:
                own = f"{self.si.position}, {self.si.velocity} and {self.si.force}"
                raise ConfigError(
                    f"{unit.symbol} is a unit of {unit.motion} motion; this drive is {self.motion}: {own}"
                )
            if unit.quantity in chosen:
                raise ConfigError(f"{chosen[unit.quantity].symbol} and {unit.symbol} are given: choose one of them")
            chosen[unit.quantity] = unit
        if POSITION not in chosen:
            bases = [unit.base for unit in chosen.values() if unit.base is not None and unit.base.symbol != "rev"]
            chosen |= {base.quantity: base for base in bases[:1]}
        return replace(self, shown=tuple(chosen.values()))

    def unit(self, linear: str) -> str:
        """Return the unit of a quantity whose unit on a linear drive is `linear`, such as "N s/m" or "m/s per step"."""
        return self._converted(linear)[0]

    def value(self, si: float, linear: str) -> float:
        """Return a number in SI units as the reader's; an array too."""
        return si / self._converted(linear)[1]

    def text(self, si: float, linear: str, digits: str = ".4g") -> str:
        """Return a number in SI units in words: the reader's number and its unit."""
        return f"{number(self.value(si, linear), digits)} {self.unit(linear)}"

    def worded(self, text: str) -> str:
        """Return a text with its numbers (see `quantity`), `{force}` and `{mass}` in words."""
        nouns = {"force": self.force_noun, "mass": self.mass_noun}

        def told(match: re.Match[str]) -> str:
            noun, numbers, unit, digits = match.groups()
            if noun:
                return nouns[noun]
            shown = (number(self.value(float(si), unit), digits) for si in numbers.split(":"))
            return f"{' to '.join(shown)} {self.unit(unit)}"

        return _MEANT.sub(told, text)

    def range_text(self, ends: Iterable[float], linear: str, digits: str = ".4g") -> str:
        """Return an interval in words: [lowest, highest] and the unit."""
        told = ", ".join(number(self.value(end, linear), digits) for end in ends)
        return f"[{told}] {self.unit(linear)}"

    def _converted(self, linear: str) -> tuple[str, float]:
        """Return the unit's symbol, and its value in SI units."""
        given, per, rest = linear.partition(" per ")
        chosen = next((unit for unit in self.shown if unit.quantity == given), None)
        if chosen is not None:
            return chosen.symbol + per + rest, chosen.factor
        symbols = {"m": ("rad", 1.0), "N": ("N m", 1.0), "kg": ("kg m2", 1.0)} if self.is_rotary else {}
        for unit in self.shown:
            if unit.quantity in (POSITION, FORCE):
                symbols["m" if unit.quantity == POSITION else "N"] = (unit.symbol, unit.factor)
        factor = 1.0

        def put(match: re.Match[str]) -> str:
            nonlocal factor
            slash, token, power = match.groups()
            if token not in symbols:
                return match[0]
            symbol, size = symbols[token]
            factor *= size ** (int(power or 1) * (-1 if slash else 1))
            symbol = f"({symbol})" if " " in symbol and (slash or power) else symbol
            return slash + symbol + match[0].removeprefix(slash + token)

        return _TOKEN.sub(put, given) + per + rest, factor
