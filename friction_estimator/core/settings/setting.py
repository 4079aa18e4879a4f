"""How a setting is declared, found and checked; `config` has the settings themselves."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, cast, get_type_hints

from friction_estimator.core.errors import ConfigError

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]


def setting(
    default: Value,
    description: str,
    *,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    choices: Sequence[str] = (),
    live: bool = False,
    learned: bool = False,
) -> Any:
    """Declare one setting.

    `live` settings act at once on a running node; the others act at the next reset. `learned` ones are
    written by the estimator itself. `low` and `high` are inclusive and hold for every element of an array.
    """
    meta = {
        "description": description,
        "unit": unit,
        "low": low,
        "high": high,
        "choices": tuple(choices),
        "live": live,
        "learned": learned,
    }
    return field(default=default, metadata=meta)


@dataclass(frozen=True)
class Parameter:
    """One setting with its declaration."""

    name: str
    kind: type
    default: Value
    description: str
    unit: str
    low: float
    high: float
    choices: tuple[str, ...]
    live: bool
    learned: bool

    @property
    def is_array(self) -> bool:
        """True for arrays of numbers or words."""
        return self.kind is tuple

    @property
    def element(self) -> type:
        """Type of the value, or of an array's elements."""
        return str if self.name == "extension.terms" else float if self.is_array else self.kind

    def of(self, config: object) -> Value:
        """Return this parameter's value in `config`."""
        value: Any = config
        for part in self.name.split("."):
            value = getattr(value, part)
        return cast(Value, value)

    def checked(self, value: object) -> Value:
        """Return `value` in this parameter's type, or raise ConfigError with the reason.

        An integer is accepted for a double; a bool is no number; NaN and infinities are refused, in arrays too.
        """
        if self.is_array:
            if isinstance(value, str) or not hasattr(value, "__iter__"):
                raise ConfigError(f"{self.name}: {value!r} is no array")
            return tuple(self._scalar(item, f"{self.name}[{i}]") for i, item in enumerate(value))
        return cast(Value, self._scalar(value, self.name))

    def _scalar(self, value: object, where: str) -> Any:
        wanted = self.element
        item = getattr(value, "item", None)
        value = item() if callable(item) else value  # numpy scalars
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if wanted is int and isinstance(value, float) and value.is_integer():
            value = int(value)
        if type(value) is not wanted:
            raise ConfigError(f"{where}: {value!r} is of type {type(value).__name__}, expected {wanted.__name__}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{where}: {value} is not a finite number")
        if isinstance(value, int | float) and not isinstance(value, bool) and not self.low <= value <= self.high:
            raise ConfigError(
                f"{where}: {value} is out of range [{self.low:g}, {self.high:g}]{' ' + self.unit if self.unit else ''}"
            )
        if self.choices and value not in self.choices:
            raise ConfigError(f"{where}: {value!r} is not one of {', '.join(self.choices)}")
        return value


def walk(cls: type, prefix: str = "") -> Iterator[Parameter]:
    """Yield every setting of a tree of dataclasses, in order."""
    hints = get_type_hints(cls)
    for item in fields(cls):
        kind = hints[item.name]
        if is_dataclass(kind):
            yield from walk(kind, f"{prefix}{item.name}.")  # type: ignore[arg-type]
        else:
            origin = getattr(kind, "__origin__", kind)
            yield Parameter(name=prefix + item.name, kind=origin, default=cast(Value, item.default), **item.metadata)
