"""The prior: positive definite, g vanishes at standstill, impulse responses die out, theory passes through."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import MODELS, samples_of, sine

from friction_estimator.core.fit.batch import predict
from friction_estimator.core.model import basis as basis_module
from friction_estimator.core.model.prior import Prior, decaying
from friction_estimator.core.model.structure import Model
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.effects.extension import extension_from_config


def model_of(model_type="parallel", **changes):
    values = {"model.type": model_type, "theory.kind": "seal", "basis.velocity_range": [-0.1, 0.1], "force_unit": 2.0}
    return Model(Config.from_mapping(values | {name.replace("__", "."): v for name, v in changes.items()}))


def correlation(covariance):
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return covariance * scale[:, None] * scale


@given(st.integers(1, 65), st.floats(1e-6, 1e3), st.floats(0.01, 0.9999))
def test_impulse_responses_die_out_and_their_kernel_is_positive_definite(taps, deviation, decay):
    kernel = decaying(taps, deviation, decay)
    np.testing.assert_array_equal(kernel, kernel.T)
    np.testing.assert_allclose(np.diag(kernel), deviation**2 * decay ** np.arange(taps), rtol=1e-12)
    # Scaled to unit variances it is that of a stationary first-order process, whose least eigenvalue is known.
    root = np.sqrt(decay)
    assert np.linalg.eigvalsh(correlation(kernel)).min() > 0.9 * (1.0 - root) / (1.0 + root)


def log_uniform(low, high):
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.clip(np.exp(x), low, high)))


ANY_PRIOR = st.fixed_dictionaries(
    {
        name: log_uniform(item.low, item.high) if item.low > 0.0 else st.floats(item.low, item.high)
        for name, item in PARAMETERS.items()
        if name.startswith("prior.")
    }
    | {"fir.order": st.sampled_from([0, 1, 8]), "model.type": st.sampled_from(MODELS)}
)


@settings(max_examples=60, deadline=None)
@given(ANY_PRIOR)
def test_whatever_is_set_the_prior_is_positive_definite_and_its_information_the_inverse(values):
    prior = Prior.of(Model(model_of().config.updated(values)))
    scale = prior.deviation
    assert np.all(scale > 0.0)
    np.testing.assert_array_equal(prior.covariance, prior.covariance.T)
    np.testing.assert_allclose(prior.root @ prior.root.T / np.outer(scale, scale), correlation(prior.covariance))
    np.testing.assert_array_equal(prior.root, np.tril(prior.root))
    np.testing.assert_allclose(prior.root.T @ prior.information @ prior.root, np.eye(scale.size), atol=1e-5)
    assert prior.residual_variance == values["prior.residual_deviation"] ** 2


@pytest.mark.parametrize("model_type", MODELS)
def test_information_is_the_inverse_of_the_default_covariance(model_type):
    prior = Prior.of(model_of(model_type))
    np.testing.assert_allclose(prior.information @ prior.covariance, np.eye(prior.mean.size), atol=1e-7)


@pytest.mark.parametrize("rest", [1e-3, 0.003, 0.1])
def test_at_standstill_g_deviates_by_rest_deviation_and_elsewhere_by_much_more(rest):
    model = model_of(prior__rest_deviation=rest)
    covariance = Prior.of(model).covariance
    weights = slice(int(model.shape[0]), int(model.shape[0] + model.shape[1]))
    psi = model.basis.dense(np.array([0.0, 0.05, -0.05, 0.1]))
    deviation = np.sqrt(np.diag(psi @ covariance[weights, weights] @ psi.T))
    assert deviation[0] == pytest.approx(rest, rel=0.05)
    assert np.all(deviation[1:] > max(3.0 * rest, 0.1))


@pytest.mark.parametrize("reach", [(0.02, 0.1), (-0.1, -0.01)])
def test_a_range_without_standstill_says_nothing_of_it(reach):
    model = model_of(basis__velocity_range=reach)
    covariance = Prior.of(model).covariance
    weights = slice(int(model.shape[0]), int(model.shape[0] + model.shape[1]))
    expected = np.square(model.basis.prior_scale(model.config.prior.weight_slope))
    np.testing.assert_array_equal(covariance[weights, weights], np.diag(expected))


@pytest.mark.parametrize("slope", [0.0, 1.5, 3.0])
def test_deviations_fall_with_the_level_by_the_slope(slope):
    model = model_of(prior__weight_slope=slope, prior__weight_deviation=0.5)
    taps, weights = model.shape[:2]
    deviation = Prior.of(model).deviation[taps : taps + weights]
    expected = 0.5 * 2.0 ** (slope * (model.basis.level_of - model.config.basis.coarsest_level))
    at_rest = model.basis.dense(np.zeros(1))[0] != 0.0
    np.testing.assert_allclose(deviation[~at_rest], expected[~at_rest], rtol=1e-12)
    assert np.all(deviation[at_rest] <= expected[at_rest] * (1 + 1e-12))  # knowing g(0) only takes away


def test_taps_behind_g_have_the_deviations_that_are_set():
    model = model_of("hammerstein", prior__tap_deviation=0.2, prior__tap_decay=0.64, fir__order=2)
    np.testing.assert_allclose(model.split(Prior.of(model).deviation).fir_taps, 0.2 * 0.8 ** np.arange(3))


@given(log_uniform(1e-3, 1e3), log_uniform(1e-3, 1e3), log_uniform(1e-3, 10.0), st.floats(0.5, 0.99))
def test_static_gains_of_the_parallel_model_have_the_deviations_that_are_set(gain, theory_gain, shape, decay):
    """Apart from the shape of the impulse responses: the taps' sum is as uncertain as was asked for."""
    model = model_of(
        prior__gain_deviation=gain,
        prior__theory_gain_deviation=theory_gain,
        prior__tap_deviation=shape,
        prior__tap_decay=decay,
    )
    covariance = Prior.of(model).covariance
    taps, weights = (int(n) for n in model.shape[:2])
    for begin, expected in ((0, gain), (taps + weights, theory_gain)):
        block = covariance[begin : begin + taps, begin : begin + taps]
        rounding = 1e-3 * np.sqrt(np.abs(block).sum())
        assert np.sqrt(block.sum()) == pytest.approx(expected, rel=1e-3, abs=rounding)


