"""Load terms: what the measured effort holds beside friction, linear in coefficients that are known or learned.

    effort = friction + inertia a + stiffness (x - centre) + g_sin sin q + g_cos cos q + constant
             + share |load| sgn v

with the load the sum of the terms before: teeth and bearings rub the more, the more they carry (`load_dependence`).
`load.terms` names them. What is known is taken off the measurement at admission (`intake.admission`), so that all that
follows sees friction; what is unknown is learned beside the friction, one column each, under the same prior.

A column is made dimensionless by the drive's speed scale V and T0 = 1 s, so that its coefficient is in force units
whatever the machine: z = a T0 / V for inertia, (x - centre) / (V T0) for a spring, and 1, sin q, cos q as they are. The
column of `load_dependence` is the sign of the velocity here, times the size of the load as the coefficients have it
then (`prediction.rubbing`): pseudo-linear, as in extended least squares.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config

LARGEST_COEFFICIENT = 1e12
"""No load is heavier, stiffer or larger, in SI units."""

DOUBTFUL = 0.05
"""Of the usual error power: a sample to which the doubt about its acceleration may do more is not learned from."""

LARGEST_COLUMN = 1e6
"""Largest dimensionless column: a wild velocity must not become an acceleration that no arithmetic survives."""

LARGEST_LOAD_N = 1e12
"""The known load of one sample is held within this."""

FIT_RIDGE = 1e-6
"""Of `friction_alone`: share of a column's own power that its coefficient costs."""

SPIKES_ABOVE = 4.0
"""Of `friction_alone`: times the effort that two samples of a hundred exceed, to which any other is shortened."""

SMOOTH_SHARE = 0.02
"""Of the top speed: width of the smooth sign beside which loads are sought and learned."""


class Motion(Protocol):
    """What the columns are made of: arrays (n,)."""

    @property
    def acceleration_m_s2(self) -> Floats:
        """Acceleration, m/s^2 or rad/s^2."""

    @property
    def position_m(self) -> Floats:
        """Position, m or rad."""

    @property
    def direction(self) -> Floats:
        """Sign of the velocity."""


@dataclass(frozen=True)
class Load:
    """One kind of load.

    Attributes
    ----------
    parts : names of its coefficients, one column each.
    unit : theirs on a linear drive (`quantities` has that of a rotary one).
    columns : (motion, keys) -> (n, parts), force per coefficient.
    advice : drive that tells it from friction and other loads.
    needs : "acceleration", "position" or "".
    of_motion : whether the column is an acceleration or a position, which the speed scale makes dimensionless.
    keys : further numbers of a term with their defaults.
    even : whether it has a part that is the same at rest and in both directions.
    least_range : of the position, m or rad, below which it cannot be told from a spring and a constant.
    follows : whether its column is the sign of the velocity, to be multiplied by the size of the other terms together.
    """

    parts: tuple[str, ...]
    unit: str
    columns: Callable[[Motion, Mapping[str, float]], Floats]
    advice: str
    needs: str = ""
    of_motion: bool = False
    keys: Mapping[str, float] = field(default_factory=dict)
    even: bool = False
    least_range: float = 0.0
    follows: bool = False


def _constant(motion: Motion, keys: Mapping[str, float]) -> Floats:  # noqa: ARG001
    return np.ones((motion.position_m.size, 1))


def _inertia(motion: Motion, keys: Mapping[str, float]) -> Floats:  # noqa: ARG001
    return np.array(motion.acceleration_m_s2, np.float64)[:, None]


def _spring(motion: Motion, keys: Mapping[str, float]) -> Floats:
    return np.asarray(motion.position_m - keys["centre"])[:, None]


def _gravity(motion: Motion, keys: Mapping[str, float]) -> Floats:  # noqa: ARG001
    return np.column_stack([np.sin(motion.position_m), np.cos(motion.position_m)])


