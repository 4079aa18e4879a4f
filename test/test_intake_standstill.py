"""A standing shaft is known as such, a slow passage through zero is not taken for one, nothing is learned from rest."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import samples_of, stribeck

from friction_estimator.core.intake.standstill import (
    CREEP_SHARE,
    STATE_SIZE,
    WITHOUT_POSITION,
    stands,
    standstill,
    stays,
)
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import Config

RATE_HZ = 200


def strokes(seconds=30.0, rate_hz=RATE_HZ):
    """Velocity with pauses between strokes, and where it pauses."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    wave = np.sin(2 * np.pi * t / 5.0)
    rests = np.abs(wave) < 0.5
    return np.where(rests, 0.0, wave), rests


def resting(velocity, scale=1.0):
    return standstill(samples_of(velocity, velocity), scale)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 1e-2])
def test_pauses_are_found_from_their_first_sample_whatever_the_noise(noise):
    velocity, rests = strokes()
    found = resting(velocity + noise * np.random.default_rng(0).standard_normal(velocity.size))
    assert found[rests].mean() > 0.98
    assert found[~rests].mean() < 1e-3


@settings(max_examples=40, deadline=None)
@given(
    period_s=st.floats(0.2, 100.0),
    rate_hz=st.sampled_from([50, 200, 1000]),
    noise=st.sampled_from([0.0, 1e-4, 1e-3, 1e-2]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_sine_passes_through_zero_and_never_stands(period_s, rate_hz, noise, seed):
    """What is slower than twice the noise of its channel may be rest for all that the channel shows."""
    t = np.arange(int(min(3 * period_s, 60.0) * rate_hz)) / rate_hz
    true = np.sin(2 * np.pi * t / period_s + 0.5)
    velocity = true + noise * np.random.default_rng(seed).standard_normal(t.size)
    unknown = np.count_nonzero(np.abs(true) < 2.0 * noise)
    assert np.count_nonzero(resting(velocity)) <= 0.002 * t.size + unknown


def test_creep_is_motion():
    velocity, rests = strokes()
    for creep, noise in ((0.001, 0.0), (0.005, 1e-3), (-0.02, 1e-2)):
        moving = np.where(rests, creep, velocity)
        assert not resting(moving + noise * np.random.default_rng(1).standard_normal(rests.size))[rests].mean() > 0.02


def test_a_quantised_channel_without_a_level_at_zero_stands_too():
    """Levels at +-1/2 and +-3/2 steps: at rest it flickers between them."""
    velocity, rests = strokes()
    step = 0.005
    noisy = velocity + 0.4 * step * np.random.default_rng(2).standard_normal(rests.size)
    shown = (np.floor(noisy / step) + 0.5) * step
    found = resting(shown)
    assert found[rests].mean() > 0.95
    assert found[~rests].mean() < 0.005


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-6, 1e6), st.integers(0, 2**32 - 1))
def test_units_of_speed_do_not_matter(unit, seed):
    velocity, _ = strokes(10.0)
    velocity = velocity + 1e-3 * np.random.default_rng(seed).standard_normal(velocity.size)
    np.testing.assert_array_equal(resting(unit * velocity, unit), resting(velocity))


def test_the_rule_is_causal():
    velocity, _ = strokes(10.0)
    state = np.zeros(STATE_SIZE)
    whole = [stands(state, v, k == 0, 1.0) for k, v in enumerate(velocity)]
    state = np.zeros(STATE_SIZE)
    half = [stands(state, v, k == 0, 1.0) for k, v in enumerate(velocity[:1000])]
    assert whole[:1000] == half
    assert any(whole)


# The position


def travelled(velocity):
    return np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]))]) / RATE_HZ


def causal(samples, scale=1.0):
    """Whether the shaft stands, sample by sample."""
    state = np.zeros(STATE_SIZE)
    out = []
    for k, v in enumerate(samples.velocity_m_s):
        steady = stays(state, samples.position_m[k], v, samples.restart[k], scale)
        out.append(stands(state, v, samples.restart[k], scale) or steady)
    return np.array(out)


@pytest.mark.parametrize("channel", [{"offset": 0.0015}, {"offset": -0.0015}, {"step": 0.0022}])
def test_a_velocity_that_never_shows_rest_is_overruled_by_the_position(channel):
    """A shaft that has not moved yet, then strokes with pauses; a ramp of the load bends it by a count now and then."""
    velocity, rests = strokes()
    still = np.zeros(400)
    true, stood = np.concatenate([still, velocity]), np.concatenate([still == 0.0, rests])
    position = travelled(true) + 1e-4 * np.floor(np.cumsum(stood) / 70.0)
    shown = true + channel.get("offset", 0.0)
    if "step" in channel:  # no level at zero
        shown = (np.floor(shown / channel["step"]) + 0.5) * channel["step"]
    shown[150] += 0.01  # a spike ends no rest either
    samples = replace(samples_of(shown, shown, RATE_HZ), position_m=np.round(position / 1e-4) * 1e-4)
    found, as_it_goes = standstill(samples, 1.0), causal(samples)
    assert found[stood].mean() > 0.98
    assert found[~stood].mean() < 0.003
    assert as_it_goes[:400].mean() > 0.95
    assert as_it_goes[stood].mean() > 0.9
    assert as_it_goes[~stood].mean() < 0.003
    state = np.zeros(STATE_SIZE)
    alone = [stands(state, v, k == 0, 1.0) for k, v in enumerate(shown[:400])]
    assert not any(alone), "the velocity alone tells nothing at first"


