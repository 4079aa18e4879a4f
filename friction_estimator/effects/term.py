"""A term of an extended model: an effect's column as text, and the variable beyond whose measured range it is held.

A term is `NAME:key=value,...`: an effect's id, the parameters of its regressor, `part` (which of its columns, from 0)
and `scale` (what the column is divided by, so that its coefficient is in N), and where the cause is a function of time,
distance, position or pressure, `from` and `to`: what was measured of it; beyond, the term keeps its value at the end.
Static shapes keep theirs beyond the reference's top speed.
"""

from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Samples
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.base import EFFECTS, SLOW, Effect
from friction_estimator.effects.columns import Columns
from friction_estimator.effects.features import FeatureMaker, Features
from friction_estimator.effects.reference import PARTS, Reference

PART, SCALE, FROM, TO = "part", "scale", "from", "to"


@dataclass(frozen=True)
class TermSpec:
    """One term of `extension.terms`.

    Attributes
    ----------
    effect, params : which, and the parameters of its regressor. part : which of its columns. scale : of the column.
    measured : least and largest value of `held_variable` that it was fitted to; None: it is held nowhere.
    """

    effect: type[Effect]
    params: dict[str, float]
    part: int = 0
    scale: float = 1.0
    measured: tuple[float, float] | None = None

    @property
    def machine(self) -> tuple[object, ...]:
        """What its columns follow from: terms that are alike in it are parts of one machine's."""
        return self.effect.name, tuple(sorted(self.params.items())), self.measured

    @property
    def text(self) -> str:
        """The term as `parse_term` reads it."""
        keys = [f"{k}={v!r}" for k, v in self.params.items()]
        keys += [f"{PART}={self.part}", f"{SCALE}={self.scale!r}"]
        if self.measured is not None:
            keys += [f"{FROM}={self.measured[0]!r}", f"{TO}={self.measured[1]!r}"]
        return f"{self.effect.name}:{','.join(keys)}"


def held_variable(effect: type[Effect]) -> str | None:
    """Return the field of `Features` beyond whose measured range a term of this effect keeps its value, or None.

    What happened with time or distance says nothing of later, a pattern nothing of where the shaft has not been. A law
    (a mass, a delay) holds everywhere.
    """
    return effect.reveals if effect.acts == SLOW or effect.recorded or effect.by_place() else None


def parse_term(text: str) -> TermSpec:
    """Return the term that a line of `extension.terms` describes.

    Raises
    ------
    ConfigError : unknown effect, an effect without a regressor, a missing, malformed or impossible parameter; one line.

    Examples
    --------
    >>> parse_term("side_spring:centre=0.0").effect.name
    'side_spring'
    """
    name, _, rest = text.strip().partition(":")
    cls = EFFECTS[name.strip()]
    values: dict[str, float] = {}
    for item in filter(None, (p.strip() for p in rest.split(","))):
        key, equals, value = item.partition("=")
        try:
            number = float(value) if equals else float("nan")
        except ValueError:
            number = float("nan")
        if not np.isfinite(number):
            raise ConfigError(f"extension.terms: {text!r}: {item!r} is not key=number")
        values[key.strip()] = number
    part, scale = values.pop(PART, 0.0), values.pop(SCALE, 1.0)
    low, high = values.pop(FROM, -np.inf), values.pop(TO, np.inf)
    if low > high:
        raise ConfigError(f"extension.terms: {text!r}: {FROM} is not above {TO}")
    if part < 0.0 or part != int(part) or scale == 0.0:
        raise ConfigError(f"extension.terms: {text!r}: part is a whole number from 0, scale is not 0")
    for known in cls.keys:
        if values.get(known.name, known.low) < known.low:
            raise ConfigError(f"extension.terms: {text!r}: {known.name} is below {known.low:g}")
    try:
        columns = cls.columns(values)
        finite = _finite(columns)
    except NotImplementedError:
        raise ConfigError(f"extension.terms: {text!r}: {cls.name} has no regressor") from None
    except KeyError as missing:
        raise ConfigError(f"extension.terms: {text!r}: {missing.args[0]} is missing") from None
    if int(part) >= columns.size:
        raise ConfigError(f"extension.terms: {text!r}: {cls.name} has {columns.size} columns, part counts from 0")
    if not finite:
        raise ConfigError(f"extension.terms: {text!r}: no column can be made with a length or a time of 0")
    return TermSpec(cls, values, int(part), scale, (low, high) if np.isfinite([low, high]).any() else None)


def _finite(columns: Columns) -> bool:
    """Return whether the columns of a few samples are numbers.

    Raises
    ------
    KeyError : the term lacks a parameter that they ask for.
    """
    velocity = np.array([0.0, 0.3, 1.0, -0.3, -1.0, -0.2])
    stamps, restart = np.arange(6) * 100_000_000, np.arange(6) == 0
    features = FeatureMaker(0.0, 0.0, 20.0)(Samples(stamps, velocity, np.zeros(6), restart))
    curve = Reference(np.tile(np.linspace(-1.0, 1.0, 3), (PARTS, 1, 1)), np.zeros(1), VelocityAxis(1.0), 0.1)
    try:
        with np.errstate(all="ignore"):
            return bool(np.isfinite(columns(features, curve)).all())
    except ZeroDivisionError:
        return False
    finally:
        columns.restart()


def held(features: Features, spec: TermSpec, top_m_s: float) -> Features:
    """Return the features within what was measured of a term's cause, and a static shape's within the top speed."""
    name = held_variable(spec.effect)
    if name is not None and spec.measured is not None:
        features = replace(features, **{name: np.clip(getattr(features, name), *spec.measured)})
    if spec.effect.about_curve:
        features = replace(features, velocity_m_s=np.clip(features.velocity_m_s, -top_m_s, top_m_s))
    return features
