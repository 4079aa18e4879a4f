"""The extended model: terms of `extension.terms` as columns that the estimator runs beside the base model.

The reference curve that dynamic terms are made from is the configuration's own: theory and learned weights at
construction, frozen. Terms stand beside each other as in the fit: what is friction at a speed follows a film that lags,
what acts before a time of the whole force does so at its time. Batch and sample-by-sample use give the same numbers,
since every column is a causal machine that carries its state.
"""

from dataclasses import replace

import numpy as np

from friction_estimator.core.intake.strokes import REVERSAL_SHARE
from friction_estimator.core.model.basis import basis_from_config
from friction_estimator.core.model.structure import check_count, theory_scale
from friction_estimator.core.model.theory import TheoryCurve, theory_from_config
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import NO_VELOCITY
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.features import FeatureMaker
from friction_estimator.effects.reference import Reference, Surface, tabled
from friction_estimator.effects.term import parse_term
from friction_estimator.effects.together import AtTime, Cause, Together

SIGN_SHARE = 20.0
SIGN_SHARE_WITHOUT_THEORY = 60.0
"""v_s is the theory's, at most the top speed over SIGN_SHARE; without a theory the top speed over the latter."""

PRESSURE_NODES = 9
HIGHEST_PRESSURE = 20e6
"""Gauge pressures from 0 to this are tabulated where the theory depends on pressure, Pa."""

DERIVATIVE_STEP = 0.02


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
        theory, reversal = config.theory, REVERSAL_SHARE * config.velocity_scale

        def make() -> FeatureMaker:
            usual = theory.ambient_pressure, theory.default_pressure, theory.default_temperature
            return FeatureMaker(*usual, reversal)

        self._make = make()
        self._reference = reference_from_config(config)
        causes = self._causes(np.array(config.learned.extension_weights))
        time = next((c for c in causes if c.effect.delays), None)
        early = [c for c in causes if time is not None and c.stage < time.stage]
        late = [c for c in causes if c not in early]
        self._early = AtTime(time, causes, early, self._reference, make) if time is not None and early else None
        self._late = Together(causes, late, self._reference, early=False)
        place = {c.spec.machine: i for i, c in enumerate([*early, *late])}
        self._place = [place[spec.machine] for spec in self._specs]

    def _causes(self, weights: Floats) -> list[Cause]:
        """Return the causes in the order in which they act; what is in the base's force first."""
        weights = weights if weights.size == self.size else np.zeros(self.size)
        known: dict[tuple[object, ...], Cause] = {}
        for spec, weight in zip(self._specs, weights, strict=True):
            if spec.machine not in known:
                known[spec.machine] = Cause(spec, np.zeros(spec.effect.columns(spec.params).size))
            known[spec.machine].weights[spec.part] += weight / spec.scale

        def order(cause: Cause) -> tuple[bool, int, bool]:
            in_base = cause.effect.in_theory or cause.effect.delays
            return not in_base, cause.stage, cause.columns().of_force

        return sorted(known.values(), key=order)

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
        features = self._make(samples)
        groups, force = ([], None) if self._early is None else self._early(samples, features)
        groups += self._late(features, force)
        out = np.empty((len(samples), self.size))
        for i, (spec, place) in enumerate(zip(self._specs, self._place, strict=True)):
            out[:, i] = groups[place][:, spec.part] / spec.scale
        return out

    def restart(self) -> None:
        """Forget the past: the next sample is the first."""
        self._make.restart()
        self._late.restart()
        if self._early is not None:
            self._early.restart()


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
    axis = VelocityAxis(top)
    tables = tabled((force, viscous, boundary, alone), axis, pressures)
    made = Reference.of(tables, axis, pressures, smooth, shape, theory_sign(theory))
    own = np.array(learned.theory_taps)
    if theory is None or own.size != taps.size or not lead or not own.sum():
        return made
    return replace(made, theory_lags=own[1:] / own.sum() - taps[1:] / taps.sum())


def theory_sign(theory: TheoryCurve | None) -> float | None:
    """Return v_s of a theory's own smooth sign, m/s, or None where that is not known."""
    return None if theory is None else theory.sign_velocity_m_s


def theory_parts(
    theory: TheoryCurve | None, gain: float, temperature_degC: float
) -> tuple[Surface | None, Surface | None, Surface | None]:
    """Return viscous derivative, boundary part and whole of a theory times `gain`: the first two of a seal's alone."""
    if theory is None:
        return None, None, None
    if not isinstance(theory, SealCurve):
        return None, None, lambda v, p: np.asarray(gain * theory.evaluate(v, p, np.full(v.size, temperature_degC)))
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
