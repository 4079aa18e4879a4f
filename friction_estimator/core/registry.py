"""Name-to-class tables: the one place to touch when a basis, law, theory, effect or message type is added."""

from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

from friction_estimator.core.errors import ConfigError

T = TypeVar("T")


class Registry(Mapping[str, T]):
    """A read-only mapping from name to entry, filled by `register`.

    >>> LAMPS: Registry[int] = Registry("lamp")
    >>> LAMPS.register("red", 1)
    1
    >>> LAMPS["red"]
    1
    >>> LAMPS["blue"]
    Traceback (most recent call last):
    friction_estimator.core.errors.ConfigError: unknown lamp 'blue': choose one of red
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._entries: dict[str, T] = {}

    def register(self, name: str, entry: T) -> T:
        """Add `entry` under `name`; raises ValueError where the name is taken."""
        if name in self._entries:
            raise ValueError(f"{self._kind} {name!r} is registered twice")
        self._entries[name] = entry
        return entry

    def named(self, name: str) -> Callable[[T], T]:
        """Return the decorator form of `register`."""
        return lambda entry: self.register(name, entry)

    def __getitem__(self, name: str) -> T:
        try:
            return self._entries[name]
        except KeyError:
            known = ", ".join(self._entries)
            raise ConfigError(f"unknown {self._kind} {name!r}: choose one of {known}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)