def _direction(motion: Motion, keys: Mapping[str, float]) -> Floats:  # noqa: ARG001
    return motion.direction[:, None]


LOADS: Registry[Load] = Registry("load term")
"""Kinds of load by name; effects that hide or find one take its columns from here."""

LOADS.register(
    "inertia",
    Load(("inertia",), "kg", _inertia, "add a second period or a multisine, faster than this", "acceleration", True),
)
LOADS.register(
    "gravity",
    Load(
        ("sin", "cos"),
        "N",
        _gravity,
        "move over a larger angle, and at several speeds",
        "position",
        even=True,
        least_range=1.0,
    ),
)
LOADS.register(
    "spring",
    Load(
        ("stiffness",),
        "N/m",
        _spring,
        "add a second period or a larger stroke",
        "position",
        True,
        {"centre": 0.0},
        even=True,
    ),
)
LOADS.register(
    "constant",
    Load(
        ("constant",),
        "N",
        _constant,
        "reverse slowly and often; friction that differs between the directions is told from it near standstill only",
        even=True,
    ),
)
LOADS.register(
    "load_dependence",
    Load(
        ("share",),
        "1",
        _direction,
        "let the load vary from none to much at the same velocities: lift and lower it",
        follows=True,
    ),
)


@dataclass(frozen=True)
class LoadPart:
    """One coefficient of one term.

    Attributes
    ----------
    name : name of the term in LOADS. part : place of the column. keys : of the term.
    value : the coefficient in SI units; None where it is to be learned.
    """

    name: str
    part: int
    keys: Mapping[str, float]
    value: float | None

    @property
    def load(self) -> Load:
        """The kind."""
        return LOADS[self.name]

    @property
    def label(self) -> str:
        """Name of the coefficient: of the term alone where it has one, else with the part.

        >>> [part.label for part in parse_term("gravity")]
        ['gravity:sin', 'gravity:cos']
        """
        return self.name if len(self.load.parts) == 1 else f"{self.name}:{self.load.parts[self.part]}"

    def column(self, motion: Motion) -> Floats:
        """Return the force per coefficient, (n,)."""
        return np.asarray(self.load.columns(motion, self.keys)[:, self.part])


def parse_term(text: str) -> list[LoadPart]:
    """Return the coefficients that an entry of `load.terms` describes.

    `NAME` is unknown, `NAME=VALUE` is known; `NAME:key=value,...` gives coefficients or keys by name.

    Raises
    ------
    ConfigError : unknown name or key, or no number; one line.

    Examples
    --------
    >>> [(part.label, part.value) for part in parse_term("gravity:cos=0")]
    [('gravity:sin', None), ('gravity:cos', 0.0)]
    >>> parse_term("inertia=0.02")[0].value
    0.02
    """
    head, _, rest = text.partition(":")
    name, equals, alone = head.partition("=")
    name = name.strip()
    try:
        load = LOADS[name]
    except ConfigError as error:
        raise ConfigError(f"load.terms: {text!r}: {error}") from None
    items = [item.strip() for item in rest.split(",") if item.strip()]
    if equals:
        if len(load.parts) > 1:
            raise ConfigError(f"load.terms: {text!r}: {name} has {len(load.parts)} values: {_example(name)}")
        items.append(f"{load.parts[0]}={alone.strip()}")
    keys, values = dict(load.keys), {}
    for item in items:
        key, is_given, word = (part.strip() for part in item.partition("="))
        if key not in load.parts and key not in load.keys:
            raise ConfigError(f"load.terms: {text!r}: {name} has no {key!r}; it has {_known(load)}")
        if key in values:
            raise ConfigError(f"load.terms: {text!r}: {key} is given twice")
        values[key] = _number(word) if is_given else np.nan
        if not abs(values[key]) <= LARGEST_COEFFICIENT:
            raise ConfigError(f"load.terms: {text!r}: {item!r} is not {key}=number")
    if load.follows and values:
        raise ConfigError(f"load.terms: {text!r}: {name} is learned: name it alone")
    keys |= {key: value for key, value in values.items() if key in load.keys}
    return [LoadPart(name, place, keys, values.get(part)) for place, part in enumerate(load.parts)]


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")


