"""Bad data are forgotten, lasting changes are followed, and nothing happens where nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import MODELS, RATE, config_for, samples_of

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.online import workspace
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.units import CHOSEN_UNITS

CYCLE = round(RATE / 0.9)
ONSET = 20 * RATE
NOISE_N = 0.1


def law(velocity: np.ndarray, forward: float = 1.0) -> np.ndarray:
    """Coulomb and viscous friction, N."""
    return np.where(velocity > 0.0, forward, 1.0) * (10.0 * np.tanh(velocity / 0.002) + 50.0 * velocity)


def record(seconds: float = 30.0, seed: int = 0, forward: float = 1.0) -> Samples:
    time = np.arange(round(seconds * RATE)) / RATE
    velocity = 0.1 * np.sin(2 * np.pi * 0.9 * time + seed) + 0.02 * np.sin(2 * np.pi * 0.313 * time)
    return samples_of(
        velocity, law(velocity, forward) + NOISE_N * np.random.default_rng(seed).standard_normal(time.size)
    )


def with_offset(samples: Samples, newton: float, seconds: float) -> Samples:
    force = samples.friction_N.copy()
    force[ONSET : ONSET + round(seconds * RATE)] += newton
    return replace(samples, friction_N=force)


def stuck(samples: Samples, seconds: float) -> Samples:
    velocity = samples.velocity_m_s.copy()
    velocity[ONSET : ONSET + round(seconds * RATE)] = velocity[ONSET]
    return replace(samples, velocity_m_s=velocity)


def estimator_for(samples: Samples, model_type: str, **settings: object) -> Estimator:
    return Estimator(config_for(samples, model__type=model_type, basis__velocity_range=[-0.13, 0.13], **settings))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def in_hold(model_type: str = "parallel", **settings: object) -> tuple[Estimator, Samples, int]:
    """An estimator in the middle of a hold, the record, and the sample that comes next."""
    samples = with_offset(record(), 50.0, 1.0)
    estimator, stop = estimator_for(samples, model_type, **settings), ONSET + RATE // 2
    estimator.run(samples[:stop])
    assert estimator.health.held > 0
    return estimator, samples, stop


FAULTS = {
    "50 N for 0.1 s": (0.1, lambda samples: with_offset(samples, 50.0, 0.1)),
    "50 N for 1 s": (1.0, lambda samples: with_offset(samples, 50.0, 1.0)),
    "1 kN for 1 s": (1.0, lambda samples: with_offset(samples, 1000.0, 1.0)),
    "velocity stuck for 3 s": (3.0, lambda samples: stuck(samples, 3.0)),
    "20 N for 5 s, taken for a change meanwhile": (5.0, lambda samples: with_offset(samples, 20.0, 5.0)),
}
LONG = ("velocity stuck for 3 s", "20 N for 5 s, taken for a change meanwhile")


@pytest.mark.parametrize("model_type", MODELS)
@pytest.mark.parametrize(
    ("fault", "law_name"), [(f, "rls") for f in FAULTS] + [(f, "nlms") for f in FAULTS if f not in LONG]
)
def test_what_was_bad_is_forgotten(fault, law_name, model_type):
    clean = record(seconds=40.0)
    seconds, make = FAULTS[fault]
    bad = make(clean)
    known, estimator = (estimator_for(clean, model_type, model__law=law_name) for _ in range(2))
    usual, error = (s.friction_N - e.run(s) for s, e in ((clean, known), (bad, estimator)))
    after = slice(ONSET + round((seconds + 2.0) * RATE), None)
    assert rms(error[after]) < 1.2 * rms(usual[after])
    assert estimator.health.alarmed > 0
    assert estimator.health.restored > 0
    assert estimator.health.held == 0


@pytest.mark.parametrize("forward", [0.7, 1.3])
@pytest.mark.parametrize("model_type", MODELS)
def test_a_change_of_one_direction_is_followed_within_three_cycles(model_type, forward):
    before, after = record(), record(forward=forward)
    force = np.where(np.arange(len(before)) < ONSET, before.friction_N, after.friction_N)
    changed = replace(before, friction_N=force)
    estimator, told = (estimator_for(changed, model_type) for _ in range(2))
    error, least = force - estimator.run(changed), after.friction_N - told.run(after)
    window = slice(ONSET + 3 * CYCLE, ONSET + 5 * CYCLE)
    assert rms(error[window]) < 1.2 * max(rms(least[window]), NOISE_N)
    assert estimator.health.alarmed == 1
    assert estimator.health.restored == 0


@pytest.mark.parametrize("law_name", ["rls", "nlms", "lms"])
@pytest.mark.parametrize("model_type", MODELS)
def test_no_alarm_where_nothing_is_wrong(model_type, law_name):
    samples = record(seconds=120.0, seed=1)
    estimator = estimator_for(samples, model_type, model__law=law_name)
    estimator.run(samples)
    assert estimator.health.alarmed == 0


def test_lms_is_the_papers_and_holds_nothing():
    samples = with_offset(record(), 50.0, 1.0)
    estimator = estimator_for(samples, "hammerstein", model__law="lms")
    estimator.run(samples)
    assert estimator.health.alarmed == 0


def test_nothing_is_held_before_the_estimator_was_calm_once():
    samples = record()
    samples = replace(samples, friction_N=samples.friction_N * np.where(np.arange(len(samples)) % 400 < 200, 1.0, -3.0))
    estimator = estimator_for(samples[:900], "parallel")
    estimator.run(samples[:900])
    assert estimator.health.held == 0
    assert estimator.health.alarmed == 0


@pytest.mark.parametrize("model_type", MODELS)
def test_while_learning_is_held_the_former_model_predicts_and_says_how_wrong_it_is(model_type):
    samples = with_offset(record(), 50.0, 1.0)
    estimator = estimator_for(samples, model_type)
    estimator.run(samples[:ONSET])
    before = estimator.curve()
    bad = slice(ONSET, ONSET + RATE // 2)
    deviation = np.empty(RATE // 2)
    predicted = estimator.run(samples[bad], True, deviation)
    assert estimator.health.held > RATE // 2 - 50
    held = slice(50, None)
    true = samples.friction_N[bad] - 50.0
    assert rms((predicted - true)[held]) < 1.5 * NOISE_N
    assert np.median(deviation[held]) > 25.0
    curve = estimator.curve()
    np.testing.assert_allclose(curve.friction_N, before.friction_N, atol=0.5)
    assert np.min(curve.high_N - curve.low_N) > 50.0
    theta = estimator.parameters.theta
    estimator.run(samples[ONSET + RATE // 2 : ONSET + RATE // 2 + 50])
    np.testing.assert_array_equal(estimator.parameters.theta, theta)


@pytest.mark.parametrize("law_name", ["rls", "nlms"])
def test_through_a_hold_arrays_single_samples_and_restored_states_agree_bit_for_bit(law_name):
    samples = with_offset(record(seconds=24.0), 50.0, 1.0)
    whole, single, first = (estimator_for(samples, "parallel", model__law=law_name) for _ in range(3))
    expected = whole.run(samples)
    begin, stop = ONSET - 50, ONSET + RATE // 2
    single.run(samples[:begin])
    steps = [single.run(samples[k : k + 1])[0] for k in range(begin, len(samples))]
    np.testing.assert_array_equal(steps, expected[begin:])
    first.run(samples[:stop])
    assert first.health.held > 0
    state = first.state()
    second = estimator_for(samples, "parallel", model__law=law_name)
    second.restore(state)
    assert second.health == first.health
    np.testing.assert_array_equal(second.run(samples[stop:]), expected[stop:])
    for name, array in whole.state()["arrays"].items():
        np.testing.assert_array_equal(array, second.state()["arrays"][name], err_msg=name)


def test_the_range_may_grow_while_learning_is_held():
    samples = with_offset(record(), 50.0, 1.0)
    velocity = samples.velocity_m_s.copy()
    velocity[ONSET + 100 : ONSET + 200] *= 3.0
    samples = replace(samples, velocity_m_s=velocity)
    start = config_for(samples[:ONSET], model__type="parallel")
    estimator = Estimator(start)
    predicted = estimator.run(samples)
    assert estimator.health.grown > 0
    late = slice(ONSET + 4 * RATE, None)
    assert rms((samples.friction_N - predicted)[late]) < 1.3 * NOISE_N


def test_given_parameters_end_a_hold():
    estimator, samples, stop = in_hold()
    estimator.parameters = estimator.parameters
    assert estimator.health.held == 0
    assert np.isfinite(estimator.run(samples[stop:])).all()


@pytest.mark.parametrize(("array", "place", "value"), [("hold", workspace.HOLDING, 2.0), ("trial", (0, 0), -1.0)])
def test_a_state_with_an_impossible_hold_is_refused(array, place, value):
    estimator, samples, _ = in_hold()
    state = estimator.state()
    state["arrays"][array][place] = value
    with pytest.raises(ConfigError, match=array):
        estimator_for(samples, "parallel").restore(state)


def test_a_state_that_holds_a_model_it_lacks_is_refused():
    estimator, samples, _ = in_hold()
    for name in ("kept", "kept_root"):
        state = estimator.state()
        state["arrays"][name][:] = 0.0
        with pytest.raises(ConfigError, match=name):
            estimator_for(samples, "parallel").restore(state)


def test_a_state_of_version_3_is_read_and_goes_on():
    samples = with_offset(record(), 50.0, 1.0)
    estimator = estimator_for(samples, "parallel")
    estimator.run(samples[: ONSET // 2])
    state = estimator.state()
    for name in ("kept", "kept_root", "trial", "hold"):
        del state["arrays"][name]
    state["chosen"] = {name: state["chosen"][name] for name in CHOSEN_UNITS}
    state["arrays"]["moments"] = np.insert(state["arrays"]["moments"], [1, 1, 3], [1e-4, 1e-4, 0.0])
    other = estimator_for(samples, "parallel")
    other.restore(state | {"version": 3})
    np.testing.assert_array_equal(other.run(samples[ONSET // 2 : ONSET]), estimator.run(samples[ONSET // 2 : ONSET]))
    other.run(samples[ONSET:])
    assert other.health.restored == 1
