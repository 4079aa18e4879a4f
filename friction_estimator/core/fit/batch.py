"""The batch reference: the best that a model structure can do on a record, the yardstick of every online law.

1. Global start: least squares for the over-parameterised coefficients, with a ridge, and the rank-one matrix nearest to
   A W' in the norm of the outputs (Bai 1998).
2. Refinement: for fixed A the rest is linear and is eliminated (variable projection, Golub and Pereyra 1973); the cost
   that is left depends on the few taps only and is minimised by a trust-region Newton method with its exact Hessian.
3. Several starts, since the cost of a bilinear model is no quadratic: the best end is taken, and all are reported.

The scale orbit (c A, W / c) is closed by |A| = 1, the sign by a positive static gain of H.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from friction_estimator.core.fit.moments import RIDGE, Moments, gather, solve
from friction_estimator.core.fit.variable_projection import refine
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.prediction import delay_lines, predict_fixed
from friction_estimator.core.model.structure import CHUNK, Extension, Model, Parameters
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config

RANDOM_STARTS = 3
"""Starts at random taps beside the constructed ones."""

START_RIDGES = (1.0, 1e2, 1e4)
"""Multiples of the ridge under which the over-parameterised problem is solved: its many coefficients need more."""

ROUNDING = 1e-6
"""Singular values below this share of the largest are not told from zero: they are roots of rounded moments."""


@dataclass(frozen=True)
class BatchFit:
    """Result of `fit_batch`.

    Attributes
    ----------
    model : the structure.
    moments : what the record was reduced to.
    parameters : the estimate, |A| = 1 and sum(A) >= 0, in normalised units.
    predicted_N : (n,), output of the fitted model at every sample, N.
    nrmse : rms error over std of friction, over the samples that were fitted.
    residual_rms_N : rms error over the same samples with the degrees of freedom taken off, N.
    start_costs : cost at the end of each start, sorted; more than one value means several stationary points.
    """

    model: Model
    moments: Moments
    parameters: Parameters
    predicted_N: Floats
    nrmse: float
    residual_rms_N: float
    start_costs: tuple[float, ...]

    @cached_property
    def _spectrum(self) -> tuple[Floats, Floats]:
        """Singular values, descending, and directions (n, n) of the output's sensitivity to prior-scaled parameters."""
        deviation = self.model.prior_deviation()
        sensitivity = self.moments.gauss_newton(self.parameters.theta, ridge=False) * np.outer(deviation, deviation)
        squared, directions = np.linalg.eigh(sensitivity)
        return np.sqrt(np.maximum(squared[::-1], 0.0)), directions[:, ::-1]

    @property
    def singular_values(self) -> Floats:
        """Rms change of the output for one prior deviation along each direction, descending, (n,), normalised units."""
        return self._spectrum[0]

    @property
    def threshold(self) -> float:
        """Singular value above which a direction counts as identifiable.

        The standard error along a direction of singular value s is sigma / (s sqrt(n)) prior deviations, with sigma the
        residual's rms; below one prior deviation the record says more than the prior did: s > sigma / sqrt(n). Values
        under `ROUNDING` of the largest do not count.
        """
        noise = self.residual_rms_N / self.model.config.force_unit / np.sqrt(self.moments.count)
        return max(float(noise), ROUNDING * float(self.singular_values[0]))

    @property
    def identifiable_rank(self) -> int:
        """Number of directions in parameter space that the record determines (the scale orbit is never one)."""
        return int(np.count_nonzero(self.singular_values > self.threshold))

    @cached_property
    def identifiable_directions(self) -> Floats:
        """Orthonormal basis of the identifiable subspace in prior-scaled parameters, (n, rank)."""
        return self._spectrum[1][:, : self.identifiable_rank]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of theta = [A, W, A1, C] in the identifiable subspace, on the gauge |A| = 1, (n, n).

            P = sigma^2 / n  T (D V S^-2 V' D) T',   T = I - z c' / (c' z)

        D prior deviations, V and S directions and singular values above the threshold; T moves along the scale orbit
        z = [A, -W] onto the gauge, c its gradient. Valid for white residuals; outside the subspace the record says
        nothing, and P is zero there because the estimate is held.
        """
        theta = self.parameters.theta
        taps, weights = self.moments.taps, self.moments.weights
        rank = self.identifiable_rank
        scaled = self.model.prior_deviation()[:, None] * self.identifiable_directions / self.singular_values[:rank]
        orbit, gauge = np.zeros(theta.size), np.zeros(theta.size)
        orbit[:taps], orbit[taps : taps + weights] = theta[:taps], -theta[taps : taps + weights]
        gauge[:taps] = theta[:taps]
        scaled = scaled - np.outer(orbit, gauge @ scaled) / float(gauge @ orbit)
        sigma = self.residual_rms_N / self.model.config.force_unit
        return np.asarray(sigma**2 / self.moments.count * (scaled @ scaled.T))


def fit_batch(
    samples: Samples,
    config: Config,
    extension: Extension | None = None,
    use: Bools | bool = True,
    ridge: float = RIDGE,
    seed: int = 0,
) -> BatchFit:
    """Fit the model of `config` to a whole record.

    Parameters
    ----------
    samples : admitted samples.
    config : with units set (see `derive.with_recorded_units`); learned values in it are not used.
    extension : terms that a diagnosis added.
    use : (n,) or one value, the samples to fit; the rest is predicted only.
    ridge : penalty on one prior deviation in squared normalised units; keeps what is not excited at zero.
    seed : of the random starts.

    Raises
    ------
    UnanswerableError : nothing to fit. ConfigError : the structure is too large, or units are missing.

    Examples
    --------
    >>> k = np.arange(4000)
    >>> v = 0.1 * np.sin(k / 90) * np.sin(k / 7)
    >>> f = np.tanh(v / 0.03)
    >>> record = Samples(k, v, 0.8 * f + 0.2 * np.append(f[:1], f[:-1]), k == 0)
    >>> config = Config.from_mapping(
    ...     {"model.type": "hammerstein", "basis.velocity_range": [-0.1, 0.1], "force_unit": 1.0}
    ... )
    >>> fit = fit_batch(record, config)
    >>> fit.nrmse < 1e-3
    True
    >>> np.round(fit.parameters.fir_taps[:2] / fit.parameters.fir_taps.sum(), 2)
    array([0.8, 0.2])
    """
    model = Model(config, extension)
    moments = gather(model, samples, use, ridge)
    ends = sorted(
        (refine(moments, taps) for taps in start_taps(moments, np.random.default_rng(seed))), key=moments.cost
    )
    theta = on_gauge(moments, ends[0])
    parameters = model.split(theta)
    predicted = predict(samples, config, parameters, extension)
    used = np.broadcast_to(np.asarray(use, np.bool_), (len(samples),)) & model.basis.inside(samples.velocity_m_s)
    error = (samples.friction_N - predicted)[used]
    fit = BatchFit(
        model=model,
        moments=moments,
        parameters=parameters,
        predicted_N=predicted,
        nrmse=nrmse(samples.friction_N[used], predicted[used]),
        residual_rms_N=float(np.sqrt(np.mean(np.square(error)))),
        start_costs=tuple(moments.cost(end) for end in ends),
    )
    freedom = max(1, moments.count - fit.identifiable_rank)
    return replace(fit, residual_rms_N=fit.residual_rms_N * float(np.sqrt(moments.count / freedom)))


def predict(samples: Samples, config: Config, parameters: Parameters, extension: Extension | None = None) -> Floats:
    """Return the output of fixed parameters over a record, (n,), N; the extension's delay lines start afresh."""
    model = Model(config, extension)
    theta = model.checked(parameters)
    if extension is not None:
        extension.restart()
    predicted, lines = np.empty(len(samples)), delay_lines(model.shape)
    for start in range(0, len(samples), CHUNK):
        part = slice(start, start + CHUNK)
        inputs = model.inputs(samples[part])
        arrays = (inputs.index, inputs.value, inputs.theory, inputs.extension, inputs.restart)
        predict_fixed(*arrays, predicted[part], model.shape, theta, *lines)
    predicted *= config.force_unit
    return predicted


