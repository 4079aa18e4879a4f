"""The two models: what their parameters are and what a sample means to them.

    hammerstein   f = H(q) g(v)
    parallel      f = H1(q) d(v; p, T) + H(q) g(v)

g is a sum over a wavelet basis, H and H1 are FIR filters, d is the theoretical steady-state curve (Kwak, Yagle, Levitt
1998, section 2). Inside, forces are in units of `force_unit` and velocities in units of `basis.velocity_unit`, so one
set of step sizes serves a 5 N seal and a 5 kN cylinder.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.basis import Basis, basis_from_config
from friction_estimator.core.model.theory import TheoryCurve, theory_from_config
from friction_estimator.core.sample import Bools, Floats, Ints, Samples
from friction_estimator.core.settings.config import Config

LARGEST_PARAMETER = 1e6
"""Guard: the norm of the normalised parameters stays below this."""

CHUNK = 4096
"""Samples prepared at a time: bounds the memory of a pass over a recording."""

TAP_DEVIATION = {"hammerstein": 0.1, "parallel": 0.03}
"""Prior standard deviation of the taps behind g, relative to that of a weight of the coarsest level.

In the parallel model g starts near zero and says nothing about the taps behind it: a loose prior would let noise move
them (docs/decisions/0003-priors-of-rls.md has the figures).
"""

THEORY_TAP_DEVIATION = 0.1
"""The same for the taps behind the theoretical curve."""


class Extension(Protocol):
    """Further terms, linear in their coefficients, that a diagnosis added to the model (effects/ has them)."""

    @property
    def size(self) -> int:
        """Number of columns."""

    def columns(self, samples: Samples, theory_N: Floats) -> Floats:
        """Return the terms' values for the next samples, (n, size), N; keeps its own delay lines."""

    def restart(self) -> None:
        """Forget the delay lines."""


PLAUSIBLE_SCALE = 30.0
"""A theoretical curve further off in scale than this factor, up or down, is used for its shape only."""

SCALE_POINTS = 256


@dataclass(frozen=True)
class Inputs:
    """A batch of samples in normalised units, as the compiled loops take it."""

    index: NDArray[np.int32]
    value: Floats
    theory: Floats
    extension: Floats
    target: Floats
    restart: Bools
    inside: Bools


@dataclass(frozen=True)
class Parameters:
    """Learned values: FIR taps (n_taps,), theory taps (n_taps,) or empty, weights (size,), extension coefficients."""

    fir_taps: Floats
    wavelet_weights: Floats
    theory_taps: Floats
    extension_weights: Floats

    @property
    def theta(self) -> Floats:
        """The parameter vector [A, W, A1, C]."""
        return np.concatenate([self.fir_taps, self.wavelet_weights, self.theory_taps, self.extension_weights])


def theory_scale(config: Config, theory: TheoryCurve | None) -> float:
    """Return the factor on the theoretical curve: 1, or what gives it the rms `force_unit` where it is far off.

    A curve for another machine (forces 1000 times larger, say) would otherwise dominate every regressor.
    """
    if theory is None or not config.basis.velocity_range or not config.force_unit > 0.0:
        return 1.0
    low, high = config.basis.velocity_range
    curve = theory.evaluate(
        low + (high - low) * (np.arange(SCALE_POINTS) + 0.5) / SCALE_POINTS,
        np.full(SCALE_POINTS, config.theory.default_pressure),
        np.full(SCALE_POINTS, config.theory.default_temperature),
    )
    ratio = float(np.sqrt(np.mean(np.square(curve))) / config.force_unit)
    plausible = 1.0 / PLAUSIBLE_SCALE <= ratio <= PLAUSIBLE_SCALE
    return 1.0 if plausible or not ratio > 0.0 else 1.0 / ratio