@settings(max_examples=60, deadline=None)
@given(
    speed=st.floats(1e-3, 1.0),
    count=st.sampled_from([0.0, 1e-6, 1e-4, 1e-2, 0.3, np.inf]),
    gain=st.sampled_from([-1.0, 0.02, 0.6, 1.0, 57.0]),
    every=st.sampled_from([1, 7, 40]),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_position_overrules_a_velocity_that_is_more_than_next_to_nothing(speed, count, gain, every, seed):
    """Coarse counts, one that is read now and then, other units, none but zeros."""
    t = np.arange(4000) / RATE_HZ
    true = np.where(t < 4.0, 1.0, speed) * np.sin(2 * np.pi * t / 4.0 + np.random.default_rng(seed).uniform(0, 6))
    position = np.zeros(4000) if count == np.inf else travelled(true) / gain
    position = np.round(position / count) * count if 0.0 < count < np.inf else position
    samples = replace(samples_of(true, true, RATE_HZ), position_m=position[np.arange(4000) // every * every])
    without = standstill(replace(samples, position_m=None), 1.0)
    more = np.flatnonzero(standstill(samples, 1.0) & ~without)
    # Two samples that are faster end no rest: a spike is none.
    assert np.abs(true)[more].max(initial=0.0) <= CREEP_SHARE + 2.0 * np.abs(np.diff(true)).max()
    if count == 0.0 and every == 1:
        assert not more.size


def test_a_state_of_a_former_version_is_read():
    """It knew nothing of the position."""
    velocity, rests = strokes(10.0)
    samples = samples_of(0.1 * velocity, np.where(rests, 1.0, np.sign(velocity)))
    config = Config.from_mapping({"theory.kind": "seal", "basis.velocity_range": [-0.11, 0.11], "force_unit": 1.0})
    first, second = Estimator(config), Estimator(config)
    first.run(samples[:1000])
    state = first.state()
    state["arrays"]["rest"] = state["arrays"]["rest"][:WITHOUT_POSITION]
    second.restore(state)
    np.testing.assert_array_equal(second.run(samples[1000:]), first.run(samples[1000:]))


# The estimator


@pytest.mark.parametrize("law", ["rls", "nlms", "lms"])
def test_torque_ramps_on_a_stuck_shaft_teach_nothing_and_are_predicted(law):
    velocity, rests = strokes(20.0)
    velocity = 0.1 * velocity
    friction = stribeck(velocity)
    ramps = 2.0 + np.sin(2 * np.pi * np.arange(velocity.size) / 700.0)
    config = Config.from_mapping(
        {"model.law": law, "theory.kind": "seal", "basis.velocity_range": [-0.11, 0.11], "force_unit": 4.0}
    )
    quiet, stuck = Estimator(config), Estimator(config)
    quiet.run(samples_of(velocity, friction))
    predicted = stuck.run(samples_of(velocity, np.where(rests, ramps, friction)))
    assert np.isfinite(predicted).all()
    assert stuck.health.stood > 0.9 * np.count_nonzero(rests)
    assert stuck.health.samples == velocity.size
    assert stuck.health.learned <= velocity.size - stuck.health.stood
    at = np.linspace(-0.1, 0.1, 81)
    ours, theirs = (e.curve(velocity_m_s=at).friction_N for e in (stuck, quiet))
    # What is left of the first sample of each pause, which is learned from (9 N at standstill where all are).
    moving = np.abs(at) > 0.04
    assert np.abs(ours - theirs)[moving].max() < (0.01 if law == "rls" else 0.2)
    if law == "rls":
        assert np.abs(ours - theirs).max() < 0.5


def test_standstill_goes_with_the_state():
    velocity, rests = strokes(20.0)
    samples = samples_of(0.1 * velocity, np.where(rests, 1.0, np.sign(velocity)))
    config = Config.from_mapping({"theory.kind": "seal", "basis.velocity_range": [-0.11, 0.11], "force_unit": 1.0})
    whole, first, second = Estimator(config), Estimator(config), Estimator(config)
    expected = whole.run(samples)
    middle = int(np.flatnonzero(rests)[-40])
    first.run(samples[:middle])
    second.restore(first.state())
    np.testing.assert_array_equal(second.run(samples[middle:]), expected[middle:])
    assert second.health == whole.health
