"""The two models: what their parameters are and what a sample means to them.

    hammerstein   f = H(q) g(v)
    parallel      f = H1(q) d(v; p, T) + H(q) g(v)

and beside either the unknown terms of the load (`load`) and those that a diagnosis added, linear in their coefficients.
g is a sum over a wavelet basis, H and H1 are FIR filters, d is the theoretical steady-state curve (Kwak, Yagle, Levitt
1998, section 2). Inside, forces are in units of `force_unit` and velocities in units of `basis.velocity_unit`, so one
set of step sizes serves a 5 N seal and a 5 kN cylinder.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.basis import Basis, basis_from_config
from friction_estimator.core.model.load import LoadTerms
from friction_estimator.core.model.prediction import THEORY_TAPS
from friction_estimator.core.model.theory import TheoryCurve, theory_from_config
from friction_estimator.core.model.theory_choice import rms_over_unit, scale_points
from friction_estimator.core.sample import Bools, Floats, Ints, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import LARGEST_PARAMETER

CHUNK = 4096
"""Samples prepared at a time: bounds the memory of a pass over a recording."""


class Extension(Protocol):
    """Further terms, linear in their coefficients, that a diagnosis added to the model (effects/ has them)."""

    @property
    def size(self) -> int:
        """Number of columns."""

    @property
    def names(self) -> tuple[str, ...]:
        """Cause of each column."""

    @property
    def phases(self) -> Bools:
        """Which columns are waves in time, (size,): their coefficients say nothing of another recording."""

    @property
    def forces(self) -> Bools:
        """Which columns are scaled so that their coefficients are forces in N, (size,)."""

    def columns(self, samples: Samples, theory_N: Floats) -> Floats:
        """Return the terms' values for the next samples, (n, size), N; keeps its own delay lines."""

    def restart(self) -> None:
        """Forget the delay lines."""


PLAUSIBLE_SCALE = 30.0
"""A theoretical curve further off in scale than this factor, up or down, is used for its shape only."""


@dataclass(frozen=True)
class Inputs:
    """A batch of samples in normalised units, as the compiled loops take it.

    `noise` is the variance of that in the load's columns, `doubt` what corners of the velocity may have done to them
    (`LoadTerms.doubt`); `known` the known load, (n, 1), where friction follows the
    load, else (n, 0).
    """

    index: NDArray[np.int32]
    value: Floats
    theory: Floats
    extension: Floats
    noise: Floats
    doubt: Floats
    known: Floats
    target: Floats
    restart: Bools
    inside: Bools
    cell: Ints
    beyond: Floats

    def under_load(self, weights: Floats) -> "Inputs":
        """Return these with the column of friction that follows the load times its size, for coefficients (loads,)."""
        if not self.known.shape[1]:
            return self
        last, extension = weights.size - 1, self.extension.copy()
        extension[:, last] *= np.abs(self.known[:, 0] + extension[:, :last] @ weights[:last])
        return replace(self, extension=extension)


@dataclass(frozen=True)
class Parameters:
    """Learned values: FIR taps (n_taps,), weights (size,), theory taps (n_taps,) or empty, load, extension."""

    fir_taps: Floats
    wavelet_weights: Floats
    theory_taps: Floats
    load_weights: Floats
    extension_weights: Floats

    @property
    def theta(self) -> Floats:
        """The parameter vector [A, W, A1, C], C the coefficients of load and extension."""
        return np.concatenate([getattr(self, name) for name in LEARNED])


LEARNED = tuple(item.name for item in fields(Parameters))
"""The parts of the parameter vector in their order; `learned.NAME` of the configuration holds each."""


def check_count(name: str, given: int, wanted: int) -> None:
    """Raise ConfigError where `learned.NAME` has another number of values than the model."""
    if given != wanted:
        raise ConfigError(
            f"learned.{name} has {given} values and this model has {wanted}: "
            "it was learned with another basis, order or set of terms; leave it empty to start cold"
        )


def theory_scale(config: Config, theory: TheoryCurve | None) -> float:
    """Return the factor on the theoretical curve: 1, or what gives it the rms `force_unit` where it is far off.

    A curve for another machine (forces 1000 times larger, say) would otherwise dominate every regressor. One that was
    found from samples has their scale.
    """
    if theory is None or not config.has_units or config.finds_stribeck:
        return 1.0
    ratio = rms_over_unit(config, theory.evaluate(*scale_points(config)))
    plausible = 1.0 / PLAUSIBLE_SCALE <= ratio <= PLAUSIBLE_SCALE
    return 1.0 if plausible or not ratio > 0.0 else 1.0 / ratio


