"""Models and laws: known systems are recovered, gradients are right, state is kept bit for bit."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import MODELS, RATE, config_for, known_system, noisy, samples_of, sine

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.metrics import by_cycle, cycles_or_tenths, drive_cycles, nrmse, nrmse_persistence
from friction_estimator.core.model.prediction import TAPS
from friction_estimator.core.online import workspace
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.simulate import Scenario, simulate


def record(model_type: str, cycles: int, seed: int = 0) -> tuple[Samples, np.ndarray]:
    velocity = sine(cycles)
    clean = known_system(model_type, velocity)
    return samples_of(velocity, noisy(clean, seed=seed)), clean


def estimator_for(samples: Samples, **over) -> Estimator:
    return Estimator(config_for(samples, **over))


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
    cycles = by_cycle(samples.friction_N, estimator.run(samples), cycles_or_tenths(samples.velocity_m_s))
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

    def prediction(parameters: np.ndarray) -> float:
        probe = estimator_for(samples, model__type=model_type, model__law="lms", lms__step_size=1e-9)
        probe.parameters = probe.model.split(parameters)
        return probe.run(samples[:300], learn=False)[-1] / probe.model.unit_N

    start.parameters = start.model.split(theta)
    start.run(samples[:299], learn=False)
    predicted = start.run(samples[299:300])[0]
    error = (samples.friction_N[299] - predicted) / start.model.unit_N
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


@pytest.mark.parametrize(("guard", "mu", "count"), [(True, 0.01, 2000), (False, 0.01, 2000), (False, 0.3, 60)])
def test_lms_is_the_papers_algorithm_to_the_letter(guard, mu, count):
    """Against a plain numpy transcription of section 3, the misprint of F1 mended; also where it diverges."""
    samples = record("parallel", 2)[0][:count]
    estimator = estimator_for(record("parallel", 2)[0], model__law="lms", lms__step_size=mu, lms__guard=guard)
    unit = estimator.model.unit_N
    predicted = estimator.run(samples) / unit
    model = estimator.model
    psi = model.basis.dense(samples.velocity_m_s)
    d = model.theoretical_friction(samples) / unit
    f = samples.friction_N / unit
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
    np.testing.assert_allclose(predicted, expected, atol=1e-10, rtol=1e-6)
    assert estimator.health.guarded == 0
    if mu > 0.1:  # the guarded law does otherwise
        careful = Estimator(estimator.config.updated({"lms.guard": True}))
        assert not np.allclose(careful.run(samples) / unit, expected)
        assert careful.health.guarded > 0


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
    before = estimator.state()
    with pytest.raises(ConfigError, match=r"fir\.order"):
        estimator.restore(other.state())
    with pytest.raises(ConfigError, match=r"seal\.roughness"):
        estimator.restore(estimator_for(samples, seal__roughness=2e-7).state())
    with pytest.raises(ConfigError, match=r"prior\.tap_decay"):
        estimator.restore(estimator_for(samples, prior__tap_decay=0.5).state())
    _same_state(estimator.state(), before)


@pytest.mark.parametrize("law", LAWS)
def test_a_snapshot_stays_as_it_is_while_its_estimator_goes_on(law):
    """What a thread saves and draws is of one moment, whatever is learned, reset or set meanwhile."""
    samples, _ = record("parallel", cycles=2)
    estimator = estimator_for(samples, model__law=law)
    half = len(samples) // 2
    estimator.run(samples[:half])
    taken, state, curve = estimator.snapshot(), estimator.state(), estimator.curve()
    estimator.run(samples[half:])
    estimator.parameters = estimator.model.split(np.zeros_like(estimator.work.theta))
    _same_state(taken.state(), state)
    np.testing.assert_array_equal(taken.curve().friction_N, curve.friction_N)
    np.testing.assert_array_equal(taken.curve().low_N, curve.low_N)
    assert taken.health.samples == half
    assert estimator.health.samples == len(samples)


def _same_state(one, other):
    assert {**one, "arrays": 0} == {**other, "arrays": 0}
    assert one["arrays"].keys() == other["arrays"].keys()
    for name, array in one["arrays"].items():
        np.testing.assert_array_equal(array, other["arrays"][name], err_msg=name)


@pytest.mark.parametrize("name", ["theta", "ring", "ring_theory", "root", "moments", "status", "errors"])
def test_damaged_arrays_are_refused_by_name(name):
    samples, _ = record("parallel", 1)
    estimator = estimator_for(samples)
    estimator.run(samples[:100])
    before = estimator.state()
    for damage in (
        lambda a: np.concatenate([a, a]),
        lambda a: a.ravel()[:-1],
        lambda a: a.astype(np.float32),
        lambda a: None,
    ):
        state = estimator.state()
        state["arrays"][name] = damage(state["arrays"][name])
        with pytest.raises(ConfigError, match=name):
            estimator.restore(state)
    if name != "status":
        for value in (np.nan, np.inf):
            state = estimator.state()
            state["arrays"][name].flat[0] = value
            with pytest.raises(ConfigError, match=f"{name}.*not finite"):
                estimator.restore(state)
    state = estimator.state()
    del state["arrays"][name]
    with pytest.raises(ConfigError, match=name):
        estimator.restore(state)
    _same_state(estimator.state(), before)


@pytest.mark.parametrize(
    ("array", "place"),
    [("status", (workspace.SEEN,)), ("status", (workspace.HEAD,)), ("errors", (0, 0))],
)
def test_a_state_with_impossible_counts_is_refused(array, place):
    estimator = estimator_for(record("parallel", 1)[0])
    state = estimator.state()
    state["arrays"][array][place] = -7
    with pytest.raises(ConfigError, match="impossible"):
        estimator.restore(state)


@pytest.mark.parametrize("version", [None, 1, 2, 6, "5"])
def test_a_state_of_another_version_is_refused(version):
    estimator = estimator_for(record("parallel", 1)[0])
    with pytest.raises(ConfigError, match="this program reads 5"):
        estimator.restore(estimator.state() | {"version": version})


@pytest.mark.parametrize("name", ["chosen", "structure"])
def test_a_state_that_lacks_its_range_or_structure_is_refused(name):
    estimator = estimator_for(record("parallel", 1)[0])
    for value in (None, [], {"learned.force_unit": 1.0} if name == "chosen" else 3):
        with pytest.raises(ConfigError, match="which range and units"):
            estimator.restore(estimator.state() | {name: value})


def test_range_and_units_of_the_state_win():
    samples, _ = record("parallel", 2)
    first = estimator_for(samples)
    first.run(samples[:3000])
    faster = replace(samples, velocity_m_s=2.0 * samples.velocity_m_s, friction_N=3.0 * samples.friction_N)
    second = estimator_for(faster)
    assert second.model.basis.reach != first.model.basis.reach
    second.restore(first.state())
    assert second.model.basis.reach == first.model.basis.reach
    assert second.model.unit_N == first.model.unit_N
    assert second.config.learned.velocity_range == first.config.learned.velocity_range
    np.testing.assert_array_equal(second.run(samples[3000:]), first.run(samples[3000:]))
    _same_state(second.state(), first.state())
    fixed = estimator_for(faster, basis__velocity_range=[-0.1, 0.1])
    with pytest.raises(ConfigError, match=r"basis\.velocity_range"):
        fixed.restore(first.state())


def test_learned_values_start_the_next_run_warm():
    samples, _ = record("parallel", 4)
    first = estimator_for(samples)
    first.run(samples)
    warm = Estimator(first.learned_config)
    np.testing.assert_array_equal(warm.parameters.theta, first.parameters.theta)
    with pytest.raises(ConfigError, match=r"learned\.fir_taps"):
        Estimator(first.config.updated({"learned.fir_taps": [1.0]}))


def test_learned_values_that_no_estimator_learned_are_refused():
    with pytest.raises(ConfigError, match=r"learned\.fir_taps\[0\]: 1e\+300 is out of range"):
        Config.from_mapping(
            {"force_unit": 5.0, "basis.velocity_range": [-0.1, 0.1], "learned.fir_taps": [1e300] + [0.0] * 8}
        )


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
@pytest.mark.parametrize("gain", [1.3, 0.7, -1.0])
def test_abrupt_change_is_followed_within_three_cycles(model_type, gain):
    samples, clean = record(model_type, 14)
    half = len(samples) // 2
    changed = replace(samples, friction_N=samples.friction_N * np.where(np.arange(len(samples)) < half, 1.0, gain))
    estimator = estimator_for(changed, model__type=model_type)
    before = estimator.run(changed[:half])
    assert estimator.health.alarmed == 0
    error = changed.friction_N - np.concatenate([before, estimator.run(changed[half:])])
    noise = abs(gain) * np.sqrt(np.mean((samples.friction_N - clean) ** 2))
    cycle = 5 * RATE
    after = np.sqrt(np.mean(error[half + 3 * cycle : half + 5 * cycle] ** 2))
    assert after < 1.2 * noise
    # What the theory's taps can take up needs no alarm.
    assert estimator.health.alarmed == 1 or (model_type == "parallel" and gain > 0.0)


@pytest.mark.parametrize("condition", ["a", "b", "c"])
@pytest.mark.parametrize("model_type", MODELS)
def test_no_alarm_while_nothing_changes(model_type, condition):
    """Not even with the simulated film's lag, which the model has no memory for."""
    period, pressure = CONDITIONS[condition]
    samples = simulate(Scenario((segment(period, pressure, 10.0),), rate_hz=1000.0, noise=0.01)).paired()
    estimator = estimator_for(samples, model__type=model_type)
    estimator.run(samples)
    assert estimator.health.alarmed == 0


