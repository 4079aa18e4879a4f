"""The extended model: terms of `extension.terms` as columns that the estimator runs beside the base model.

A term is `NAME:key=value,...`: an effect's id, the parameters of its regressor, `part` (which of its columns, from 0)
and `scale` (what the column is divided by, so that its coefficient is in N), and where the cause is a function of time,
distance, position or pressure, `from` and `to`: what was measured of it; beyond, the term keeps its value at the end.
Static shapes keep theirs beyond the reference's top speed. The reference curve that dynamic terms
are made from is the configuration's own: theory and learned weights at construction, frozen. Beside a film that lags
what is friction at a speed follows it by the share that the diagnosis found, as in the fit. Batch and
sample-by-sample use give the same numbers, since every column is a causal machine that carries its state.
"""

from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake.strokes import REVERSAL_SHARE
from friction_estimator.core.model.basis import basis_from_config
from friction_estimator.core.model.structure import check_count, theory_scale
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import NO_VELOCITY
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.base import EFFECTS, SLOW, Effect
from friction_estimator.effects.columns import Columns, RunningForce
from friction_estimator.effects.features import FeatureMaker, Features
from friction_estimator.effects.on_film import FilmMachine, partly
from friction_estimator.effects.reference import Reference, Surface

PART, SCALE, FROM, TO = "part", "scale", "from", "to"

SIGN_SHARE = 20.0
SIGN_SHARE_WITHOUT_THEORY = 60.0
"""v_s is the theory's, at most the top speed over SIGN_SHARE; without a theory the top speed over the latter."""

PRESSURE_NODES = 9
HIGHEST_PRESSURE = 20e6
"""Gauge pressures from 0 to this are tabulated where the theory depends on pressure, Pa."""

DERIVATIVE_STEP = 0.02


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
    by_place = effect.reveals == "position_m"
    return effect.reveals if effect.acts == SLOW or effect.recorded or by_place else None


