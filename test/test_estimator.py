"""Models and laws: known systems are recovered, gradients are right, state is kept bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.metrics import by_cycle, drive_cycles, nrmse, nrmse_persistence
from friction_estimator.core.model.prediction import TAPS
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.derive import with_recorded_units
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.simulate import Scenario, simulate

RATE = 500
MODELS = ("hammerstein", "parallel")
NOISE = 0.01


def drive(cycles: int, period_s: float = 5.0, stroke_m: float = 0.02) -> np.ndarray:
    t = np.arange(int(cycles * period_s * RATE)) / RATE
    return stroke_m * 2 * np.pi / period_s * np.cos(2 * np.pi * t / period_s)


def samples_of(velocity: np.ndarray, friction: np.ndarray, scale: float = 1.0) -> Samples:
    n = velocity.size
    restart = np.zeros(n, np.bool_)
    restart[0] = True
    stamps = 1 + np.arange(n, dtype=np.int64) * (1_000_000_000 // RATE)
    return Samples(stamps, velocity * scale, friction, restart)


def known_system(model_type: str, velocity: np.ndarray) -> np.ndarray:
    """A smooth Stribeck-like map behind a short FIR; the parallel one adds the filtered theory."""
    g = 4.0 * np.tanh(velocity / 0.004) * (0.4 + 0.6 * np.exp(-np.abs(velocity) / 0.01)) + 20.0 * velocity
    taps = np.array([0.6, 0.3, 0.1])
    hold = np.concatenate([np.full(8, g[0]), g])
    friction = lfilter(taps, [1.0], hold)[8:]
    if model_type == "parallel":
        config = Config.from_mapping({"basis.velocity_range": [-1, 1], "force_unit": 1.0})
        d = Model(config).theoretical_friction(samples_of(velocity, velocity))
        hold = np.concatenate([np.full(8, d[0]), d])
        friction = 0.3 * friction + lfilter([0.9, 0.2], [1.0], hold)[8:]
    return friction


def record(model_type: str, cycles: int, noise: float = NOISE, seed: int = 0) -> tuple[Samples, np.ndarray]:
    velocity = drive(cycles)
    clean = known_system(model_type, velocity)
    sigma = noise * np.sqrt(np.mean(clean**2))
    measured = clean + sigma * np.random.default_rng(seed).standard_normal(clean.size)
    return samples_of(velocity, measured), clean


def estimator_for(samples: Samples, **over) -> Estimator:
    settings = {name.replace("__", "."): value for name, value in over.items()}
    config = with_recorded_units(Config.from_mapping(settings), samples.velocity_m_s, samples.friction_N)
    return Estimator(config)


@pytest.mark.parametrize("model_type", MODELS)
def test_rls_reaches_the_noise_floor(model_type):
    samples, clean = record(model_type, 20)
    predicted = estimator_for(samples, model__type=model_type).run(samples)
    last = slice(-5 * 5 * RATE, None)
    noise = np.sqrt(np.mean((samples.friction_N - clean)[last] ** 2))
    assert np.sqrt(np.mean((samples.friction_N - predicted)[last] ** 2)) < 1.02 * noise


@pytest.mark.parametrize("law", ["lms", "nlms"])
@pytest.mark.parametrize("model_type", MODELS)
def test_gradient_laws_converge_at_their_default_step_size(law, model_type):
    samples, _ = record(model_type, 80)
    estimator = estimator_for(samples, model__type=model_type, model__law=law)
    cycles = by_cycle(samples.friction_N, estimator.run(samples), samples.velocity_m_s)
    assert np.mean(cycles[-5:]) < 0.035
    assert np.mean(cycles[-5:]) < 0.5 * cycles[0] or cycles[0] < 0.02
    assert estimator.health.guarded == 0


@pytest.mark.parametrize("model_type", MODELS)
def test_learned_map_is_the_true_one(model_type):
    """The static friction, not the weights, is what is unique."""
    samples, _ = record(model_type, 20)
    estimator = estimator_for(samples, model__type=model_type)
    estimator.run(samples)
    v = np.linspace(-0.9, 0.9, 41) * np.abs(samples.velocity_m_s).max()
    static = known_system(model_type, np.repeat(v, 50))[49::50]
    probe = samples_of(v, v)
    parameters = estimator.parameters
    learned = estimator.model.static_map(parameters.theta, v)
    learned += parameters.theory_taps.sum() * estimator.model.theoretical_friction(probe)
    assert nrmse(static, learned) < 0.02


@pytest.mark.parametrize("model_type", MODELS)
def test_regressor_is_the_gradient_of_the_prediction(model_type):
    """The first lms step is mu e x: its direction must be that of finite differences."""
    samples, _ = record(model_type, 1)
    start = estimator_for(samples, model__type=model_type, model__law="lms", lms__step_size=1e-9)
    rng = np.random.default_rng(3)
    theta = rng.standard_normal(start.model.size) * 0.3
    taps = start.model.shape[TAPS]
    theta[:taps] /= np.linalg.norm(theta[:taps])
    state = start.state()

    def prediction(parameters: np.ndarray) -> float:
        probe = estimator_for(samples, model__type=model_type, model__law="lms", lms__step_size=1e-9)
        probe.parameters = probe.model.split(parameters)
        return probe.run(samples[:300], learn=False)[-1] / probe.config.force_unit

    start.parameters = start.model.split(theta)
    start.run(samples[:299], learn=False)
    predicted = start.run(samples[299:300])[0]
    error = (samples.friction_N[299] - predicted) / start.config.force_unit
    step = start.parameters.theta - theta
    # Normalising A removes the part of its step along A.
    gradient = np.zeros_like(theta)
    for i in range(theta.size):
        change = np.zeros_like(theta)
        change[i] = 1e-6
        gradient[i] = (prediction(theta + change) - prediction(theta - change)) / 2e-6
    expected = 1e-9 * error * gradient
    expected[:taps] -= theta[:taps] * (theta[:taps] @ expected[:taps])
    np.testing.assert_allclose(step, expected, atol=2e-15)
    assert state["version"] == 2


def test_lms_is_the_papers_algorithm_to_the_letter():
    """Against a plain numpy transcription of section 3, with the misprint of F1 mended."""
    samples, _ = record("parallel", 2)
    samples = samples[:2000]
    estimator = estimator_for(samples, model__law="lms", lms__step_size=0.01)
    predicted = estimator.run(samples) / estimator.config.force_unit
    model, mu = estimator.model, 0.01
    psi = model.basis.dense(samples.velocity_m_s)
    d = model.theoretical_friction(samples) / estimator.config.force_unit
    f = samples.friction_N / estimator.config.force_unit
    order = model.shape[TAPS]
    a2, w, a1 = np.eye(order)[0], np.zeros(model.basis.size), np.eye(order)[0]
    expected = np.empty(len(samples))
    for k in range(len(samples)):
        lags = np.maximum(k - np.arange(order), 0)
        f2, f1 = psi[lags] @ w, d[lags]
        expected[k] = a1 @ f1 + a2 @ f2
        e = f[k] - expected[k]
        filtered = a2 @ psi[lags]
        a1 = a1 + mu * e * f1
        star = a2 + mu * e * f2
        w = w + mu * e * filtered
        a2 = star / np.linalg.norm(star)
    np.testing.assert_allclose(predicted, expected, atol=1e-10)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model_type", MODELS)
def test_one_sample_at_a_time_is_bit_equal_to_arrays(law, model_type):
    samples, _ = record(model_type, 1)
    samples = samples[:700]
    arrays, single = (estimator_for(samples, model__type=model_type, model__law=law) for _ in range(2))
    whole = arrays.run(samples)
    steps = [
        single.step(
            int(samples.stamp_ns[k]), samples.velocity_m_s[k], samples.friction_N[k], restart=bool(samples.restart[k])
        )
        for k in range(len(samples))
    ]
    np.testing.assert_array_equal(whole, steps)
    np.testing.assert_array_equal(arrays.parameters.theta, single.parameters.theta)


@pytest.mark.parametrize("law", LAWS)
def test_restored_state_continues_bit_for_bit(law):
    samples, _ = record("parallel", 2)
    whole, first, second = (estimator_for(samples, model__law=law) for _ in range(3))
    expected = whole.run(samples)
    half = len(samples) // 2
    first.run(samples[:half])
    second.restore(first.state())
    np.testing.assert_array_equal(second.run(samples[half:]), expected[half:])


@pytest.mark.parametrize("law", LAWS)
def test_samples_are_not_written_and_memory_stays_bounded(law):
    samples, _ = record("parallel", 1)
    frozen = replace(samples)
    for name in ("velocity_m_s", "friction_N", "stamp_ns", "restart"):
        getattr(frozen, name).setflags(write=False)
    estimator = estimator_for(samples, model__law=law)
    sizes = [a.nbytes for a in estimator.state()["arrays"].values()]
    estimator.run(frozen)
    assert [a.nbytes for a in estimator.state()["arrays"].values()] == sizes


def test_a_state_that_does_not_fit_is_refused_and_changes_nothing():
    samples, _ = record("parallel", 1)
    estimator, other = estimator_for(samples), estimator_for(samples, fir__order=4)
    estimator.run(samples[:100])
    before = estimator.parameters.theta
    with pytest.raises(ConfigError, match=r"fir\.order"):
        estimator.restore(other.state())
    with pytest.raises(ConfigError, match=r"seal\.roughness"):
        estimator.restore(estimator_for(samples, seal__roughness=2e-7).state())
    damaged = estimator.state()
    damaged["arrays"]["theta"][3] = np.nan
    with pytest.raises(ConfigError, match="theta"):
        estimator.restore(damaged)
    np.testing.assert_array_equal(estimator.parameters.theta, before)


def test_learned_values_start_the_next_run_warm():
    samples, _ = record("parallel", 4)
    first = estimator_for(samples)
    first.run(samples)
    learned = first.parameters
    warm = Estimator(
        first.config.updated(
            {
                "learned.fir_taps": learned.fir_taps,
                "learned.wavelet_weights": learned.wavelet_weights,
                "learned.theory_taps": learned.theory_taps,
            }
        )
    )
    np.testing.assert_array_equal(warm.parameters.theta, learned.theta)
    with pytest.raises(ConfigError, match=r"learned\.fir_taps"):
        Estimator(first.config.updated({"learned.fir_taps": [1.0]}))


def test_learned_values_that_no_estimator_learned_are_refused():
    config = Config.from_mapping(
        {"force_unit": 5.0, "basis.velocity_range": [-0.1, 0.1], "learned.fir_taps": [1e300] + [0.0] * 8}
    )
    with pytest.raises(ConfigError, match=r"learned\.fir_taps is larger"):
        Estimator(config)


def test_parallel_predicts_the_theory_before_it_has_learned():
    samples, _ = record("parallel", 1)
    estimator = estimator_for(samples)
    np.testing.assert_allclose(
        estimator.run(samples, learn=False), estimator.model.theoretical_friction(samples), rtol=1e-12
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model_type", MODELS)
def test_results_do_not_depend_on_the_units(law, model_type):
    """Powers of two are exact in floating point, so equivariance can be asked for bit by bit."""
    samples, _ = record("hammerstein", 2)
    scaled = replace(samples, velocity_m_s=samples.velocity_m_s * 64.0, friction_N=samples.friction_N * 1024.0)
    theory = {"theory__kind": "seal"} if model_type == "parallel" else {}
    plain = estimator_for(samples, model__type=model_type, model__law=law, **theory)
    large = estimator_for(scaled, model__type=model_type, model__law=law, **theory)
    if model_type == "parallel":  # the same curve in the scaled world
        curve, large.model.theory_scale = plain.model.theory, plain.model.theory_scale
        large.model.theory = type(
            "Scaled", (), {"evaluate": lambda _, v, p, t: 1024.0 * curve.evaluate(v / 64.0, p, t)}
        )()
    np.testing.assert_array_equal(large.run(scaled), 1024.0 * plain.run(samples))


def test_velocity_outside_the_range_is_counted_and_not_learned():
    samples, _ = record("hammerstein", 1)
    estimator = estimator_for(samples, model__type="hammerstein", basis__velocity_range=[-0.01, 0.01])
    estimator.run(samples)
    outside = np.count_nonzero(np.abs(samples.velocity_m_s) > 0.01)
    assert estimator.health.outside == outside > 0
    assert estimator.health.learned == len(samples) - outside


@pytest.mark.parametrize("model_type", MODELS)
def test_abrupt_change_is_followed_within_three_cycles(model_type):
    samples, clean = record(model_type, 16)
    half = len(samples) // 2
    gain = np.where(np.arange(len(samples)) < half, 1.0, 1.3)
    changed = replace(samples, friction_N=samples.friction_N * gain)
    estimator = estimator_for(changed, model__type=model_type)
    error = changed.friction_N - estimator.run(changed)
    noise = 1.3 * np.sqrt(np.mean((samples.friction_N - clean) ** 2))
    cycle = 5 * RATE
    after = np.sqrt(np.mean(error[half + 3 * cycle : half + 5 * cycle] ** 2))
    assert after < 1.2 * noise
    assert estimator.health.alarmed >= 1


@pytest.mark.parametrize("law", LAWS)
def test_an_hour_of_standstill_costs_nothing(law):
    """No wind-up: after standstill the next cycles are predicted as well as before."""
    samples, _ = record("parallel", 30)
    cycle = 5 * RATE
    estimator = estimator_for(samples, model__law=law)
    before = nrmse(samples.friction_N, estimator.run(samples))
    rng = np.random.default_rng(5)
    rest = samples_of(np.zeros(RATE * 3600), 0.02 * rng.standard_normal(RATE * 3600))
    estimator.run(rest)
    assert np.isfinite(estimator.parameters.theta).all()
    after = nrmse(samples.friction_N[:cycle], estimator.run(samples[:cycle]))
    assert after < 1.5 * max(before, 0.012)


def test_spikes_do_not_move_the_model():
    samples, _ = record("parallel", 20)
    spiked = samples.friction_N.copy()
    spiked[5000::997] = 1e9
    estimator = estimator_for(samples)
    predicted = estimator.run(replace(samples, friction_N=spiked))
    clean = np.ones(len(samples), np.bool_)
    clean[5000::997] = False
    late = slice(-2 * 5 * RATE, None)
    assert nrmse(samples.friction_N[late][clean[late]], predicted[late][clean[late]]) < 0.02
    assert estimator.health.clipped >= 40


def test_drive_cycles_need_a_periodic_drive():
    rng = np.random.default_rng(0)
    assert drive_cycles(np.zeros(1000)) == []
    assert drive_cycles(np.cumsum(rng.standard_normal(3000)) + 100.0) == []
    assert len(drive_cycles(drive(6))) in (5, 6)


def test_figures_of_merit_by_hand():
    f = np.array([0.0, 1.0, 0.0, 1.0])
    restart = np.array([True, False, True, False])
    assert nrmse(f, f) == 0.0
    assert np.isnan(nrmse(np.ones(3), np.ones(3)))
    # Differences inside the two pieces: 1 and 1; std of the samples that have a predecessor is 0.
    assert np.isnan(nrmse_persistence(f, restart))
    assert nrmse_persistence(np.array([0.0, 1.0, 3.0]), np.array([True, False, False])) == pytest.approx(np.sqrt(2.5))


def test_an_error_that_comes_back_in_every_cycle_is_no_change_of_friction():
    """Condition b at 5 kHz: the memory of the model is too short for the film's lag, twice in each cycle."""
    period, pressure = CONDITIONS["b"]
    samples = simulate(Scenario((segment(period, pressure, 10.0),), rate_hz=5000.0, noise=0.01)).paired()
    estimator = estimator_for(samples, model__type="hammerstein")
    estimator.run(samples)
    assert estimator.health.alarmed <= 3