@pytest.mark.parametrize("law", LAWS)
def test_standing_still_costs_nothing(law):
    """No wind-up: after ten minutes of standstill the next cycles are predicted as well as before."""
    samples, _ = record("parallel", 30)
    cycle = 5 * RATE
    estimator = estimator_for(samples, model__law=law)
    before = nrmse(samples.friction_N, estimator.run(samples))
    rng = np.random.default_rng(5)
    rest = samples_of(np.zeros(RATE * 600), 0.02 * rng.standard_normal(RATE * 600))
    estimator.run(rest)
    assert np.isfinite(estimator.parameters.theta).all()
    after = nrmse(samples.friction_N[:cycle], estimator.run(samples[:cycle]))
    assert after < 1.5 * max(before, 0.012)


@pytest.mark.parametrize("law", LAWS)
def test_what_is_not_to_be_learned_leaves_the_parameters_alone(law):
    samples, _ = record("parallel", 1)
    learn = np.ones(1000, np.bool_)
    learn[400:600] = False
    estimator, other = (estimator_for(samples, model__law=law) for _ in range(2))
    estimator.run(samples[:400], learn[:400])
    theta, root = estimator.parameters.theta, estimator.work.root.copy()
    estimator.run(samples[400:600], learn[400:600])
    np.testing.assert_array_equal(estimator.parameters.theta, theta)
    np.testing.assert_array_equal(estimator.work.root, root)
    estimator.run(samples[600:1000], learn[600:])
    other.run(samples[:1000], learn)
    np.testing.assert_array_equal(estimator.parameters.theta, other.parameters.theta)