def _known(load: Load) -> str:
    return ", ".join([*load.parts, *load.keys])


def _example(name: str) -> str:
    return f"{name}:{','.join(f'{part}=VALUE' for part in LOADS[name].parts)}"


class LoadTerms:
    """The terms of `load.terms`.

    Parameters
    ----------
    config : `load.terms`; range and units where the columns of unknown terms are asked for.

    Raises
    ------
    ConfigError : a term that cannot be read, or a coefficient that is named twice.

    Examples
    --------
    >>> terms = LoadTerms(Config.from_mapping({"load.terms": ["inertia", "gravity:sin=1.2,cos=0"]}))
    >>> [part.label for part in terms.unknown], terms.size
    (['inertia'], 1)
    """

    def __init__(self, config: Config) -> None:
        parts = [part for text in config.load.terms for part in parse_term(text)]
        labels = [part.label for part in parts]
        for label in labels:
            if labels.count(label) > 1:
                raise ConfigError(f"load.terms: {label} is named twice")
        self.follows = any(part.load.follows for part in parts)
        if self.follows and len(parts) == 1:
            raise ConfigError("load.terms: load_dependence is the friction that the other terms cause: name these too")
        # What follows the load comes last: `prediction.rubbing` finds it there.
        unknown = (part for part in parts if part.value is None)
        self.unknown = tuple(sorted(unknown, key=lambda part: part.load.follows))
        self.known = tuple(part for part in parts if part.value is not None)
        self._speed = config.velocity_scale
        self._unit_N = config.unit_N

    @property
    def size(self) -> int:
        """Number of coefficients to learn."""
        return len(self.unknown)

    def needs(self, what: str) -> bool:
        """Return whether a term needs the "acceleration" or the "position"."""
        return any(part.load.needs == what for part in (*self.unknown, *self.known))

    @property
    def even(self) -> bool:
        """Whether an unknown term looks like friction that differs between the directions."""
        return any(part.load.even for part in self.unknown)

    @property
    def scales(self) -> Floats:
        """SI value of each unknown coefficient over its value in force units, (size,)."""
        return np.array(
            [1.0 if part.load.follows else self._unit_N * self._without_dimension(part) for part in self.unknown]
        )

    def _without_dimension(self, part: LoadPart) -> float:
        """Return the factor on a column, V^-1 T0^+-1 or 1; T0 is 1 s."""
        return 1.0 / self._speed if part.load.of_motion else 1.0

    def columns(self, samples: Samples) -> Floats:
        """Return the columns of the unknown terms, (n, size), without dimension: force units per force unit."""
        out = np.empty((len(samples), self.size))
        motion = SampleMotion(samples, self._speed)
        for i, part in enumerate(self.unknown):
            out[:, i] = np.clip(part.column(motion) * self._without_dimension(part), -LARGEST_COLUMN, LARGEST_COLUMN)
        return out

    def noise(self, samples: Samples) -> Floats:
        """Return the variance of the noise in `columns`, (n, size): the acceleration has some."""
        out = np.zeros((len(samples), self.size))
        if samples.acceleration_variance is not None:
            for i, part in enumerate(self.unknown):
                if part.load.needs == "acceleration":
                    out[:, i] = samples.acceleration_variance * self._without_dimension(part) ** 2
        return np.minimum(out, LARGEST_COLUMN**2)

    def doubt(self, samples: Samples) -> Floats:
        """Return the square of what the doubt about the acceleration makes of `columns` and, last, of the known load.

        (n, size + 1), without dimension, the last in force units squared; (n, 0) where no term needs the acceleration.
        """
        if samples.acceleration_doubt is None or not self.needs("acceleration"):
            return np.zeros((len(samples), 0))
        factors = np.zeros(self.size + 1)
        for i, part in enumerate(self.unknown):
            if part.load.needs == "acceleration":
                factors[i] = self._without_dimension(part)
        for part in self.known:
            if part.load.needs == "acceleration":
                assert part.value is not None
                factors[-1] += part.value / self._unit_N
        return np.minimum(samples.acceleration_doubt[:, None] * factors**2, LARGEST_COLUMN**2)

    def force_N(self, samples: Samples, weights: Floats) -> Floats:
        """Return the force of the unknown terms, (n,), N, their coefficients `weights`, (size,), in force units."""
        columns = self.columns(samples)
        if self.follows:
            size = np.abs(columns[:, :-1] @ weights[:-1] + self.known_N(samples) / self._unit_N)
            columns[:, -1] *= size
        return np.asarray(self._unit_N * (columns @ weights))

    def known_N(self, samples: Samples) -> Floats:
        """Return the force of the known terms, (n,), N."""
        total, motion = np.zeros(len(samples)), SampleMotion(samples, self._speed)
        for part in self.known:
            assert part.value is not None
            total += part.value * part.column(motion)
        return np.clip(total, -LARGEST_LOAD_N, LARGEST_LOAD_N)


