"""What is believed of a model before any sample: one Gaussian, shared by rls, the batch fit and nlms' metric.

    A  ~ N(e0, S),  A1 ~ N(e0, S1),   S_ij = deviation^2 decay^max(i, j)          (TC kernel: Chen, Ohlsson, Ljung 2012)
    W  ~ N(0, diag(d_m^2)) given g(0) ~ 0,   d_m = deviation 2^(slope (m - M))
    C  ~ N(0, 1)

with e0 = [1, 0, ..]: H and H1 pass their input through, impulse responses die out smoothly (Pillonetto and De Nicolao
2010), g is smooth, and where nothing was seen nothing is learned. `rest_deviation` says how exactly g vanishes at
standstill: a film that lags bends the curve there, and on a drive that rests half of the time such an offset would be
the whole error.

The misfit of a model repeats with the drive and is no white noise, so `residual_deviation` is several times what is
left over: a thousand samples of one sine say little more than a hundred (docs/decisions/0003-one-prior.md).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Floats

LEAST_REST = 1e-9
"""Least share of the variance of g at standstill that `rest_deviation` leaves: below, rounding would make the
covariance indefinite."""


@dataclass(frozen=True)
class Prior:
    """Gaussian over theta = [A, W, A1, C] in normalised units.

    Attributes
    ----------
    mean : (n,).
    covariance : (n, n), symmetric positive definite.
    residual_variance : variance rho that one sample is taken to err with, in squared force units.
    """

    mean: Floats
    covariance: Floats
    residual_variance: float

    @classmethod
    def of(cls, model: Model) -> "Prior":
        """Return the prior of a structure, from `prior.*` of its configuration."""
        settings = model.config.prior
        taps, weights, theory_taps, extensions = (int(v) for v in model.shape)
        mean = np.zeros(model.size)
        mean[0] = 1.0
        if theory_taps:
            mean[taps + weights] = 1.0
        deviation = settings.weight_deviation * model.basis.prior_scale(settings.weight_slope)
        rest = model.basis.rows(np.zeros(1))
        at_rest = np.zeros(weights)
        at_rest[rest[0][0]] = rest[1][0]
        # Conditioned on g(0) = at_rest' W = 0 with variance rest_deviation^2: one scalar update.
        along = deviation**2 * at_rest
        open_power = float(at_rest @ along)
        power = open_power + max(settings.rest_deviation**2, LEAST_REST * open_power)
        inside = model.basis.reach[0] <= 0.0 <= model.basis.reach[1]
        nonlinear = np.diag(deviation**2) - (np.outer(along, along) / power if inside else 0.0)
        covariance = block_diag(
            decaying(taps, settings.tap_deviation, settings.tap_decay),
            nonlinear,
            decaying(theory_taps, settings.theory_tap_deviation, settings.tap_decay),
            np.eye(extensions),
        )
        return cls(mean, np.asarray(covariance, np.float64), settings.residual_deviation**2)

    @cached_property
    def root(self) -> Floats:
        """Lower triangular square root of the covariance, (n, n)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @cached_property
    def information(self) -> Floats:
        """Inverse of the covariance, (n, n)."""
        inverse = np.linalg.solve(self.root, np.eye(self.mean.size))
        return np.asarray(inverse.T @ inverse)

    @property
    def deviation(self) -> Floats:
        """Prior standard deviation of each parameter, (n,)."""
        return np.sqrt(np.diag(self.covariance))


def decaying(taps: int, deviation: float, decay: float) -> Floats:
    """Return the TC kernel deviation^2 decay^max(i, j), (taps, taps).

    >>> decaying(2, 1.0, 0.5)
    array([[1. , 0.5],
           [0.5, 0.5]])
    """
    lag = np.arange(taps)
    return np.asarray(deviation**2 * decay ** np.maximum.outer(lag, lag).astype(np.float64))