@pytest.mark.parametrize("law", LAWS)
def test_samples_right_after_a_restart_are_learned_by_lms_only(law):
    """The delay lines are filled as if the shaft had stood there, so their errors say nothing; lms is the paper's."""
    samples, _ = record("parallel", 1)
    estimator = estimator_for(samples, model__law=law)
    order = estimator.config.fir.order
    cut = replace(samples, restart=np.isin(np.arange(len(samples)), [0, 1000]))
    estimator.run(cut[:1000])
    assert estimator.health.learned == 1000 - (0 if law == "lms" else order)
    theta = estimator.parameters.theta
    estimator.run(cut[1000 : 1000 + order])
    assert np.array_equal(estimator.parameters.theta, theta) == (law != "lms")
    estimator.run(cut[1000 + order : 1001 + order])
    assert not np.array_equal(estimator.parameters.theta, theta)


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
    assert len(drive_cycles(sine(6))) in (5, 6)


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


def test_the_numbers_do_not_depend_on_the_threads_of_the_machine():
    """Every program sets one thread itself: a process without the test's own settings gives the same numbers."""
    code = (
        "from friction_estimator.threads import one_thread; one_thread()\n"
        "import hashlib, sys; sys.path.insert(0, sys.argv[1])\n"
        "from synthetic import *; from friction_estimator.core.online.estimator import Estimator\n"
        "from friction_estimator.core.fit.batch import fit_batch\n"
        "v = sine(1); samples = samples_of(v, noisy(known_system('parallel', v))); config = config_for(samples[:200])\n"
        "estimator = Estimator(config); predicted = estimator.run(samples)\n"
        "fit = fit_batch(samples, estimator.config)\n"
        "numbers = [predicted, estimator.curve().low_N, fit.predicted_N]\n"
        "print(estimator.health.grown, *(hashlib.sha256(a.tobytes()).hexdigest() for a in numbers))"
    )
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    bare = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", code, str(Path(__file__).parent)]
    answers = [
        subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
        for env in (bare, bare | dict.fromkeys(names, "1"))
    ]
    assert answers[0] == answers[1]
    assert not answers[0].startswith("0 ")  # the range grew on the way


def test_samples_that_lie_apart_are_read_as_those_side_by_side():
    """A recording's messages hold a number each among others; its arrays may be views of them."""
    samples, _ = record("hammerstein", 2)
    spread = {
        name: np.column_stack([getattr(samples, name)] * 3)[:, 1]
        for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart")
    }
    apart = replace(samples, **spread)
    assert not apart.velocity_m_s.flags.c_contiguous
    np.testing.assert_array_equal(estimator_for(samples).run(apart, True), estimator_for(samples).run(samples, True))
