"""One sample at a time gives what a pass over the recording gives, bit for bit, first contact and growth included."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online.estimator import Estimator, stated_config
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.settings.config import Config

NS = 10**9
FIXED = {"theory.kind": "seal", "basis.velocity_range": [-0.15, 0.15], "force_unit": 10.0}


def events(seed, count=400):
    """Return (stream, stamp_ns, value) with the disorder of real topics."""
    rng = np.random.default_rng(seed)
    stamps = 10**18 + np.cumsum(rng.choice([5, 5, 5, 5, 5, 200, 2000], count)) * 10**6
    stamps[count // 2 :] -= 3 * 10**9  # a bag loops
    rows = []
    for k, stamp in enumerate(stamps):
        velocity = 0.2 * np.sin(0.05 * k)  # leaves the range of 0.15 m/s
        values = [velocity, 20.0 * velocity + rng.standard_normal()]
        if rng.random() < 0.05:
            values[rng.integers(2)] = rng.choice([np.nan, np.inf, 1e300])
        pair = [(0, stamp, values[0]), (1, stamp, values[1])]
        if rng.random() < 0.2:
            pair.reverse()
        if rng.random() < 0.1:
            pair.pop()
        if rng.random() < 0.1:
            pair.append(pair[-1])
        if rng.random() < 0.1:
            pair.append((rng.integers(2, 5), stamp, rng.uniform(0.0, 1e6)))
        rows += pair
    for place in rng.integers(0, len(rows) - 1, 40):
        rows[place], rows[place + 1] = rows[place + 1], rows[place]
    stream, stamp, value = zip(*rows, strict=True)
    return np.array(stream, np.int64), np.array(stamp, np.int64), np.array(value)


def pairs(velocity, friction, rate_hz=200.0):
    """Return (stream, stamp_ns, value) of steady pairs."""
    stamps = 10**18 + (np.arange(velocity.size) * NS / rate_hz).astype(np.int64)
    return np.tile([0, 1], stamps.size), np.repeat(stamps, 2), np.stack([velocity, friction], 1).ravel()


def friction_of(velocity, rng):
    return 4.0 * np.tanh(velocity / 0.004) + 12.0 * velocity + 0.02 * rng.standard_normal(velocity.size)


def replayed(config, stream, stamp, value):
    """Return (samples, predicted, deviation, estimator) as replay makes them."""
    samples = Intake(config).push(stream, stamp, value)
    met = meet(config, samples)
    estimator = Estimator(met.config)
    deviation = np.empty(len(samples))
    return samples, estimator.run(samples, True, deviation), deviation, estimator


def lived(step, stream, stamp, value, seed, most=None):
    """Push the events in small bunches; return the predictions."""
    rng = np.random.default_rng(seed)
    found, at = [], 0
    while at < stream.size:
        count = min(int(rng.choice([1, 2, 2, 3, 20])), stream.size - at)
        part = slice(at, at + count)
        step.stream[:count], step.stamp_ns[:count], step.value[:count] = stream[part], stamp[part], value[part]
        new = step.run(count, learn=True, most=most)
        assert most is None or len(new) <= max(most, count)
        found += new
        at += count
    return found + step.work_off(learn=True)


def check_equal(found, step, samples, predicted, deviation, estimator):
    assert [row[0] for row in found] == samples.stamp_ns.tolist()
    assert [row[1] for row in found] == samples.velocity_m_s.tolist()
    assert [row[2] for row in found] == samples.friction_N.tolist()
    np.testing.assert_array_equal([row[3] for row in found], predicted)
    np.testing.assert_array_equal([row[4] for row in found], deviation)
    assert step.estimator.config == estimator.config
    assert step.estimator.health == estimator.health
    ours, theirs = step.estimator.state(), estimator.state()
    for name, array in theirs.pop("arrays").items():
        np.testing.assert_array_equal(ours["arrays"][name], array, err_msg=name)
    del ours["arrays"]
    assert ours == theirs


@pytest.mark.parametrize("model", ["parallel", "hammerstein"])
@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
@settings(deadline=None, max_examples=8)
@given(
    seed=st.integers(0, 10**6),
    sign=st.sampled_from([1, -1]),
    slop=st.sampled_from([0.0, 0.002]),
    unit=st.sampled_from([{}, FIXED, FIXED | {"force_unit": 5e3}]),  # at 5 kN the theoretical curve is scaled
)
def test_live_equals_offline(model, law, seed, sign, slop, unit):
    given_values = {"input.friction_sign": sign, "sync.slop": slop, **unit}
    config = Config.from_mapping({"model.type": model, "model.law": law, **given_values})
    recording = events(seed)
    expected = replayed(config, *recording)
    step = LiveStep(Intake(config), config)
    check_equal(lived(step, *recording, seed), step, *expected)


@pytest.mark.parametrize("most", [None, 7])
@pytest.mark.parametrize("law", ["rls", "nlms", "lms"])
def test_a_minute_of_noisy_standstill_comes_first(law, most):
    rng = np.random.default_rng(3)
    still, moving = 60 * 200, 20 * 200
    velocity = np.concatenate([np.zeros(still), 0.3 * np.sin(2 * np.pi * 0.5 * np.arange(moving) / 200)])
    velocity += 1e-3 * rng.standard_normal(velocity.size)
    config = Config.from_mapping({"model.law": law})
    recording = pairs(velocity, friction_of(velocity, rng))
    samples, *expected = replayed(config, *recording)
    contact = meet(config, samples)
    assert contact.ended
    assert still < contact.samples < still + 3 * 200, "standing still does not end it, the first period does"
    assert contact.config.reach[1] > 0.25
    step = LiveStep(Intake(config), config)
    check_equal(lived(step, *recording, 3, most), step, samples, *expected)
    assert step.contact is None
    assert step.behind == 0


@pytest.mark.parametrize("model", ["parallel", "hammerstein"])
def test_a_range_that_grows_fourfold(model):
    rng = np.random.default_rng(4)
    time = np.arange(60 * 200) / 200
    velocity = np.interp(time, [0, 15, 45, 60], [0.1, 0.1, 0.4, 0.4]) * np.sin(2 * np.pi * 0.7 * time)
    friction = friction_of(velocity, rng)
    config = Config.from_mapping({"model.type": model})
    expected = replayed(config, *pairs(velocity, friction))
    estimator = expected[-1]
    assert estimator.health.grown > 0
    assert estimator.config.reach[1] > 0.38
    step = LiveStep(Intake(config), config)
    found = lived(step, *pairs(velocity, friction), 4)
    check_equal(found, step, *expected)
    settled = 20 * 200
    error = np.array([row[2] - row[3] for row in found])
    assert np.abs(error[settled:]).max() < np.abs(friction).max(), "no jump above the peak friction"


def test_until_the_first_contact_has_ended_samples_wait():
    config = Config()
    step = LiveStep(Intake(config), config)
    recording = pairs(np.zeros(100), np.ones(100))
    assert lived(step, *recording, 0) == []
    assert step.estimator is None
    assert len(step.contact) == 100


def test_a_state_ends_the_wait_and_what_waited_is_predicted_by_it():
    rng = np.random.default_rng(5)
    velocity = 0.2 * np.sin(2 * np.pi * np.arange(2000) / 200)
    config = Config()
    *_, first = replayed(config, *pairs(velocity, friction_of(velocity, rng)))
    state = first.state()

    step = LiveStep(Intake(config), config)
    recording = pairs(velocity[:60], friction_of(velocity[:60], rng))
    assert lived(step, *recording, 0) == []
    again = Estimator(stated_config(config, state))
    again.restore(state)
    step.begin(again)
    found = step.work_off(25, learn=True)
    assert len(found) == 25
    assert step.behind == 35
    found += step.work_off(learn=True)
    samples = Intake(config).push(*recording)
    np.testing.assert_array_equal([row[3] for row in found], first.run(samples))
