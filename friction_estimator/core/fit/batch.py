"""The batch reference: the parameters of greatest posterior probability given a whole record (see `posterior`).

It shares the prior with rls, and the bound on what a record is worth; so it is what rls comes to when it is done, and
the yardstick of every online law.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.fit.band import Curve, errors_by_cell, median_conditions, static_curve
from friction_estimator.core.fit.load_report import LearnedLoad, learned_loads
from friction_estimator.core.fit.moments import fitted, gather
from friction_estimator.core.fit.posterior import Posterior, settle
from friction_estimator.core.memory import give_back
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.load import DOUBTFUL
from friction_estimator.core.model.prediction import delay_lines, predict_fixed
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import CHUNK, Extension, Model, Parameters
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.config import Config

LOAD_ROUNDS = 3
"""Fits, each with the load of the one before, where friction follows the load."""

RANDOM_STARTS = 2
"""Starts at taps drawn from the prior beside its mean."""


@dataclass(frozen=True)
class BatchFit:
    """Result of `fit_batch`.

    Attributes
    ----------
    model : the structure.
    posterior : what record and prior say of the parameters.
    parameters : the estimate, in normalised units.
    predicted_N : (n,), output of the fitted model at every sample, N.
    nrmse : rms error over std of friction, over the samples that were fitted.
    residual_rms_N : rms error over the same samples with the degrees of freedom taken off, N.
    start_costs : cost at the end of each start, sorted; more than one value means several stationary points.
    errors : (cells, 3), table of running errors of the fitted samples (see `band`).
    """

    model: Model
    posterior: Posterior
    parameters: Parameters
    predicted_N: Floats
    nrmse: float
    residual_rms_N: float
    start_costs: tuple[float, ...]
    errors: Floats

    @cached_property
    def covariance(self) -> Floats:
        """Posterior covariance of theta = [A, W, A1, C], (n, n), normalised units."""
        return self.posterior.covariance(self.parameters.theta)

    @cached_property
    def singular_values(self) -> Floats:
        """Prior over posterior deviation, less one in power, along each direction, descending, (n,).

        Of n / rho E[x x'] in prior deviations: a direction of singular value s has the posterior variance
        1 / (1 + s^2) of the prior's.
        """
        root = self.posterior.prior.root
        from_data = self.posterior.weight * self.posterior.moments.gauss_newton(self.parameters.theta, ridge=False)
        squared = np.linalg.eigvalsh(root.T @ from_data @ root)
        return np.asarray(np.sqrt(np.maximum(squared[::-1], 0.0)))

    @property
    def threshold(self) -> float:
        """Singular value above which a direction counts as identifiable: the record says more of it than the prior."""
        return 1.0

    @property
    def identifiable_rank(self) -> int:
        """Number of directions in parameter space that the record determines (the scale orbit is never one)."""
        return int(np.count_nonzero(self.singular_values > self.threshold))

    @property
    def loads(self) -> list[LearnedLoad]:
        """What the fit says of the unknown load terms."""
        if not self.model.load.size:
            return []
        misfit = self.residual_rms_N / self.model.unit_N
        return learned_loads(self.model, self.parameters.theta, self.covariance, self.posterior.weight, misfit)

    def curve(self, samples: Samples | None = None, velocity_m_s: Floats | None = None) -> Curve:
        """Return the static curve with its band at the median pressure and temperature of `samples`."""
        conditions = median_conditions(self.model, samples)
        prior, theta = self.posterior.prior, self.parameters.theta
        covariance = self.covariance

        def spread(gradient: Floats) -> Floats:
            return np.asarray(np.sum((gradient @ covariance) * gradient, axis=1))

        return static_curve(self.model, theta, self.errors, spread, prior, conditions, velocity_m_s)


def fit_batch(
    samples: Samples,
    config: Config,
    extension: Extension | None = None,
    use: Bools | bool = True,
    seed: int = 0,
) -> BatchFit:
    """Fit the model of `config` to a whole record.

    Parameters
    ----------
    samples : admitted samples.
    config : with units known (see `settings.units`); learned parameters in it are not used.
    extension : terms that a diagnosis added.
    use : (n,) or one value, the samples to fit; the rest is predicted only.
    seed : of the random starts.

    Raises
    ------
    UnanswerableError : nothing to fit. ConfigError : the structure is too large, or units are missing.

    Examples
    --------
    >>> k = np.arange(4000)
    >>> v = 0.1 * np.sin(k / 90) * np.sin(k / 7)
    >>> f = np.tanh(v / 0.03)
    >>> record = Samples(k, v, 0.95 * f + 0.05 * np.append(f[:1], f[:-1]), k == 0)
    >>> config = Config.from_mapping(
    ...     {"model.type": "hammerstein", "basis.velocity_range": [-0.1, 0.1], "force_unit": 1.0}
    ... )
    >>> fit = fit_batch(record, config)
    >>> fit.nrmse < 0.01
    True
    """
    model = Model(config, extension)
    prior = Prior.of(model)
    taps = int(model.shape[0])
    draws = np.random.default_rng(seed).standard_normal((RANDOM_STARTS, taps))
    starts = [prior.mean[:taps], *(prior.mean[:taps] + prior.root[:taps, :taps] @ draw for draw in draws)]
    given = model, prior, samples, 1.0 - config.rls.forgetting_factor, starts
    doubt = samples.acceleration_doubt
    if doubt is not None and doubt.any() and fitted(model, samples, use & (doubt == 0.0)).any():
        posterior, ends = _least(*given, use & (doubt == 0.0))
        use = use & _told(posterior, posterior.compensated(ends[0]), model, samples)
    use = fitted(model, samples, use)
    posterior, ends = _least(*given, use)
    theta = posterior.compensated(ends[0])
    parameters = model.split(theta)
    give_back()  # the predictions are as long as the record
    predicted = predict(samples, config, parameters, extension)
    measured = samples.friction_N

    def error(part: slice) -> Floats:
        return measured[part] - predicted[part]

    squares = (np.square(error(part)[use[part]]) for part in sums.parts(len(samples)))
    freedom = max(1.0, posterior.moments.count - posterior.degrees_of_freedom(theta))
    return BatchFit(
        model=model,
        posterior=posterior,
        parameters=parameters,
        predicted_N=predicted,
        nrmse=nrmse(measured, predicted, use),
        residual_rms_N=float(np.sqrt(sums.total(squares, int(np.count_nonzero(use))) / freedom)),
        start_costs=tuple(posterior.cost(end) for end in ends),
        errors=errors_by_cell(
            model.basis, samples.velocity_m_s, lambda part: error(part) / model.unit_N, use, samples.restart
        ),
    )


def _least(
    model: Model, prior: Prior, samples: Samples, least_leverage: float, starts: list[Floats], use: Bools | bool
) -> tuple[Posterior, list[Floats]]:
    """Return the posterior of the samples in `use` and its stationary points, the most probable first."""
    load_weights = model.split(prior.mean).load_weights
    for _ in range(LOAD_ROUNDS if model.load.follows else 1):
        moments = gather(model, samples, use, ridge=0.0, load_weights=load_weights)
        posterior, first = settle(moments, prior, least_leverage, starts[0])
        ends = sorted([first, *(posterior.minimum(start) for start in starts[1:])], key=posterior.cost)
        load_weights = model.split(posterior.compensated(ends[0])).load_weights
    return posterior, ends


def _told(posterior: Posterior, theta: Floats, model: Model, samples: Samples) -> Bools:
    """Return which samples the doubt about their acceleration leaves something to tell, (n,).

    The usual error power is that of a fit to samples without any doubt.
    """
    most = DOUBTFUL * 2.0 * posterior.moments.cost(theta)
    factors = np.append(np.square(model.split(theta).load_weights), 1.0)
    told = np.ones(len(samples), np.bool_)
    for part in sums.parts(len(samples)):
        doubt = model.load.doubt(samples[part])
        if doubt.size:
            told[part] = doubt @ factors <= most
    return told


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
        load = (inputs.extension, inputs.known, model.load.size - 1)
        arrays = (inputs.index, inputs.value, inputs.theory, *load, inputs.restart)
        predict_fixed(*arrays, predicted[part], model.shape, theta, *lines)
    predicted *= model.unit_N
    return predicted
