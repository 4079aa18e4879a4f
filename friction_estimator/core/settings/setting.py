"""How a setting is declared, found and checked; `config` has the settings themselves."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, cast, get_args, get_origin, get_type_hints

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import Quantities, either
from friction_estimator.core.text import LONGEST_NAME, shown

LONGEST_TEXT = 4096
"""Characters of a word of the configuration: the longest path that Linux takes."""

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]


def setting(
    default: Value,
    description: str,
    *,
    unit: str = "",
    of_drive: bool = False,
    low: float = -math.inf,
    high: float = math.inf,
    least: float = 0.0,
    choices: Sequence[str] = (),
    live: bool = False,
    learned: bool = False,
    path: bool = False,
    at_start: bool = False,
) -> Any:
    """Declare one setting.

    `live` settings act at once on a running node; the others act at the next reset. `learned` ones are
    written by the estimator itself. A `path` names a file on this machine, relative to the file that holds it, which a
    client elsewhere may change only where `files.remote` says so; what is `at_start` only can never be changed on a
    running node. A unit `of_drive` is that of a linear drive; of a rotary one it is what `Quantities.unit` makes of it.
    `low` and `high` are inclusive and hold for every element of an array; what is not 0 is at least
    `least` in size.
    """
    meta = {
        "description": description,
        "unit": unit,
        "of_drive": of_drive,
        "low": low,
        "high": high,
        "least": least,
        "choices": tuple(choices),
        "live": live,
        "learned": learned,
        "path": path,
        "at_start": at_start,
    }
    return field(default=default, metadata=meta)


@dataclass(frozen=True)
class Parameter:
    """One setting with its declaration; `element` is the type of the value, or of an array's elements."""

    name: str
    kind: type
    element: type
    default: Value
    description: str
    unit: str
    of_drive: bool
    low: float
    high: float
    least: float
    choices: tuple[str, ...]
    live: bool
    learned: bool
    path: bool
    at_start: bool

    @property
    def is_array(self) -> bool:
        """True for arrays of numbers or words."""
        return self.kind is tuple

    @property
    def acts(self) -> str:
        """When a value that is set on a running node acts."""
        if self.at_start:
            return "at start only"
        when = "at once" if self.live else "at ~/reset"
        return f"{when}, changed on a running node only with files.remote" if self.path else when

    @property
    def units(self) -> str:
        """Unit in words where it is not known what moves, such as "m/s or rad/s"; empty where there is none."""
        return either(self.unit) if self.of_drive else self.unit

    def unit_in(self, quantities: Quantities) -> str:
        """Return the unit where the drive has these quantities."""
        return quantities.unit(self.unit) if self.of_drive else self.unit

    def of(self, config: object) -> Value:
        """Return this parameter's value in `config`."""
        value: Any = config
        for part in self.name.split("."):
            value = getattr(value, part)
        return cast(Value, value)

    def checked(self, value: object) -> Value:
        """Return `value` in this parameter's type, or raise ConfigError with the reason.

        An integer is accepted for a double; a bool is no number; NaN and infinities are refused, in arrays too, and
        text that no file can hold.
        """
        if self.is_array:
            if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
                raise ConfigError(f"{self.name}: {_told(value)} is no array: write [{_told(value)}]")
            return tuple(self._scalar(item, f"{self.name}[{i}]") for i, item in enumerate(value))
        return cast(Value, self._scalar(value, self.name))

    def _scalar(self, value: object, where: str) -> Any:
        wanted = self.element
        item = getattr(value, "item", None)
        value = item() if callable(item) else value  # numpy scalars
        if isinstance(value, int) and abs(value) >= 2**63:
            raise ConfigError(f"{where}: the value is an integer of more than 64 bits")
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if wanted is int and isinstance(value, float) and value.is_integer():
            value = int(value)
        if type(value) is not wanted:
            raise ConfigError(f"{where}: {_told(value)} is of type {type(value).__name__}, expected {wanted.__name__}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{where}: {value} is not a finite number")
        if isinstance(value, int | float) and not isinstance(value, bool):
            self._check_size(value, where)
        if isinstance(value, str) and not (len(value) <= LONGEST_TEXT and is_text(value)):
            raise ConfigError(f"{where}: {_told(value)} is too long, or holds a NUL or half a surrogate pair")
        if self.choices and value not in self.choices:
            raise ConfigError(f"{where}: {_told(value)} is not one of {', '.join(self.choices)}")
        return value

    def _check_size(self, value: float, where: str) -> None:
        if not self.low <= value <= self.high:
            raise ConfigError(f"{where}: {value} is out of range [{self.low:g}, {self.high:g}] {self.units}".rstrip())
        if 0.0 < abs(value) < self.least:
            raise ConfigError(f"{where}: {value} is neither 0 nor at least {self.least:g} {self.units}".rstrip())


def is_text(value: str) -> bool:
    r"""Return whether a file can hold this text, and a path may: no NUL, no half of a surrogate pair.

    >>> is_text("Kolbenstange"), is_text("a\0b"), is_text("\ud800")
    (True, False, False)
    """
    try:
        value.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return "\0" not in value


def _told(value: object) -> str:
    return shown(repr(value), LONGEST_NAME)


def walk(cls: type, prefix: str = "") -> Iterator[Parameter]:
    """Yield every setting of a tree of dataclasses, in order."""
    hints = get_type_hints(cls)
    for item in fields(cls):
        kind = hints[item.name]
        if is_dataclass(kind):
            yield from walk(kind, f"{prefix}{item.name}.")  # type: ignore[arg-type]
        else:
            yield Parameter(
                name=prefix + item.name,
                kind=get_origin(kind) or kind,
                element=next(iter(get_args(kind)), kind),
                default=cast(Value, item.default),
                **item.metadata,
            )