@dataclass(frozen=True)
class SampleMotion:
    """The motion of samples of a drive of this top speed; ConfigError for an acceleration that was not made."""

    samples: Samples
    top_m_s: float

    @property
    def acceleration_m_s2(self) -> Floats:
        """Acceleration."""
        return _made(self.samples.acceleration_m_s2)

    @property
    def position_m(self) -> Floats:
        """Position."""
        return np.zeros(len(self.samples)) if self.samples.position_m is None else self.samples.position_m

    @property
    def direction(self) -> Floats:
        """Sign of the velocity, smoothed about standstill."""
        return smooth_sign(self.samples.velocity_m_s, self.top_m_s)


def smooth_sign(velocity_m_s: Floats, top_m_s: float) -> Floats:
    """Return the sign of the velocity, (n,), smoothed about standstill, for a drive of this top speed."""
    return np.asarray(np.tanh(velocity_m_s / (SMOOTH_SHARE * top_m_s)))


def _made(values: Floats | None) -> Floats:
    if values is None:
        raise ConfigError("load.terms need the acceleration, which these samples lack: admit them by Intake")
    return values


def friction_alone(config: Config, samples: Samples) -> Floats:
    """Return the effort less a rough fit of the unknown load terms, (n,), N: what the scale of friction is taken from.

    A ridge regression on the terms, a smooth sign of the velocity and the velocity itself, to the effort without its
    spikes: one of them among the first samples would make the load, and what is left of the effort, as large as itself.
    Without unknown terms it is the effort.
    """
    terms = LoadTerms(config)
    linear = [part for part in terms.unknown if not part.load.follows]
    if not linear or not len(samples):
        return samples.friction_N
    velocity = samples.velocity_m_s
    top = float(np.quantile(np.abs(velocity), 0.99)) or 1.0
    motion = SampleMotion(samples, top)
    load = np.column_stack([part.column(motion) for part in linear])
    friction = np.column_stack([smooth_sign(velocity, top), velocity])
    columns = np.column_stack([load, friction])
    norm = np.sqrt(np.mean(np.square(columns), axis=0))
    columns = columns / np.where(norm > 0.0, norm, 1.0)
    gram = columns.T @ columns / len(samples) + FIT_RIDGE * np.eye(columns.shape[1])
    most = SPIKES_ABOVE * float(np.quantile(np.abs(samples.friction_N), 0.98)) or math.inf
    weights = np.linalg.solve(gram, columns.T @ np.clip(samples.friction_N, -most, most) / len(samples))
    return np.asarray(samples.friction_N - columns[:, : len(linear)] @ weights[: len(linear)])
