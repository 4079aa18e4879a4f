"""Batch reference: known systems, derivatives, covariance, rank; all against independent computations."""

import numpy as np
import pytest

from friction_estimator.core.errors import ConfigError, UnanswerableError
from friction_estimator.core.fit.batch import fit_batch, predict
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.fit.posterior import Posterior
from friction_estimator.core.fit.variable_projection import on_gauge, reduced_hessian, refine, start_taps
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

REACH = 0.1


def config_of(model="hammerstein", **changes):
    values = {
        "model.type": model,
        "theory.kind": "seal",
        "basis.velocity_range": [-REACH, REACH],
        "force_unit": 2.0,
        "fir.order": 4,
        "basis.finest_level": 0,
        "basis.coarsest_level": 2,
    }
    return Config.from_mapping(values | {name.replace("__", "."): value for name, value in changes.items()})


def record(velocity, friction, restart_at=(0,)):
    index = np.arange(velocity.size)
    return Samples(index * 1_000_000, velocity, friction, np.isin(index, restart_at))


def swept(n, seed=77):
    """A velocity that moves over several samples and covers the range."""
    steps = np.random.default_rng(seed).standard_normal(n + 20)
    smooth = np.convolve(steps, np.ones(8) / 8, "valid")[:n]
    return 0.97 * REACH * np.tanh(2.0 * smooth)


def parameters_of(model, seed):
    generator = np.random.default_rng(seed)
    prior = Prior.of(model)
    return model.split(prior.mean + prior.root @ generator.standard_normal(model.size))


def free_fit(model, samples):
    """Return the fit without a prior from the best of its starts."""
    moments = gather(model, samples)
    starts = start_taps(moments, np.random.default_rng(0))
    return model.split(on_gauge(moments, min((refine(moments, start) for start in starts), key=moments.cost)))


class Columns:
    """Extension with memory: the velocity of the sample before, and the acceleration-like difference."""

    size, names = 2, ("before", "change")
    forces = phases = np.zeros(2, np.bool_)

    def __init__(self):
        self.restart()

    def restart(self):
        self.last = 0.0

    def columns(self, samples, theory_N):
        before = np.concatenate([[self.last], samples.velocity_m_s[:-1]])
        self.last = float(samples.velocity_m_s[-1])
        return np.column_stack([30.0 * before, 50.0 * (samples.velocity_m_s - before)])


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_moments_are_those_of_the_regressors_that_the_online_loop_builds(model_type):
    """Restarts, samples left out, samples outside the range and block borders included."""
    config = config_of(model_type)
    velocity = swept(9000)
    velocity[[40, 41, 5000, 8191]] = 1.2 * REACH
    samples = record(velocity, np.random.default_rng(1).standard_normal(9000), (0, 3, 4, 700, 4096, 8999))
    use = np.random.default_rng(2).random(9000) > 0.1
    model = Model(config, Columns())
    moments = gather(model, samples, use, ridge=0.0)
    inside = use & (np.abs(velocity) <= REACH)
    for begin in np.flatnonzero(samples.restart):
        inside[begin : begin + int(model.shape[0]) - 1] = False  # their delay lines hold what nobody measured
    for seed in range(5):
        parts = parameters_of(model, seed)
        predicted = predict(samples, config, parts, Columns())
        mean_square = np.mean(np.square((samples.friction_N - predicted)[inside] / config.force_unit))
        assert moments.cost(parts.theta) == pytest.approx(0.5 * mean_square, rel=1e-10)
    assert moments.count == np.count_nonzero(inside)


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_derivatives_agree_with_differences(model_type):
    model = Model(config_of(model_type), Columns())
    moments = gather(model, record(swept(800), np.random.default_rng(3).standard_normal(800)))
    theta = parameters_of(model, 4).theta
    gradient, hessian = moments.gradient(theta), moments.hessian(theta)
    for direction in np.random.default_rng(5).standard_normal((8, theta.size)):
        step = 1e-4 * direction / np.linalg.norm(direction)
        slope = (moments.cost(theta + step) - moments.cost(theta - step)) / 2.0
        assert slope == pytest.approx(gradient @ step, rel=1e-6)
        bend = (moments.gradient(theta + step) - moments.gradient(theta - step)) / 2.0
        np.testing.assert_allclose(bend, hessian @ step, rtol=1e-5, atol=1e-9)


