"""The posterior of a record: derivatives, minimum, what a record is worth; and that rls comes to the same."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from synthetic import MODELS, RATE, config_for, known_system, noisy, samples_of, sine

from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.fit.posterior import Posterior, settle
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import recovery
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

SMALL = {"fir__order": 3, "basis__finest_level": 1, "basis__coarsest_level": 2}


def swept(count: int = 3000, seed: int = 7, top: float = 0.025) -> np.ndarray:
    """A velocity that wanders over the whole range."""
    steps = np.random.default_rng(seed).standard_normal(count + 40)
    return top * np.tanh(1.5 * np.convolve(steps, np.ones(16) / 4.0, "valid")[:count])


def record(model_type: str, velocity: np.ndarray, noise: float = 0.01) -> Samples:
    return samples_of(velocity, noisy(known_system(model_type, velocity), noise))


def posterior_of(model_type: str, samples: Samples, effective: float | None = None, **changes: object) -> Posterior:
    model = Model(config_for(samples, model__type=model_type, **SMALL | changes))
    moments = gather(model, samples, ridge=0.0)
    return Posterior(moments, Prior.of(model), effective or float(moments.count))


def drawn(prior: Prior, seed: int) -> np.ndarray:
    return prior.mean + prior.root @ np.random.default_rng(seed).standard_normal(prior.mean.size)


def least_and_largest(covariance: np.ndarray, prior: np.ndarray) -> tuple[float, float]:
    """Eigenvalues of a covariance in deviations of the prior's: within (0, 1] where it is no larger than that."""
    root = np.linalg.cholesky(prior)
    half = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values = np.linalg.eigvalsh(0.5 * (half + half.T))
    return float(values[0]), float(values[-1])


@pytest.mark.parametrize("model_type", MODELS)
def test_derivatives_agree_with_differences(model_type):
    posterior = posterior_of(model_type, record(model_type, swept()))
    theta = drawn(posterior.prior, 1)
    gradient, hessian = posterior.gradient(theta), posterior.hessian(theta)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9, atol=1e-9 * np.abs(hessian).max())
    for direction in np.random.default_rng(2).standard_normal((6, theta.size)):
        step = 1e-4 * direction / np.linalg.norm(direction)
        slope = (posterior.cost(theta + step) - posterior.cost(theta - step)) / 2.0
        assert slope == pytest.approx(gradient @ step, rel=1e-5)
        bend = (posterior.gradient(theta + step) - posterior.gradient(theta - step)) / 2.0
        np.testing.assert_allclose(bend, hessian @ step, rtol=1e-4, atol=1e-4 * np.abs(bend).max())


@pytest.mark.parametrize("model_type", MODELS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), effective=st.sampled_from([1.0, 30.0, 3000.0, 1e6]))
@example(seed=45, effective=1e6)  # rounding hides the lower cost of the last step
def test_the_minimum_is_stationary_and_never_above_its_start(model_type, seed, effective):
    posterior = posterior_of(model_type, record(model_type, swept(600)), effective)
    taps = drawn(posterior.prior, seed)[: posterior.moments.taps]
    theta = posterior.minimum(taps)
    assert posterior.cost(theta) <= posterior.cost(posterior.eliminate(taps)) * (1.0 + 1e-12)
    slope = posterior.prior.root.T @ posterior.gradient(theta)
    assert np.abs(slope).max() < 1e-3


@pytest.mark.parametrize("model_type", MODELS)
def test_elimination_leaves_no_slope_in_what_is_linear(model_type):
    posterior = posterior_of(model_type, record(model_type, swept(600)))
    q = posterior.moments.taps
    theta = posterior.eliminate(drawn(posterior.prior, 3)[:q])
    assert np.abs(posterior.prior.root[q:, q:].T @ posterior.gradient(theta)[q:]).max() < 1e-6


@pytest.mark.parametrize("model_type", MODELS)
def test_covariance_is_positive_definite_and_no_larger_than_the_priors(model_type):
    posterior = posterior_of(model_type, record(model_type, swept()))
    covariance = posterior.covariance(posterior.minimum(posterior.prior.mean[: posterior.moments.taps]))
    np.testing.assert_array_equal(covariance, covariance.T)
    least, largest = least_and_largest(covariance, posterior.prior.covariance)
    assert 0.0 < least < 0.1
    assert largest <= 1.0 + 1e-9


def test_without_a_sample_worth_anything_the_prior_stays():
    posterior = posterior_of("parallel", record("parallel", swept()), 1e-9)
    theta = posterior.minimum(posterior.prior.mean[: posterior.moments.taps])
    np.testing.assert_allclose(theta, posterior.prior.mean, atol=1e-8)
    np.testing.assert_allclose(posterior.covariance(theta), posterior.prior.covariance, rtol=1e-6, atol=1e-8)
    assert posterior.degrees_of_freedom(theta) == pytest.approx(0.0, abs=1e-6)


def test_what_the_record_determines_is_at_most_all_parameters():
    posterior = posterior_of("parallel", record("parallel", swept()), 1e9)
    theta = posterior.minimum(posterior.prior.mean[: posterior.moments.taps])
    assert 3.0 < posterior.degrees_of_freedom(theta) <= theta.size