def start_taps(moments: Moments, generator: np.random.Generator) -> list[Floats]:
    """Return starts for A: rank-one factors of the over-parameterised solution, no dynamics, and random ones."""
    memoryless = np.zeros(moments.taps)
    memoryless[0] = 1.0
    starts = [memoryless]
    if moments.taps == 1:
        return starts
    stride = (moments.gram.shape[0] - moments.extensions) // moments.taps
    output = moments.gram[: moments.weights, : moments.weights]  # E[Psi Psi']: |w|^2 in it is the power of g
    for factor in START_RIDGES:
        penalised = moments.gram + np.diag((factor - 1.0) * moments.ridge)
        lagged = solve(penalised, moments.cross)[: moments.taps * stride].reshape(moments.taps, stride)
        free = lagged[:, : moments.weights]
        _, vectors = eigh(free @ output @ free.T)
        starts.append(vectors[:, -1])
    return starts + list(generator.standard_normal((RANDOM_STARTS, moments.taps)))


def on_gauge(moments: Moments, theta: Floats) -> Floats:
    """Return the point of theta's orbit with |A| = 1 and sum(A) >= 0 (the largest tap positive where the sum is 0)."""
    theta = theta.copy()
    taps = theta[: moments.taps]
    length = float(np.linalg.norm(taps))
    if length > 0.0:
        gain = float(taps.sum())
        decisive = gain if abs(gain) > 1e-6 * length else float(taps[np.argmax(np.abs(taps))])
        factor = float(np.copysign(length, decisive))
        theta[: moments.taps] /= factor
        theta[moments.taps : moments.taps + moments.weights] *= factor
    return theta