class Model:
    """Structure of a Hammerstein or parallel model, without its parameters' values.

    Parameters
    ----------
    config : range and units must be known (`Config.is_met`; see `settings.units`).
    extension : terms that a diagnosis added.

    Raises
    ------
    ConfigError : a unit is missing, or the learned values do not fit the structure.
    """

    def __init__(self, config: Config, extension: Extension | None = None) -> None:
        if not config.unit_N > 0.0:
            raise ConfigError(
                "force_unit is 0 and no first contact was made: give the expected rms of the friction "
                f"in {config.quantities.force}"
            )
        self.config = config
        self.unit_N = config.unit_N
        self.basis: Basis = basis_from_config(config)
        self.theory: TheoryCurve | None = theory_from_config(config) if config.is_parallel else None
        self.load = LoadTerms(config)
        self.extension = extension
        self.theory_scale = theory_scale(config, self.theory)
        self._number()

    def _number(self) -> None:
        """Count the parameters."""
        taps = self.config.fir.order + 1
        theory_taps = taps if self.config.is_parallel else 0
        columns = self.load.size + (self.extension.size if self.extension else 0)
        self.shape: Ints = np.array([taps, self.basis.size, theory_taps, columns], np.int64)
        self._edges = np.cumsum(self.shape)

    def reaching(self, low_m_s: float, high_m_s: float) -> "Model":
        """Return the model over another learned range: the scale stays, and with it theory, load and terms.

        Raises ConfigError where its basis would be too large.
        """
        other = copy.copy(self)
        chosen = {"learned.velocity_range": (low_m_s, high_m_s), "learned.velocity_scale": self.config.velocity_scale}
        other.config = self.config.updated(chosen)
        other.basis = basis_from_config(other.config)
        other._number()
        return other

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self._edges[-1])

    def split(self, theta: Floats) -> Parameters:
        """Return the parts of a parameter vector (copies)."""
        a, b, c, _ = self._edges
        parts = theta[:a], theta[a:b], theta[b:c], theta[self.load_places], theta[c + self.load.size :]
        return Parameters(*(part.copy() for part in parts))

    @property
    def load_places(self) -> slice:
        """Where the parameter vector holds the coefficients of the load."""
        start = int(self._edges[THEORY_TAPS])
        return slice(start, start + self.load.size)

    def initial_theta(self) -> Floats:
        """Return the start: H = H1 = 1, g = 0, so that parallel predicts the theory; or the learned values given."""
        start = self.split(np.zeros(self.size))
        start.fir_taps[0] = 1.0
        if start.theory_taps.size:
            start.theory_taps[0] = 1.0
        learned = self.config.learned
        for name in LEARNED:
            given, wanted = getattr(learned, name), getattr(start, name)
            if not given or (name == "theory_taps" and not wanted.size):
                continue
            check_count(name, len(given), wanted.size)
            wanted[:] = given
        return start.theta

    def checked(self, parameters: Parameters) -> Floats:
        """Return the parameter vector; raises ConfigError where it is not one of this model's."""
        theta = parameters.theta
        if theta.shape != (self.size,):
            raise ConfigError(f"{theta.size} learned values were given, this model has {self.size}")
        if not np.all(np.abs(theta) < LARGEST_PARAMETER):
            raise ConfigError(f"learned values must be finite and below {LARGEST_PARAMETER:g}")
        return theta

    def theoretical_friction(self, samples: Samples) -> Floats:
        """Return d(v; p, T) times `theory_scale` at the samples, (n,), N; zeros where there is no theory.

        Pressure and temperature that the recording lacks are `theory.default_*`.
        """
        if self.theory is None:
            return np.zeros(len(samples))
        settings = self.config.theory
        pressure = np.full(len(samples), settings.default_pressure)
        if samples.pressure_Pa is not None:
            known = np.isfinite(samples.pressure_Pa)
            pressure[known] = samples.pressure_Pa[known] - settings.ambient_pressure
        temperature = np.full(len(samples), settings.default_temperature)
        if samples.temperature_degC is not None:
            known = np.isfinite(samples.temperature_degC)
            temperature[known] = samples.temperature_degC[known]
        return self.theory_scale * self.theory.evaluate(samples.velocity_m_s, pressure, temperature)

    def theory_over(self, samples: Samples) -> Callable[[slice], Floats]:
        """Return what gives `theoretical_friction` of a part of the samples, which needs no array of their length."""
        return lambda part: self.theoretical_friction(samples[part])

    def theory_at(self, velocity_m_s: Floats, gauge_pressure_Pa: float, temperature_degC: float) -> Floats:
        """Return d(v; p, T) times `theory_scale` at one pressure and temperature, (n,), N; zeros without a theory."""
        if self.theory is None or not self.shape[THEORY_TAPS]:
            return np.zeros(velocity_m_s.size)
        pressure = np.full(velocity_m_s.size, gauge_pressure_Pa)
        temperature = np.full(velocity_m_s.size, temperature_degC)
        return self.theory_scale * self.theory.evaluate(velocity_m_s, pressure, temperature)

    def extension_columns(self, samples: Samples, theory_N: Floats) -> Floats:
        """Return the extension terms' values for the next samples, (n, columns), N; each sample is asked for once."""
        if self.extension is None:
            return np.zeros((len(samples), 0))
        return self.extension.columns(samples, theory_N)

    def inputs(self, samples: Samples, theory_N: Floats | None = None, columns_N: Floats | None = None) -> Inputs:
        """Return what the compiled loop takes for these samples.

        Parameters
        ----------
        theory_N, columns_N : (n,) and (n, columns), `theoretical_friction` and `extension_columns` where known.
        """
        index, value, cell = self.basis.located(samples.velocity_m_s)
        theory = self.theoretical_friction(samples) if theory_N is None else theory_N
        beside = self.extension_columns(samples, theory) if columns_N is None else columns_N
        unit = self.unit_N
        beside = beside / unit
        if self.load.size:
            beside = np.concatenate([self.load.columns(samples), beside], axis=1)
        return Inputs(
            index=index,
            value=value,
            theory=theory / unit,
            extension=np.ascontiguousarray(beside),
            noise=self.load.noise(samples),
            doubt=self.load.doubt(samples),
            known=self.load.known_N(samples)[:, None] / unit if self.load.follows else np.zeros((len(samples), 0)),
            target=samples.friction_N / unit,
            restart=samples.restart,
            inside=self.basis.inside(samples.velocity_m_s),
            cell=cell,
            beyond=self.beyond(samples.velocity_m_s),
        )

    def beyond(self, velocity_m_s: Floats) -> Floats:
        """Return how far velocities lie outside the range, over the speed of its faster edge, (n,); 0 inside."""
        low, high = self.basis.reach
        outside = np.maximum(low - velocity_m_s, velocity_m_s - high)
        return np.asarray(np.maximum(outside, 0.0) / max(abs(low), abs(high)))

    def static_map(self, theta: Floats, velocity_m_s: Floats) -> Floats:
        """Return g(v) times the static gain of H, (n,), N: the friction that g adds at constant velocity."""
        parts = self.split(theta)
        index, value = self.basis.rows(velocity_m_s)
        g = np.sum(parts.wavelet_weights[index] * value, axis=1)
        return np.asarray(self.unit_N * parts.fir_taps.sum() * g)

    def steady_state(self, theta: Floats, velocity_m_s: Floats, theory_N: Floats) -> tuple[Floats, Floats]:
        """Return the friction at constant velocity, and its gradient with respect to theta.

        f(v) = sum(A) g(v) + sum(A1) d(v). Load and extension are left out: they have no value at a velocity alone.

        Parameters
        ----------
        theta : (n,). velocity_m_s, theory_N : (m,), theory_N as `theoretical_friction` gives it.

        Returns
        -------
        (m,) in N, and (m, n) in normalised units.
        """
        parts = self.split(theta)
        index, value = self.basis.rows(velocity_m_s)
        g = np.sum(parts.wavelet_weights[index] * value, axis=1)
        theory = theory_N / self.unit_N
        friction = parts.fir_taps.sum() * g + parts.theory_taps.sum() * theory
        a, b, c, _ = self._edges
        gradient = np.zeros((velocity_m_s.size, self.size))
        gradient[:, :a] = g[:, None]
        np.put_along_axis(gradient[:, a:b], index.astype(np.int64), parts.fir_taps.sum() * value, axis=1)
        gradient[:, b:c] = theory[:, None]
        return np.asarray(self.unit_N * friction), gradient