@pytest.mark.parametrize("model_type", MODELS)
def test_many_cycles_of_one_sine_say_no_more_than_some(model_type):
    """They repeat the same misfit: the number of samples that count stops growing, and the estimate stays."""
    fits = {}
    for cycles in (24, 96):
        samples = record(model_type, sine(cycles, period_s=1.0, stroke_m=0.004), noise=0.0)
        config = config_for(samples, model__type=model_type, rls__forgetting_factor=0.99)
        fits[cycles] = fit_batch(samples, config)
    worth = {cycles: fit.posterior.effective for cycles, fit in fits.items()}
    assert worth[96] < 0.2 * 96 * RATE
    assert worth[96] == pytest.approx(worth[24], rel=0.05)
    theta = {cycles: fit.parameters.theta for cycles, fit in fits.items()}
    deviation = np.sqrt(np.diag(fits[96].covariance))
    assert np.abs((theta[96] - theta[24]) / deviation).max() < 0.1


def test_every_sample_counts_where_nothing_is_forgotten():
    samples = record("parallel", sine(3, period_s=1.0, stroke_m=0.004))
    fit = fit_batch(samples, config_for(samples, rls__forgetting_factor=1.0))
    assert fit.posterior.effective == fit.posterior.moments.count == len(samples) - 8


def test_at_the_worth_that_is_found_the_mean_leverage_is_the_least():
    samples = record("parallel", sine(16, period_s=1.0, stroke_m=0.004))
    config = config_for(samples)
    model = Model(config)
    posterior, theta = settle(gather(model, samples, ridge=0.0), Prior.of(model), 0.01, np.eye(9)[0])
    mean_leverage = posterior.degrees_of_freedom(theta) / posterior.effective
    assert mean_leverage == pytest.approx(0.01, rel=0.05)


def cautious(model_type: str, samples: Samples, **changes: object) -> Config:
    """All samples count, no error is an outlier: what rls and the batch fit share."""
    return config_for(samples, model__type=model_type, rls__forgetting_factor=1.0, **changes)


@pytest.mark.parametrize("model_type", MODELS)
def test_rls_is_the_batch_posterior_where_the_model_is_linear(model_type):
    """Taps behind g that cannot move leave a linear model: recursion and batch are the same arithmetic."""
    samples = record(model_type, swept())
    # So large a residual that neither finds its errors larger: how much a sample is worth is the same throughout.
    tight = {"prior__tap_deviation": 1e-6, "prior__gain_deviation": 1e-6, "prior__residual_deviation": 1.0}
    config = cautious(model_type, samples, **tight, **SMALL)
    estimator = Estimator(config)
    estimator.run(samples)
    assert estimator.health.clipped == estimator.health.guarded == 0
    fit = fit_batch(samples, config)
    deviation = np.sqrt(np.diag(fit.covariance))
    assert np.abs((estimator.parameters.theta - fit.parameters.theta) / deviation).max() < 1e-3
    np.testing.assert_allclose(
        estimator.covariance / np.outer(deviation, deviation),
        fit.covariance / np.outer(deviation, deviation),
        atol=1e-3,
    )
    # What rls says it leaves, from errors that were made before it had learned, is what the fit leaves.
    left = 2.0 * fit.posterior.prior.residual_variance * fit.posterior.cost(fit.parameters.theta)
    assert estimator.work.residual[recovery.PRESENT] == pytest.approx(left / fit.posterior.moments.count, rel=1e-3)


@pytest.mark.parametrize("model_type", MODELS)
def test_rls_comes_to_the_batch_posterior_where_it_is_bilinear(model_type):
    """Linearised at each sample where the batch fit iterates, it ends within two standard deviations all the same."""
    samples = record(model_type, swept(12000))
    config = cautious(model_type, samples)
    estimator = Estimator(config)
    estimator.run(samples)
    fit = fit_batch(samples, config)
    velocity = np.linspace(-0.02, 0.02, 101)
    theory = estimator.model.theory_at(velocity, config.theory.default_pressure, config.theory.default_temperature)
    ours, _ = estimator.model.steady_state(estimator.parameters.theta, velocity, theory)
    theirs, gradient = fit.model.steady_state(fit.parameters.theta, velocity, theory)
    deviation = fit.model.unit_N * np.sqrt(np.einsum("ij,jk,ik->i", gradient, fit.covariance, gradient))
    assert (np.abs(ours - theirs) / deviation).max() < 2.0


@pytest.mark.parametrize("model_type", MODELS)
def test_after_very_many_cycles_rls_is_at_the_posterior_and_not_at_the_free_fit(model_type):
    """The prior is never spent: samples that replace others let it count again."""
    samples = record(model_type, sine(240, period_s=1.0, stroke_m=0.004))
    # Stiff taps: a model that is nearly linear has one minimum, and way and end can be told apart.
    config = config_for(samples, model__type=model_type, prior__tap_deviation=0.03, **SMALL)
    estimator, unpulled = Estimator(config), Estimator(config)
    unpulled.work.information[:] = 0.0  # the prior in the covariance only
    for each in (estimator, unpulled):
        each.run(samples)
    fit = fit_batch(samples, config)
    prior = fit.posterior.prior
    free = Posterior(fit.posterior.moments, prior, 1e9).minimum(fit.parameters.fir_taps)

    def distance(theta):
        return float(np.linalg.norm(np.linalg.solve(prior.root, theta - fit.parameters.theta)))

    assert distance(estimator.parameters.theta) < 0.5 * distance(unpulled.parameters.theta)
    assert distance(estimator.parameters.theta) < 0.1 * distance(free)