def test_reduced_hessian_is_that_of_the_cost_with_the_rest_at_its_optimum():
    model = Model(config_of())
    moments = gather(model, record(swept(800), np.random.default_rng(3).standard_normal(800)), ridge=1e-3)
    taps = np.random.default_rng(6).standard_normal(moments.taps)
    reduced = reduced_hessian(moments, moments.eliminate(taps))

    def slope(at):
        return moments.gradient(moments.eliminate(at))[: moments.taps]

    for direction in np.eye(moments.taps):
        difference = (slope(taps + 1e-5 * direction) - slope(taps - 1e-5 * direction)) / 2e-5
        np.testing.assert_allclose(difference, reduced @ direction, rtol=1e-5, atol=1e-8)
    # The reduced cost does not change along the scale orbit, so there its slope is 0 and its slope's change -slope.
    assert abs(slope(taps) @ taps) < 1e-15
    np.testing.assert_allclose(reduced @ taps, -slope(taps), atol=1e-12)


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_the_free_fit_recovers_a_known_system(model_type):
    """Without noise and with rich excitation the map is recovered, whatever scale and sign it was written in."""
    config = config_of(model_type)
    model = Model(config)
    truth = parameters_of(model, 7)
    truth.fir_taps[:] *= -3.0
    velocity = swept(6000)
    samples = record(velocity, predict(record(velocity, velocity), config, truth))
    fitted = free_fit(model, samples)
    fresh = record(swept(3000, seed=9), np.zeros(3000))
    expected = predict(fresh, config, truth)
    assert np.std(predict(fresh, config, fitted) - expected) < 1e-3 * np.std(expected)
    if model_type == "hammerstein":
        shape = truth.fir_taps / np.linalg.norm(truth.fir_taps) * np.sign(truth.fir_taps.sum())
        np.testing.assert_allclose(fitted.fir_taps, shape, atol=1e-4)


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_a_known_system_is_recovered_the_better_the_less_a_sample_is_taken_to_err(model_type):
    velocity, errors = swept(6000), []
    fresh = record(swept(3000, seed=9), np.zeros(3000))
    for deviation in (0.18, 0.018, 0.0018):
        config = config_of(model_type, prior__residual_deviation=deviation, rls__forgetting_factor=1.0)
        truth = parameters_of(Model(config), 7)
        fit = fit_batch(record(velocity, predict(record(velocity, velocity), config, truth)), config)
        expected = predict(fresh, config, truth)
        errors.append(np.std(predict(fresh, config, fit.parameters) - expected) / np.std(expected))
    assert errors[0] < 0.02
    assert errors[0] > 5.0 * errors[1] > 25.0 * errors[2]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_the_noise_floor_is_reached_on_fresh_data(model_type, seed):
    """Excess over the truth on data that the fit never saw: what its degrees of freedom and the prior cost."""
    config = config_of(model_type)
    truth = parameters_of(Model(config), 10 + seed)
    velocity = swept(40000, 200 + seed)
    clean = predict(record(velocity, velocity, (0, 20000)), config, truth)
    noise = 0.03 * np.std(clean) * np.random.default_rng(100 + seed).standard_normal(40000)
    samples = record(velocity, clean + noise, (0, 20000))
    use = np.arange(40000) < 20000
    fit = fit_batch(samples, config, use=use)
    error = samples.friction_N - fit.predicted_N
    assert np.std(error[20000:]) <= 1.02 * np.std(noise[20000:])
    assert fit.residual_rms_N == pytest.approx(np.std(noise[:20000]), rel=0.02)


def test_every_start_is_reported_and_the_best_is_taken():
    config = config_of()
    truth = parameters_of(Model(config), 3)
    velocity = swept(3000)
    clean = predict(record(velocity, velocity), config, truth)
    fit = fit_batch(record(velocity, clean + 0.1 * np.random.default_rng(0).standard_normal(3000)), config)
    assert list(fit.start_costs) == sorted(fit.start_costs)
    assert len(fit.start_costs) == 3
    assert fit.posterior.cost(fit.parameters.theta) == pytest.approx(fit.start_costs[0], rel=1e-9)