def parse_term(text: str) -> TermSpec:
    """Return the term that a line of `extension.terms` describes.

    Raises
    ------
    ConfigError : unknown effect, an effect without a regressor, a missing or malformed parameter; one line.

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
    try:
        columns = cls.columns(values)
    except NotImplementedError:
        raise ConfigError(f"extension.terms: {text!r}: {cls.name} has no regressor") from None
    except KeyError as missing:
        raise ConfigError(f"extension.terms: {text!r}: {missing.args[0]} is missing") from None
    if int(part) >= columns.size:
        raise ConfigError(f"extension.terms: {text!r}: {cls.name} has {columns.size} columns, part counts from 0")
    missing_key = _missing(columns)
    if missing_key:
        raise ConfigError(f"extension.terms: {text!r}: {missing_key} is missing")
    return TermSpec(cls, values, int(part), scale, (low, high) if np.isfinite([low, high]).any() else None)


def _missing(columns: Columns) -> str:
    """Return the first parameter that the columns ask for and the term lacks, or nothing."""
    empty = Samples(np.zeros(1, np.int64), np.zeros(1), np.zeros(1), np.ones(1, np.bool_))
    features = FeatureMaker(0.0, 0.0, 20.0)(empty)
    flat = Reference(np.zeros((4, 1, 3)), np.zeros(1), VelocityAxis(1.0), 1.0)
    try:
        columns(features, flat)
    except KeyError as missing:
        return str(missing.args[0])
    finally:
        columns.restart()
    return ""


class ExtensionTerms:
    """Columns of the extended model (the estimator's `Extension`).

    Parameters
    ----------
    config : `extension.terms`, theory, basis and learned weights.

    Raises
    ------
    ConfigError : a term that cannot be used.
    """

    def __init__(self, config: Config) -> None:
        self._specs = [parse_term(text) for text in config.extension.terms]
        theory = config.theory
        self._make = FeatureMaker(
            theory.ambient_pressure,
            theory.default_pressure,
            theory.default_temperature,
            REVERSAL_SHARE * config.velocity_scale,
        )
        self._reference = reference_from_config(config)
        self._running = RunningForce(self._reference)
        self._columns: list[Columns] = []
        self._firsts: list[TermSpec] = []
        self._there: list[Columns | None] = []
        # A film comes first: the force that runs has it in it.
        in_order = sorted(self._specs, key=lambda spec: not spec.effect.in_theory)
        film = next((spec for spec in in_order if spec.effect.in_theory), None)
        known: dict[tuple[object, ...], int] = {}
        for spec in in_order:
            if spec.machine not in known:
                known[spec.machine] = len(self._columns)
                self._columns.append(spec.effect.columns(spec.params))
                self._firsts.append(spec)
                carried = film is not None and spec.effect.follows_film() and not spec.effect.in_theory
                # What is made of the running force is made of all of it, in a fit too.
                carried = carried and not self._columns[-1].of_force
                self._there.append(spec.effect.columns(spec.params) if carried else None)
        self._place = [known[spec.machine] for spec in self._specs]
        self._film: FilmMachine | None = None
        if film is not None and any(self._there):
            self._film = FilmMachine(film.effect, film.params, self._reference)

    @property
    def size(self) -> int:
        """Number of columns: one for each term."""
        return len(self._specs)

    @property
    def phases(self) -> Bools:
        """Which columns are waves in time, (size,): their coefficients say nothing of another recording."""
        return np.array([spec.effect.has_phase for spec in self._specs], np.bool_)

    @property
    def forces(self) -> Bools:
        """Which columns are scaled, so that their coefficients are forces in N, (size,)."""
        return np.array([spec.scale != 1.0 for spec in self._specs], np.bool_)

    @property
    def names(self) -> tuple[str, ...]:
        """Effect id of each term."""
        return tuple(spec.effect.name for spec in self._specs)

    def columns(self, samples: Samples, theory_N: Floats) -> Floats:  # noqa: ARG002 - the estimator's interface
        """Return the columns for the next samples, (n, size), N per unit coefficient."""
        features = self._running(self._make(samples))
        top = self._reference.top_m_s
        film, forced = None if self._film is None else self._film(features), features
        groups = []
        for columns, there, spec in zip(self._columns, self._there, self._firsts, strict=True):
            made = columns(held(forced if columns.of_force else features, spec, top), self._reference)
            if film is not None and there is not None:
                on_it = there(held(film.features, spec, top), self._reference)
                made = partly(film.share, film.factor_of(spec.effect), made, on_it)
            if spec.effect.in_theory and forced is features:
                forced = features.with_force(features.force_N + made[:, 0])
            groups.append(made)
        out = np.empty((len(samples), self.size))
        for i, (spec, place) in enumerate(zip(self._specs, self._place, strict=True)):
            out[:, i] = groups[place][:, spec.part] / spec.scale
        return out

    def restart(self) -> None:
        """Forget the past: the next sample is the first."""
        self._make.restart()
        self._running.restart()
        if self._film is not None:
            self._film.restart()
        for columns in (*self._columns, *self._there):
            if columns is not None:
                columns.restart()


def held(features: Features, spec: TermSpec, top_m_s: float) -> Features:
    """Return the features within what was measured of a term's cause, and a static shape's within the top speed."""
    name = held_variable(spec.effect)
    if name is not None and spec.measured is not None:
        features = replace(features, **{name: np.clip(getattr(features, name), *spec.measured)})
    if spec.effect.about_curve:
        features = replace(features, velocity_m_s=np.clip(features.velocity_m_s, -top_m_s, top_m_s))
    return features


def extension_from_config(config: Config) -> ExtensionTerms | None:
    """Return the extension that `extension.terms` asks for, or None where it is empty.

    Raises
    ------
    ConfigError : a term that cannot be used.
    """
    return ExtensionTerms(config) if config.extension.terms else None


def extension_as_met(config: Config, samples: Samples) -> ExtensionTerms | None:
    """Return the terms of `extension.terms` beside the model that these samples open with, as the node has them."""
    return extension_from_config(meet(config, samples).config) if config.extension.terms else None


def sign_velocity(config: Config, top_m_s: float) -> float:
    """Return v_s of the smooth sign for a drive of this top speed, m/s."""
    if config.theory_kind == "seal":
        return min(config.seal.sign_velocity, top_m_s / SIGN_SHARE)
    return top_m_s / SIGN_SHARE_WITHOUT_THEORY


def reference_from_config(config: Config) -> Reference:
    """Return the reference tables of a configuration: theory and g with their learned gains, and the FIR's shape.

    Cold (nothing learned) it is the theory alone, or without one a Coulomb curve of one `force_unit`.
    """
    # What was learned, also beside a range that is given: shapes over the speed were fitted over it.
    top = config.learned.velocity_scale or config.velocity_scale or NO_VELOCITY
    smooth = sign_velocity(config, top)
    theory = theory_from_config(config) if config.has_theory else None
    learned = config.learned
    taps = np.array(learned.fir_taps or (1.0,))
    theory_gain = theory_scale(config, theory) * (float(np.sum(learned.theory_taps)) if learned.theory_taps else 1.0)
    warm = config.theory.default_temperature
    basis = basis_from_config(config) if learned.wavelet_weights and config.reach else None
    weights = np.array(learned.wavelet_weights)
    if basis is not None:
        check_count("wavelet_weights", weights.size, basis.size)
    unit = config.unit_N or 1.0

    def force(v: Floats, p: Floats) -> Floats:
        total = np.zeros(v.size)
        if theory is not None:
            total += theory_gain * theory.evaluate(v, p, np.full(v.size, warm))
        if basis is not None:
            index, value = basis.rows(v)
            total += unit * float(taps.sum()) * np.sum(weights[index] * value, axis=1)
        elif theory is None:
            total += unit * np.tanh(v / smooth)
        return total

    viscous, boundary, alone = theory_parts(theory, theory_gain, warm)
    pressures = np.linspace(0.0, HIGHEST_PRESSURE, PRESSURE_NODES) if theory is not None else np.zeros(1)
    if theory is not None:
        pressures = np.unique(np.append(pressures, np.linspace(0.0, 2e6, PRESSURE_NODES)))
    lead = float(taps[0]) if abs(taps[0]) > 0.1 * float(np.abs(taps).sum()) else 0.0
    shape = taps[1:] / lead if lead else np.zeros(0)
    made = Reference.tabulate(force, viscous, boundary, alone, VelocityAxis(top), pressures, smooth, shape)
    own = np.array(learned.theory_taps)
    if theory is None or own.size != taps.size or not lead or not own.sum():
        return made
    return replace(made, theory_lags=own[1:] / own.sum() - taps[1:] / taps.sum())


def theory_parts(
    theory: object, gain: float, temperature_degC: float
) -> tuple[Surface | None, Surface | None, Surface | None]:
    """Return viscous derivative, boundary part and whole of a seal theory times `gain`, or None for other theories."""
    if not isinstance(theory, SealCurve):
        return None, None, None
    curve = theory

    def derivative(v: Floats, p: Floats, viscosity: float, friction: float) -> Floats:
        one, warm = np.ones(v.size), np.full(v.size, temperature_degC)
        film = curve.entrainment(v)
        more = curve.on_film(v, film, p, warm, one * (1.0 + viscosity), one * (1.0 + friction))
        less = curve.on_film(v, film, p, warm, one * (1.0 - viscosity), one * (1.0 - friction))
        return np.asarray((more - less) / (2.0 * DERIVATIVE_STEP) * gain)

    return (
        lambda v, p: derivative(v, p, DERIVATIVE_STEP, 0.0),
        lambda v, p: derivative(v, p, 0.0, DERIVATIVE_STEP),
        lambda v, p: np.asarray(curve.evaluate(v, p, np.full(v.size, temperature_degC)) * gain),
    )
