"""The catalogue of effects in words: as data for `simulate --list-effects` and the documentation, and as asked for."""

import inspect
import textwrap
from itertools import takewhile
from typing import Any

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import Quantities
from friction_estimator.effects.base import EFFECTS, Effect, Key

SIZE = Key("size", "", 0.04, 0.0, 1.0, "rms of the change over the rms of the clean friction; replaces the size key")
"""The key that every effect has."""


def list_effects(quantities: Quantities = Quantities()) -> list[dict[str, Any]]:  # noqa: B008 - frozen
    """Return the catalogue as plain data: name, family, stage, equation, keys with unit and range, words."""
    worded = quantities.worded
    return [
        {
            "name": cls.name,
            "family": cls.family,
            "stage": cls.stage,
            "what": worded(cls.words.what),
            "where": worded(cls.words.where),
            "equation": equation(cls)[0],
            "confused_with": {name: worded(text) for name, text in cls.words.confused_with.items()},
            "needs_channel": cls.channel or None,
            "keys": [
                {
                    "name": key.name,
                    "unit": quantities.unit(key.unit),
                    "default": key.default,
                    "range": [key.low, key.high],
                    "description": worded(key.description),
                }
                for key in (*cls.keys, SIZE)
            ],
        }
        for cls in EFFECTS.values()
    ]


def equation(cls: type[Effect]) -> tuple[str, str]:
    """Return what a class docstring says below its first line: the formula, and the sentences after it.

    >>> from friction_estimator.effects import EFFECTS
    >>> equation(EFFECTS["inertia"])
    ('f = F + mass a', '')

    Raises ValueError where the docstring states none.
    """
    _, found, rest = inspect.cleandoc(cls.__doc__ or "").partition("Formula::\n\n")
    lines = rest.splitlines()
    formula = list(takewhile(lambda line: not line or line.startswith(" "), lines))
    stated = textwrap.dedent("\n".join(formula)).strip()
    if not found or not stated:
        raise ValueError(f"the docstring of effect {cls.name} states no formula")
    return stated, " ".join(lines[len(formula) :]).strip()


def parse_effect(text: str) -> Effect:
    """Return the effect that `NAME` or `NAME:key=value,key=value` describes; `size=R` is a key of each.

    Raises
    ------
    ConfigError : unknown name, unknown key, or a value out of range; one line.

    Examples
    --------
    >>> from friction_estimator.effects import parse_effect
    >>> parse_effect("inertia:mass=2").values
    {'mass': 2.0}
    """
    name, _, rest = text.strip().partition(":")
    cls = EFFECTS[name.strip()]
    values: dict[str, str] = {}
    for part in filter(None, (p.strip() for p in rest.split(","))):
        key, equals, value = part.partition("=")
        if not equals:
            raise ConfigError(f"effect {text!r}: {part!r} is not key=value")
        if key.strip() in values:
            raise ConfigError(f"effect {text!r}: {key.strip()} is given twice")
        values[key.strip()] = value.strip()
    size: Any = values.pop("size", None)
    if size is not None:
        try:
            size = float(size)
        except ValueError:
            raise ConfigError(f"effect {name}: size={size!r} is no number") from None
    return cls(size=size, **values)