def test_the_end_is_a_minimum_and_a_saddle_is_left():
    """Taps exchanged for a stationary point that is no minimum: refinement must move on to the minimum."""
    config = config_of(fir__order=1)
    model = Model(config)
    velocity = swept(4000)
    moments = gather(model, record(velocity, np.tanh(velocity / 0.02)))
    end = refine(moments, np.array([1.0, 0.3]))
    curvature = np.linalg.eigvalsh(reduced_hessian(moments, end))
    assert np.linalg.norm(moments.gradient(end)) < 1e-8
    assert curvature.min() > -1e-9
    # On the circle of taps the reduced cost is continuous, so its largest value is stationary as well.
    angles = np.linspace(0.0, np.pi, 4001)
    costs = [moments.cost(moments.eliminate(np.array([np.cos(a), np.sin(a)]))) for a in angles]
    top = angles[int(np.argmax(costs))]
    summit = moments.eliminate(np.array([np.cos(top), np.sin(top)]))
    assert np.linalg.eigvalsh(reduced_hessian(moments, summit)).min() < -1e-6
    assert moments.cost(refine(moments, summit[:2])) == pytest.approx(moments.cost(end), rel=1e-6, abs=1e-12)


def test_scale_and_sign_orbits_are_one_point_on_the_gauge():
    model = Model(config_of("parallel"))
    moments = gather(model, record(swept(500), np.random.default_rng(1).standard_normal(500)))
    theta = parameters_of(model, 2).theta
    a, w = slice(0, moments.taps), slice(moments.taps, moments.taps + moments.weights)
    for factor in (-1.0, 1e-3, -40.0):
        moved = theta.copy()
        moved[a] *= factor
        moved[w] /= factor
        assert moments.cost(moved) == pytest.approx(moments.cost(theta), rel=1e-12)
        np.testing.assert_allclose(on_gauge(moments, moved), on_gauge(moments, theta), rtol=1e-12)
    assert np.linalg.norm(on_gauge(moments, theta)[a]) == pytest.approx(1.0)
    assert on_gauge(moments, theta)[a].sum() > 0.0


@pytest.mark.parametrize(("levels", "order"), [(4, 0), (6, 2), (11, 5)])
def test_rank_on_a_designed_case(levels, order):
    """Velocities that take K values in random order excite K weights and all taps; the orbit takes one off."""
    known = {"prior.residual_deviation": 1e-4, "rls.forgetting_factor": 1.0}  # each sample is worth much
    config = config_of(fir__order=order, basis__finest_level=-1).updated(known)
    generator = np.random.default_rng(levels)
    values = np.linspace(-0.9 * REACH, 0.9 * REACH, levels)
    velocity = generator.choice(values, 5000)
    truth = parameters_of(Model(config), 1)
    clean = predict(record(velocity, velocity), config, truth)
    noisy = clean + 1e-5 * np.std(clean) * generator.standard_normal(5000)  # and so little that it is worth it
    fit = fit_batch(record(velocity, noisy), config)
    assert fit.identifiable_rank == levels + order
    assert fit.singular_values[fit.identifiable_rank - 1] > 10.0 * fit.threshold
    assert fit.singular_values[fit.identifiable_rank] < 0.1 * fit.threshold


def test_what_is_not_excited_stays_at_zero():
    config = config_of(basis__finest_level=-1)
    velocity = 0.5 * (swept(4000) + 0.97 * REACH)  # positive only
    force = np.sqrt(velocity) + 0.001 * np.random.default_rng(0).standard_normal(4000)
    fit = fit_batch(record(velocity, force), config)
    basis = fit.model.basis
    untouched = ~np.isin(np.arange(basis.size), basis.rows(velocity)[0])
    assert untouched.any()
    np.testing.assert_array_equal(fit.parameters.wavelet_weights[untouched], 0.0)
    prior = fit.posterior.prior.covariance[5:, 5:]
    np.testing.assert_allclose(np.diag(fit.covariance[5:, 5:])[untouched], np.diag(prior)[untouched], rtol=1e-9)
    assert np.diag(fit.covariance[5:, 5:])[~untouched].min() < 0.1 * np.diag(prior)[~untouched].min()


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_covariance_is_the_scatter_of_the_curve_about_the_truth(model_type):
    """Over truths drawn from the prior, under white noise of the deviation that the prior takes it to have."""
    config = config_of(
        model_type,
        fir__order=2,
        basis__coarsest_level=1,
        basis__finest_level=1,
        prior__residual_deviation=0.02,
        rls__forgetting_factor=1.0,
    )
    model = Model(config)
    prior = Prior.of(model)
    velocity = np.random.default_rng(3).uniform(-REACH, REACH, 800)
    generator = np.random.default_rng(8)
    at = np.linspace(-0.9 * REACH, 0.9 * REACH, 13)
    theory = model.theory_at(at, config.theory.default_pressure, config.theory.default_temperature)
    errors = []
    for draw in range(120):
        truth = parameters_of(model, draw)
        clean = predict(record(velocity, velocity), config, truth)
        noise = 0.02 * config.force_unit * generator.standard_normal(800)
        moments = gather(model, record(velocity, clean + noise), ridge=0.0)
        posterior = Posterior(moments, prior, float(moments.count))
        theta = posterior.minimum(prior.mean[:3])
        # Of the curve: scale and sign of taps and weights are the prior's matter, and no ellipsoid.
        fitted, gradient = model.steady_state(theta, at, theory)
        expected, _ = model.steady_state(truth.theta, at, theory)
        variance = np.einsum("ij,jk,ik->i", gradient, posterior.covariance(theta), gradient)
        errors.append((fitted - expected) / model.unit_N / np.sqrt(variance))
    square = np.mean(np.square(errors), axis=0)  # 120 draws: each has a standard error of 0.13
    assert np.mean(square) == pytest.approx(1.0, abs=0.15)
    assert square.max() < 1.6
    assert square.min() > 0.6
    assert np.abs(np.mean(errors, axis=0)).max() < 0.4


