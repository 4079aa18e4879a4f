"""What an effect is: its simulation, its regressor, its words; and the registry of all of them.

An effect is one class in one place. It says how the rig simulation hides it in data (`apply`), which columns the
diagnosis proposes for it (`grid`, `columns`), and what a test engineer should know of it (`words`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import either
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.effects.columns import Columns, SideBySide
from friction_estimator.effects.detection import ORDER, DataView, Fault
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import about
from friction_estimator.effects.kernels import DELAY_LINE
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.trace import STAGES, Trace
from friction_estimator.effects.whole import StaticTables


@dataclass(frozen=True)
class Key:
    """One parameter of an effect: name, unit on a linear drive, default, inclusive bounds and meaning."""

    name: str
    unit: str
    default: float
    low: float
    high: float
    description: str

    def checked(self, effect: str, value: object) -> float:
        """Return `value` as a float; ConfigError names effect, key, range and unit where it cannot be used."""
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise ConfigError(f"effect {effect}: {self.name}={value!r} is no number") from None
        if not math.isfinite(number) or not self.low <= number <= self.high:
            unit = f" {either(self.unit)}" if self.unit else ""
            raise ConfigError(
                f"effect {effect}: {self.name}={number:g} is out of range [{self.low:g}, {self.high:g}]{unit}"
            )
        return number


FORM = "form"


def form_key(description: str) -> Key:
    """Return the key that chooses between functional forms of one cause: 0 the usual one, 1 the other."""
    return Key(FORM, "", 0.0, 0.0, 1.0, f"functional form: 0 usual, 1 {description}")


@dataclass(frozen=True)
class Words:
    """What a test engineer should know of an effect, in words that `Quantities.worded` completes.

    Attributes
    ----------
    what : what is true.
    where : where it shows.
    confused_with : effect id -> the experiment that separates the two.
    told_by : the experiment that tells between its `Effect.untold` forms.
    """

    what: str
    where: str
    confused_with: Mapping[str, str]
    told_by: str = ""


Params = Mapping[str, float]
Stated = dict[str, tuple[float, str]]
"""Name of a quantity -> value and unit."""

EVERYWHERE, REVERSAL, SLOW = "everywhere", "reversal", "slow"
"""Values of `Effect.acts`."""


@dataclass(frozen=True)
class Film:
    """The film that an effect has built.

    Attributes
    ----------
    share : of what is not the theory's that follows it. speed_m_s : (n,), u, at which it would be there for long.
    way : (n,), -1 to 1, the direction in which it was built; None: what differs between the directions turns at once.
    """

    share: float
    speed_m_s: Floats
    way: Floats | None = None


FILM_STATE = DELAY_LINE + 2
"""State variables of a film."""

Smoother = Callable[[Sequence[Floats], Floats], Floats]
"""(columns (n, c) at some moments, times between samples (n,)) -> what a filter makes of them, (n, c)."""


class Effect:
    """One cause of a difference between simulation and measurement.

    Subclasses set the class attributes and override `apply`; those with a regressor also `grid` and `columns`. Their
    docstring states the equation of `apply` under ``Formula::``.

    Parameters
    ----------
    size : rms of the change that the effect makes over the rms of the clean friction; the value of `size_key` is
        then found by `compose.resolved`. None: the keys say it all.
    values : keys of the effect; missing ones take their default.

    Attributes
    ----------
    name : id of the effect: the catalogue's key, the name that `simulate --effect` takes.
    family : effects of one family are alternatives to each other rather than a second cause.
    stage : one of `STAGES`.
    keys : parameters of the simulation.
    size_key : the key that `size` sets.
    linear : True where the change is proportional to the value of `size_key`.
    reveals : the variable against which one sees the effect (a field of `Features`).
    turns : True where the effect changes its sign with the direction of motion: one sees it in the residual taken
        in that direction.
    even : True where its force does not, and differs between the directions as the film does (`Film.way`).
    rotary : True where only a shaft that turns can have it.
    channel : recorded channel without which the effect cannot be named ("position", "pressure" or "").
    signs : sign of each column's coefficient, +1 or -1 where physics fixes it, 0 where it is free.
    positive : fitted quantities that are above zero in a form of several columns, too.
    fixed_gain : True where the columns are the whole change (coefficient one), as for a delay.
    systematic : fitted quantity -> relative shift that another functional form of the same cause can make; part of its
        interval, since data alone rarely tell the form (measured with the `form` keys, see benchmarks/diagnosis).
    refined : grid parameters that the diagnosis refines continuously after naming; a form may lack some of them.
    steps : those of them in which the columns jump rather than bend; sought by zooming.
    shares : those of them that are a share between 0 and 1: they move by the steps of a joint fit only.
    acts : "everywhere"; "reversal" where the columns act shortly after reversals only; "slow" where they are a function
        of the time or the distance run.
    many : True where the grid has hundreds of points: a bootstrap of its own, and a gain in most blocks.
    has_phase : True where the columns are waves in time: their coefficients are of one recording, and of none else.
    recorded : True where a recorded variable is the cause: preferred to unrecorded causes that change with it.
    about_curve : True where the effect says that the static curve F(v; p) is another one: a wrong theory may bring it.
        Clipping and bias are none of these: they would blame the sensor for it.
    delays : True where the effect is one time of the whole force, which the base's own memory can take up: the two are
        compared by evidence. smooths : True where it filters what acts before it.
    in_theory : True where the effect moves the theory's own curve, so that its columns scale with the theory's gain;
        it has a `film`.
    scatters : True where the effect adds scatter rather than a mean.
    detects_at : when `detect` is asked, one of `detection.ORDER`; "" where the effect is no fault of the data.
    figure : kind of figure that shows it (`report.diagnosis_figures`); "reveals" is the residual over `reveals`.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    stage: ClassVar[str]
    keys: ClassVar[tuple[Key, ...]]
    size_key: ClassVar[str]
    linear: ClassVar[bool] = True
    words: ClassVar[Words]
    reveals: ClassVar[str] = "time_s"
    turns: ClassVar[bool] = False
    even: ClassVar[bool] = False
    rotary: ClassVar[bool] = False
    channel: ClassVar[str] = ""
    signs: ClassVar[tuple[int, ...]] = (0,)
    positive: ClassVar[tuple[str, ...]] = ()
    fixed_gain: ClassVar[bool] = False
    systematic: ClassVar[Mapping[str, float]] = {}
    refined: ClassVar[tuple[str, ...]] = ()
    steps: ClassVar[tuple[str, ...]] = ()
    shares: ClassVar[tuple[str, ...]] = ()
    acts: ClassVar[str] = EVERYWHERE
    many: ClassVar[bool] = False
    has_phase: ClassVar[bool] = False
    recorded: ClassVar[bool] = False
    about_curve: ClassVar[bool] = False
    delays: ClassVar[bool] = False
    smooths: ClassVar[bool] = False
    in_theory: ClassVar[bool] = False
    scatters: ClassVar[bool] = False
    detects_at: ClassVar[str] = ""
    figure: ClassVar[str] = "reveals"

    def __init__(self, size: float | None = None, **values: object) -> None:
        known = {key.name: key for key in self.keys}
        for name in values:
            if name not in known:
                raise ConfigError(f"effect {self.name} has no key {name!r}: it has {', '.join([*known, 'size'])}")
        self.values: dict[str, float] = {
            name: key.checked(self.name, values.get(name, key.default)) for name, key in known.items()
        }
        if size is not None and (not math.isfinite(size) or not 0.0 < size <= 1.0):
            raise ConfigError(f"effect {self.name}: size={size:g} is out of range (0, 1] (rms over rms of friction)")
        self.size = size

    def __getitem__(self, key: str) -> float:
        return self.values[key]

    def with_values(self, **values: float) -> Self:
        """Return the effect with some values replaced and the size settled."""
        return type(self)(**(self.values | values))

    @property
    def spec(self) -> str:
        """The effect as `parse_effect` reads it."""
        parts = [f"{name}={value!r}" for name, value in self.values.items()]
        return f"{self.name}:{','.join(parts)}" if parts else self.name

    # Simulation

    def apply(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Return the trace with the effect in it; the input stays as it is."""
        raise NotImplementedError

    def change(self, before: Trace, after: Trace) -> Floats:
        """Return the change of friction that counts for `size`, (n,), N."""
        return after.friction_N - before.friction_N

    # Regressor

    @classmethod
    def grid(cls, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Return the parameter sets that the diagnosis tries first; empty: no regressor (repair or variance)."""
        return []

    @classmethod
    def bracket(cls, name: str, value: float, context: Context) -> tuple[float, float]:  # noqa: ARG003
        """Return the range about `value` in which a `refined` parameter is sought; of a share, from nothing to all."""
        return (0.0, 1.0) if name in cls.shares else about(value)

    @classmethod
    def formed(cls) -> bool:
        """Return whether its cause has another functional form."""
        return any(key.name == FORM for key in cls.keys)

    @classmethod
    def by_place(cls) -> bool:
        """Return whether it goes with the position of the shaft."""
        return cls.reveals == "position_m"

    @classmethod
    def elsewhere(cls, params: Params, weights: Floats) -> tuple[dict[str, float], Floats]:
        """Return the form and the coefficients that hold for a recording that was not fitted (default the same).

        Where in its cycle a wave in time begins there nobody knows: it is learned anew.
        """
        return dict(params), np.zeros_like(weights) if cls.has_phase else weights

    @classmethod
    def variants(cls, params: Params) -> list[dict[str, float]]:  # noqa: ARG003
        """Return other shapes of the same cause, tried once it has been named."""
        return []

    @classmethod
    def untold(cls, params: Params) -> list[dict[str, float]]:  # noqa: ARG003
        """Return forms that a drive may not tell from this one; none is chosen, their values are in the intervals."""
        return []

    @classmethod
    def plainer(cls, params: Params) -> list[dict[str, float]]:  # noqa: ARG003
        """Return forms with fewer parameters, taken where this one explains no more than its further ones by chance."""
        return []

    @classmethod
    def wells(cls, params: Params) -> list[dict[str, float]]:  # noqa: ARG003
        """Return places beside this one at which the same form has a minimum of its own (default none)."""
        return []

    @classmethod
    def unscreened(cls, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Return places of forms that screening, which is linear about the base model, does not see (default none).

        They are forms that change so much that the base bends towards them.
        """
        return []

    @classmethod
    def columns(cls, params: Params) -> Columns:
        """Return the causal machine that makes the columns for one parameter set."""
        raise NotImplementedError

    @classmethod
    def side_by_side(cls, points: Sequence[Params]) -> Columns | SideBySide:
        """Return a machine that makes the columns of several parameter sets, beside each other."""
        return SideBySide([cls.columns(params) for params in points])

    @classmethod
    def physical(cls, params: Params, weights: Floats, context: Context) -> Stated:  # noqa: ARG003
        """Return fitted quantities in the names of the keys; shapes and the like are none."""
        return {key.name: (params[key.name], key.unit) for key in cls.keys if key.name in params}

    @classmethod
    def told(cls, params: Params, weights: Floats, context: Context, reference: Reference) -> Stated:  # noqa: ARG003
        """Return what is stated of the fitted quantities: `physical`, or what the record tells instead."""
        return cls.physical(params, weights, context)

    @classmethod
    def spans(cls, params: Params, weights: Floats, context: Context) -> str | None:  # noqa: ARG003
        """Return in words why the fitted values lie beyond what the record spans, or None where they do not."""
        return None

    @classmethod
    def unlike(cls, params: Params, context: Context) -> bool:  # noqa: ARG003
        """Return whether its force has a shape that no form of another cause has, and so is none's lack of fit."""
        return False

    @classmethod
    def belied(cls, params: Params, part_N: Floats, f: Features, r: Reference, context: Context) -> bool:  # noqa: ARG003
        """Return whether the fitted force (n,) has a shape that is another cause's; plain forms cannot."""
        return False

    @classmethod
    def peaks(cls, residual_N: Floats, features: Features, context: Context) -> list[dict[str, float]]:  # noqa: ARG003
        """Return parameter sets that a residual (n,) suggests, beside those of the grid."""
        return []

    @classmethod
    def whole(cls, params: Params, tables: "StaticTables", features: Features) -> Floats:
        """Return what one time of the whole force makes of the columns of a static curve, (n, m); where it `delays`."""
        raise NotImplementedError

    @classmethod
    def late_s(cls, params: Params) -> float:  # noqa: ARG003
        """Return the time by which what acts before it is seen late, s; where it `delays`."""
        return 0.0

    @classmethod
    def seen(cls, params: Params, channel: str, values: Floats, features: Features) -> Floats:  # noqa: ARG003
        """Return what acts before it has seen of a recorded channel, (n,); where it `delays`.

        `channel` is velocity_m_s, pressure_Pa or position_m.
        """
        return values

    @classmethod
    def seen_so_far(
        cls,
        params: Params,  # noqa: ARG003
        channel: str,  # noqa: ARG003
        values: Floats,
        features: Features,  # noqa: ARG003
        state: Floats,  # noqa: ARG003
    ) -> Floats:
        """Return `seen` of the next samples without a look ahead: what a live model has of it.

        `state` is carried from piece to piece, one for each channel, (DELAY_LINE,); zeros to begin with.
        """
        return values

    @classmethod
    def smoother(cls, params: Params) -> Smoother:  # noqa: ARG003
        """Return what it makes of an earlier stage's columns beside that lateness, samples after samples.

        It takes the columns, (n, c) each, at moments that divide the time to the sample before evenly, the last one
        that of the sample, one unless it smooths; and (n,), that time.
        """
        return lambda parts, _: parts[-1]

    @classmethod
    def film(cls, params: Params, features: Features, reference: Reference, state: Floats) -> Film | None:
        """Return the film that friction is on, or None where the theory alone follows it.

        `state` is carried from piece to piece, (FILM_STATE,); zeros to begin with.
        """
        raise NotImplementedError

    @classmethod
    def level_on_film(cls, params: Params, features: Features, reference: Reference, state: Floats) -> Floats:
        """Return the level of friction on a film that lags over that at the velocity, (n,).

        `state` is carried from piece to piece, (FILM_STATE,); zeros to begin with.
        """
        raise NotImplementedError

    @classmethod
    def carries(cls, params: Params) -> bool:  # noqa: ARG003
        """Return whether its columns are what bristles lack of the friction that they carry, at every speed."""
        return False

    @classmethod
    def follows_film(cls) -> bool:
        """Return whether its columns are friction at a speed, which a film that lags makes that of an earlier speed."""
        return cls.stage in STAGES[: STAGES.index("mechanics")] and cls.acts != REVERSAL

    @classmethod
    def further(
        cls,
        params: Params,  # noqa: ARG003
        residual_N: Floats,  # noqa: ARG003
        features: Features,  # noqa: ARG003
        context: Context,  # noqa: ARG003
    ) -> list[dict[str, float]]:
        """Return forms with more of the same in them, such as a second wave, that what is left, (n,), suggests."""
        return []

    # Fault of the data

    @classmethod
    def detect(cls, view: DataView) -> Fault | None:  # noqa: ARG003
        """Return the fault that the data show, or None."""
        return None

    @classmethod
    def counted(cls, facts: Mapping[str, float]) -> Fault | None:  # noqa: ARG003
        """Return the fault that what was counted while reading shows (`diagnosis.streams`), or None."""
        return None

    @classmethod
    def repairing_settings(cls, fault: Fault, config: Config) -> dict[str, object]:  # noqa: ARG003
        """Return the settings with which the intake keeps out by itself a fault that was found under `config`."""
        return {}

    @classmethod
    def repairing_term(cls, fault: Fault) -> dict[str, float] | None:  # noqa: ARG003
        """Return the regressor's parameters that the extended model takes up, with coefficient one, for a fault."""
        return None


EFFECTS: Registry[type[Effect]] = Registry("effect")


def effect(cls: type[Effect]) -> type[Effect]:
    """Register an effect class under its name (decorator)."""
    if cls.stage not in STAGES:
        raise ValueError(f"effect {cls.name} has the unknown stage {cls.stage!r}")
    if cls.acts not in (EVERYWHERE, REVERSAL, SLOW) or cls.detects_at not in ORDER:
        raise ValueError(f"effect {cls.name} acts {cls.acts!r} or is detected at {cls.detects_at!r}, which is unknown")
    EFFECTS.register(cls.name, cls)
    return cls