class Model:
    """Structure of a Hammerstein or parallel model, without its parameters' values.

    Parameters
    ----------
    config : `basis.velocity_range` and `force_unit` must be set (see `derive.with_units`).
    extension : terms that a diagnosis added.

    Raises
    ------
    ConfigError : a unit is missing, or the learned values do not fit the structure.
    """

    def __init__(self, config: Config, extension: Extension | None = None) -> None:
        if not config.force_unit > 0.0:
            raise ConfigError("force_unit is 0: give the expected rms of the friction in N")
        self.config = config
        self.basis: Basis = basis_from_config(config.basis)
        self.theory: TheoryCurve | None = theory_from_config(config)
        self.extension = extension
        taps = config.fir.order + 1
        theory_taps = taps if config.model.type == "parallel" else 0
        columns = extension.size if extension else 0
        self.shape: Ints = np.array([taps, self.basis.size, theory_taps, columns], np.int64)
        self._edges = np.cumsum(self.shape)
        self.theory_scale = theory_scale(config, self.theory)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self._edges[-1])

    def split(self, theta: Floats) -> Parameters:
        """Return the parts of a parameter vector (copies)."""
        a, b, c, _ = self._edges
        return Parameters(theta[:a].copy(), theta[a:b].copy(), theta[b:c].copy(), theta[c:].copy())

    def initial_theta(self) -> Floats:
        """Return the start: H = H1 = 1, g = 0, so that parallel predicts the theory; or the learned values given."""
        start = self.split(np.zeros(self.size))
        start.fir_taps[0] = 1.0
        if start.theory_taps.size:
            start.theory_taps[0] = 1.0
        learned = self.config.learned
        for name in ("fir_taps", "wavelet_weights", "theory_taps", "extension_weights"):
            given, wanted = getattr(learned, name), getattr(start, name)
            if not given or (name == "theory_taps" and not wanted.size):
                continue
            if len(given) != wanted.size:
                raise ConfigError(
                    f"learned.{name} has {len(given)} values and this model has {wanted.size}: "
                    "it was learned with another basis, order or set of terms; leave it empty to start cold"
                )
            wanted[:] = given
            if not np.all(np.abs(wanted) < LARGEST_PARAMETER):
                raise ConfigError(f"learned.{name} is larger than {LARGEST_PARAMETER:g}: no estimator learned that")
        return start.theta

    def checked(self, parameters: Parameters) -> Floats:
        """Return the parameter vector; raises ConfigError where it is not one of this model's."""
        theta = parameters.theta
        if theta.shape != (self.size,):
            raise ConfigError(f"{theta.size} learned values were given, this model has {self.size}")
        if not np.all(np.abs(theta) < LARGEST_PARAMETER):
            raise ConfigError(f"learned values must be finite and below {LARGEST_PARAMETER:g}")
        return theta

    def prior_deviation(self) -> Floats:
        """Return the relative prior standard deviation of each parameter, (n,)."""
        taps, _, theory_taps, columns = self.shape
        return np.concatenate(
            [
                np.full(taps, TAP_DEVIATION[self.config.model.type]),
                self.basis.prior_scale(),
                np.full(theory_taps, THEORY_TAP_DEVIATION),
                np.ones(columns),
            ]
        )

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

    def inputs(self, samples: Samples) -> Inputs:
        """Return what the compiled loop takes for these samples."""
        index, value = self.basis.rows(samples.velocity_m_s)
        theory = self.theoretical_friction(samples)
        extension = np.zeros((len(samples), 0))
        if self.extension is not None:
            extension = self.extension.columns(samples, theory)
        unit = self.config.force_unit
        return Inputs(
            index=index,
            value=value,
            theory=theory / unit,
            extension=np.ascontiguousarray(extension / unit),
            target=samples.friction_N / unit,
            restart=samples.restart,
            inside=self.basis.inside(samples.velocity_m_s),
        )

    def static_map(self, theta: Floats, velocity_m_s: Floats) -> Floats:
        """Return g(v) times the static gain of H, (n,), N: the friction that g adds at constant velocity."""
        parts = self.split(theta)
        index, value = self.basis.rows(velocity_m_s)
        g = np.sum(parts.wavelet_weights[index] * value, axis=1)
        return np.asarray(self.config.force_unit * parts.fir_taps.sum() * g)