def test_a_change_of_units_changes_nothing_else():
    config = config_of("hammerstein")
    truth = parameters_of(Model(config), 3)
    velocity = swept(3000)
    force = predict(record(velocity, velocity), config, truth) + 0.05 * np.random.default_rng(0).standard_normal(3000)
    fit = fit_batch(record(velocity, force), config)
    kilo = fit_batch(record(velocity, 1024.0 * force), config.updated({"force_unit": 2048.0}))
    np.testing.assert_array_equal(kilo.parameters.theta, fit.parameters.theta)
    np.testing.assert_array_equal(kilo.predicted_N, 1024.0 * fit.predicted_N)
    assert kilo.identifiable_rank == fit.identifiable_rank


@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_no_frozen_model_of_the_same_structure_is_more_probable(model_type, law):
    config = config_of(model_type, model__law=law)
    velocity = swept(4000)
    force = np.tanh(velocity / 0.02) + 0.05 * np.random.default_rng(0).standard_normal(4000)
    samples = record(velocity, force)
    online = Estimator(config)
    online.run(samples)
    fit = fit_batch(samples, config)
    assert fit.posterior.cost(fit.parameters.theta) < fit.posterior.cost(online.parameters.theta)


@pytest.mark.parametrize("model_type", ["hammerstein", "parallel"])
def test_no_frozen_model_fits_better_than_the_free_fit(model_type):
    config = config_of(model_type)
    velocity = swept(4000)
    force = np.tanh(velocity / 0.02) + 0.05 * np.random.default_rng(0).standard_normal(4000)
    samples = record(velocity, force)
    error = {
        name: np.std((force - predict(samples, config, parameters))[4:])
        for name, parameters in (
            ("free", free_fit(Model(config), samples)),
            ("posterior", fit_batch(samples, config).parameters),
        )
    }
    assert error["free"] < error["posterior"] < 1.05 * error["free"]


def test_samples_without_a_measured_past_do_not_bend_the_fit():
    """Restarts fill the delay lines as if the shaft had stood there: wild friction at such samples changes nothing."""
    config = config_of()
    velocity = swept(2000)
    force = predict(record(velocity, velocity), config, parameters_of(Model(config), 3))
    wild = force.copy()
    starts = (0, 500, 503, 1200)
    for start in starts:
        wild[start : start + 3] = 1e3
    plain, disturbed = (fit_batch(record(velocity, f, starts), config) for f in (force, wild))
    np.testing.assert_array_equal(disturbed.parameters.theta, plain.parameters.theta)
    assert plain.posterior.moments.count == 2000 - 4 - 7 - 4


def test_data_and_structures_that_cannot_be_fitted_are_refused():
    velocity = swept(50)
    with pytest.raises(UnanswerableError, match="velocity_range"):
        fit_batch(record(velocity + 10.0, velocity), config_of())
    with pytest.raises(UnanswerableError, match="nothing to fit"):
        fit_batch(record(velocity, velocity), config_of(), use=False)
    with pytest.raises(ConfigError, match=r"lower fir\.order"):
        fit_batch(record(velocity, velocity), config_of(fir__order=64, basis__finest_level=-3))
    with pytest.raises(ConfigError, match="force_unit"):
        fit_batch(record(velocity, velocity), config_of(force_unit=0.0))
