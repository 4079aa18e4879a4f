"""The configurations of a sweep: a grid over alternatives, or draws from them."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import PARAMETERS, Config, parameter
from friction_estimator.core.settings.setting import Value

MOST_CONFIGURATIONS = 10_000
"""More than this is no study that anybody reads: a grid is narrowed, or drawn from."""

_TRIES = 100
"""Draws for each configuration that is wanted: where values are few, the same ones come again."""

Settings = Mapping[str, Value]
"""Values by dotted name."""


@dataclass(frozen=True)
class Axis:
    """Alternatives for one setting."""

    name: str
    values: tuple[Value, ...]

    def draw(self, generator: np.random.Generator) -> Value:
        """Return one of them, each as likely."""
        return self.values[int(generator.integers(len(self.values)))]


@dataclass(frozen=True)
class Span:
    """Values from `low` to `high` for one setting, drawn evenly, or evenly in their logarithm; whole for integers."""

    name: str
    low: float
    high: float
    logarithmic: bool = False

    def draw(self, generator: np.random.Generator) -> Value:
        """Return a value of the span."""
        if PARAMETERS[self.name].element is int:
            return int(generator.integers(int(self.low), int(self.high), endpoint=True))
        if self.logarithmic:
            return math.exp(generator.uniform(math.log(self.low), math.log(self.high)))
        return float(generator.uniform(self.low, self.high))


@dataclass(frozen=True)
class Configurations:
    """What is swept.

    Attributes
    ----------
    settings : of each configuration, what was chosen for it; none twice.
    left_out : for each combination that cannot be a configuration, why.
    """

    settings: tuple[Settings, ...]
    left_out: tuple[str, ...] = ()


def axis(name: str, values: Sequence[Any]) -> Axis:
    """Return the alternatives of a setting, each checked as in a parameter file, none twice.

    >>> axis("law", ["lms", "rls", "lms"])
    Axis(name='model.law', values=('lms', 'rls'))
    >>> axis("fir.ordre", [4])
    Traceback (most recent call last):
    friction_estimator.core.errors.ConfigError: unknown parameter fir.ordre; nearest: fir.order

    Raises ConfigError.
    """
    item = parameter(whole_name(name))
    if not values:
        raise ConfigError(f"{item.name}: no value is given")
    if item.is_array and any(isinstance(value, str | int | float) for value in values):
        raise ConfigError(f"{item.name} takes lists: each of its values is one, such as {item.name}=[...],[...]")
    return Axis(item.name, tuple(dict.fromkeys(item.checked(value) for value in values)))


def span(name: str, low: float, high: float, *, logarithmic: bool = False) -> Span:
    """Return values of a setting to be drawn from. Raises ConfigError."""
    item = parameter(whole_name(name))
    if item.element not in (int, float) or item.is_array:
        raise ConfigError(f"{item.name} is no number: LOW..HIGH cannot be drawn from; name its values")
    for end in (low, high):
        item.checked(end)
    if not low < high:
        raise ConfigError(f"{item.name}: {low:g}..{high:g} is empty: give the lower end first")
    if logarithmic and not low > 0.0:
        raise ConfigError(f"{item.name}: {low:g}..{high:g}:log needs a lower end above 0")
    return Span(item.name, low, high, logarithmic)


def whole_name(name: str) -> str:
    """Return the dotted name that is meant: the last part is enough where it is the last part of one only.

    >>> whole_name("law"), whole_name("fir.order"), whole_name("step_size")
    Traceback (most recent call last):
    friction_estimator.core.errors.ConfigError: step_size may be lms.step_size or nlms.step_size: write one of them
    """
    if name in PARAMETERS or "." in name:
        return name
    found = [full for full in PARAMETERS if full.rpartition(".")[2] == name]
    if len(found) > 1:
        raise ConfigError(f"{name} may be {' or '.join(found)}: write one of them")
    return found[0] if found else name


def grid(base: Config, axes: Sequence[Axis]) -> Configurations:
    """Return every combination of the alternatives, the last axis the fastest.

    What is of a law that a combination does not use is left out of it, so that no configuration comes twice.

    Raises ConfigError where there are too many, none that can be a configuration, or a setting is of a law that none
    uses.
    """
    count = math.prod(len(one.values) for one in axes)
    if count > MOST_CONFIGURATIONS:
        sizes = " x ".join(str(len(one.values)) for one in axes)
        raise ConfigError(
            f"the grid has {count} configurations ({sizes}), at most {MOST_CONFIGURATIONS} are swept: name fewer "
            "values, or draw some of them with --random N"
        )
    _check_used(base, axes)
    names = [one.name for one in axes]
    return _checked(base, (dict(zip(names, values, strict=True)) for values in product(*(a.values for a in axes))))


def drawn(base: Config, ways: Sequence[Axis | Span], count: int, seed: int) -> Configurations:
    """Return `count` configurations drawn at random (Bergstra and Bengio, JMLR 13 (2012) 281), the same for a seed.

    None comes twice: where there are no more, there are fewer than `count`.

    Raises ConfigError where none can be a configuration, or a setting is of a law that none uses.
    """
    if not 1 <= count <= MOST_CONFIGURATIONS:
        raise ConfigError(f"--random {count}: give 1 to {MOST_CONFIGURATIONS}")
    _check_used(base, ways)
    generator = np.random.default_rng(seed)

    def draws() -> Iterator[Settings]:
        for _ in range(_TRIES * count):
            yield {one.name: one.draw(generator) for one in ways}

    return _checked(base, draws(), count)


def _checked(base: Config, combinations: Iterator[Settings], most: int = MOST_CONFIGURATIONS) -> Configurations:
    taken: dict[tuple[tuple[str, Value], ...], Settings] = {}
    left_out: dict[tuple[tuple[str, Value], ...], str] = {}
    for settings in combinations:
        own = _acting(base, settings)
        key = tuple(own.items())
        try:
            base.updated(own)
        except ConfigError as error:
            left_out[key] = str(error)
        else:
            taken.setdefault(key, own)
        if len(taken) == most:
            break
    if not taken:
        raise ConfigError(f"none of {len(left_out)} combinations is a configuration: {next(iter(left_out.values()))}")
    return Configurations(tuple(taken.values()), tuple(left_out.values()))


def _check_used(base: Config, ways: Sequence[Axis | Span]) -> None:
    """Raise ConfigError for a setting of a law that no configuration uses."""
    varied = [one.values for one in ways if isinstance(one, Axis) and one.name == "model.law"]
    used = set(varied[0]) if varied else {base.model.law}
    for one in ways:
        if _is_of_another(one.name, used):
            law, told = one.name.partition(".")[0], " or ".join(sorted(map(str, used)))
            raise ConfigError(f"{one.name} is of the law {law}, and the law is {told}: add law={law}, or leave it out")


def _acting(base: Config, settings: Settings) -> Settings:
    """Return the settings without those of laws that are not used."""
    used = {settings.get("model.law", base.model.law)}
    return {name: value for name, value in settings.items() if not _is_of_another(name, used)}


def _is_of_another(name: str, laws: Collection[Value]) -> bool:
    """Return whether a setting is of a law that is none of these."""
    return name.partition(".")[0] in set(PARAMETERS["model.law"].choices) - set(laws)