@pytest.mark.parametrize("model_type", MODELS)
def test_the_mean_predicts_the_theory_and_nothing_else(model_type):
    model = model_of(model_type)
    velocity = sine(0.3, stroke_m=0.05)
    samples = samples_of(velocity, np.zeros(velocity.size))
    predicted = predict(samples, model.config, model.split(Prior.of(model).mean))
    expected = model.theoretical_friction(samples) if model_type == "parallel" else np.zeros(velocity.size)
    np.testing.assert_allclose(predicted, expected, rtol=1e-12)
    np.testing.assert_array_equal(Prior.of(model).mean, model.initial_theta())


TERMS = ("inertia:part=0,scale=2.0", "sensor_bias:part=0,scale=1.5", "side_spring:centre=0.0")


def of_terms(unit_N, weights):
    """Mean and deviation of the coefficients of two forces and of a constant in a unit of its own."""
    config = Config.from_mapping(
        {
            "theory.kind": "seal",
            "basis.velocity_range": [-0.1, 0.1],
            "force_unit": unit_N,
            "extension.terms": TERMS,
            "learned.extension_weights": weights,
        }
    )
    prior = Prior.of(Model(config, extension_from_config(config)))
    return prior.mean[-3:], prior.deviation[-3:]


@pytest.mark.parametrize("unit_N", [1e-2, 4.0, 5e3])
def test_what_a_diagnosis_measured_of_a_force_is_its_prior_and_its_unit_does_not_matter(unit_N):
    weights = [0.3 * unit_N, 0.0, 7.0]
    mean, deviation = of_terms(unit_N, weights)
    np.testing.assert_allclose(mean, weights)
    np.testing.assert_allclose(deviation, [3.0 * 0.3 * unit_N, 20.0 * unit_N, 100.0])
    mean, deviation = of_terms(unit_N, [])
    np.testing.assert_array_equal(mean, 0.0)
    np.testing.assert_allclose(deviation, [20.0 * unit_N, 20.0 * unit_N, 100.0])


@pytest.mark.parametrize("slope", [1.5, 8.0])
def test_its_inverse_is_as_accurate_for_the_smallest_deviation_as_for_the_largest(monkeypatch, slope):
    monkeypatch.setattr(basis_module, "LEAST_SCALE", 0.0)  # with it an inverse of less care would do
    prior = Prior.of(model_of(prior__weight_slope=slope, basis__finest_level=-3, basis__coarsest_level=6))
    size = np.sqrt(np.diag(prior.covariance))
    if slope == 8.0:
        assert size.max() / size.min() > 1e16
    known = np.linalg.inv(prior.covariance / np.multiply.outer(size, size))
    np.testing.assert_allclose(
        prior.information * np.multiply.outer(size, size), known, atol=1e-9 * np.abs(known).max()
    )
