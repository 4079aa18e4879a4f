"""First contact: one causal rule for units and range, whatever comes first and however it is cut."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import samples_of, stribeck

from friction_estimator.core.online import first_contact
from friction_estimator.core.online.first_contact import FirstContact, meet
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings import units
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import chosen, rest_noise, robust_top, shown

RATE = 1000.0
OPEN = Config()


def sine(seconds: float, rate_hz: float = RATE, top: float = 0.1, period_s: float = 1.0) -> Samples:
    """An eccentric that starts from rest."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    velocity = top * np.sin(2.0 * np.pi * t / period_s)
    return samples_of(velocity, stribeck(velocity * 0.1 / top), rate_hz)


def standstill(seconds: float, rate_hz: float = RATE, noise: float = 1e-3, seed: int = 0) -> Samples:
    generator = np.random.default_rng(seed)
    count = int(seconds * rate_hz)
    return samples_of(noise * generator.standard_normal(count), 0.05 * generator.standard_normal(count), rate_hz)


def after(first: Samples, second: Samples) -> Samples:
    """One stream: the second follows the first without a gap."""
    later = replace(second, stamp_ns=second.stamp_ns + first.stamp_ns[-1], restart=np.zeros(len(second), np.bool_))
    return in_sequence([first, later])


def ended_at(samples: Samples) -> int:
    contact = meet(OPEN, samples)
    assert contact.ended
    return contact.samples


def chosen_values(config: Config) -> tuple[object, ...]:
    return config.reach, config.velocity_scale, config.unit_N


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 700), max_size=8), st.sampled_from([48.0, 1000.0]))
def test_how_the_stream_is_cut_changes_nothing(cuts, rate_hz):
    whole = after(standstill(1.0, rate_hz), sine(3.0, rate_hz))
    expected = meet(OPEN, whole)
    contact = FirstContact(OPEN)
    edges = [*np.minimum(np.cumsum([0, *cuts]), len(whole)).tolist(), len(whole)]
    found = None
    for begin, end in pairwise(edges):
        found = contact.push(whole[begin:end])
        if found is not None:
            break
    assert found == expected.config
    assert contact.chosen_from == expected.samples
    np.testing.assert_array_equal(contact.queue().stamp_ns, whole.stamp_ns[: len(contact)])


def test_one_sample_at_a_time_ends_at_the_same_sample_with_the_same_queue():
    whole = after(standstill(0.5), sine(2.0))
    expected = meet(OPEN, whole)
    contact = FirstContact(OPEN)
    for k in range(len(whole)):
        found = contact.push(whole[k : k + 1])
        if found is not None:
            break
    assert found == expected.config
    assert len(contact) == contact.chosen_from == expected.samples == k + 1
    waited = contact.queue()
    for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart"):
        np.testing.assert_array_equal(getattr(waited, name), getattr(whole, name)[: k + 1])


@pytest.mark.parametrize("noise", [1e-5, 1e-3, 0.1])
def test_a_minute_of_noisy_standstill_does_not_end_it(noise):
    contact = meet(OPEN, standstill(60.0, noise=noise))
    assert not contact.ended
    assert contact.samples == 60_000


def test_standing_still_changes_nothing_of_what_is_chosen_but_for_its_own_noise():
    moving = sine(3.0)
    direct, waited = (meet(OPEN, s).config for s in (moving, after(standstill(60.0, noise=1e-4), moving)))
    assert waited.velocity_scale == pytest.approx(direct.velocity_scale, rel=0.02)
    assert waited.reach == pytest.approx(direct.reach, rel=0.02)
    assert waited.unit_N == pytest.approx(direct.unit_N, rel=0.2)


@pytest.mark.parametrize("rate_hz", [48.0, 200.0, 1000.0, 5000.0])
def test_two_reversals_end_it_whatever_the_rate(rate_hz):
    """sin starts upwards: the shaft has turned twice, and gone 30 % of its speed again, after 1.05 periods."""
    seconds = ended_at(sine(20.0, rate_hz, period_s=3.0)) / rate_hz
    assert 1.0 * 3.0 < seconds < 1.15 * 3.0 + 2.0 * first_contact.FIRST_LOOK / rate_hz


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_one_direction_ends_it_after_ten_seconds_of_motion(sign):
    start = np.minimum(np.arange(20_000) / 2000.0, 1.0)
    velocity = sign * 0.05 * start
    contact = meet(OPEN, samples_of(velocity, 3.0 * np.sign(velocity), RATE))
    assert contact.ended
    assert 10.0 < contact.samples / RATE < 10.8
    low, high = contact.config.reach
    assert (high if sign > 0 else -low) == pytest.approx(1.05 * 0.05, rel=1e-6)
    assert (-low if sign > 0 else high) == pytest.approx(0.05 * contact.config.velocity_scale)


def test_pauses_do_not_count_as_motion():
    push = samples_of(np.full(1000, 0.05), np.full(1000, 3.0), RATE)
    rest = standstill(1.0, noise=1e-4)
    stream = push
    for _ in range(8):
        stream = after(after(stream, rest), push)
    assert not meet(OPEN, stream).ended  # 17 s, of which 9 in motion
    for _ in range(2):
        stream = after(after(stream, rest), push)
    assert meet(OPEN, stream).ended


def test_noise_at_speed_is_no_reversal():
    """It turns the sign of a slow velocity a hundred times, but never by 30 % of the largest speed."""
    generator = np.random.default_rng(1)
    slow = np.concatenate([np.full(500, 0.1), np.full(4000, 0.001)]) + 0.002 * generator.standard_normal(4500)
    assert not meet(OPEN, samples_of(slow, np.sign(slow), RATE)).ended


@pytest.mark.parametrize("place", [10, 100, 400, 900])
@pytest.mark.parametrize("wild", [-0.5, 0.5, -40.0, 1e6])
def test_single_wild_velocities_do_not_decide_the_scale(place, wild):
    samples = sine(3.0)
    disturbed = samples.velocity_m_s.copy()
    disturbed[place] = wild
    plain, other = meet(OPEN, samples), meet(OPEN, replace(samples, velocity_m_s=disturbed))
    assert other.config.velocity_scale == pytest.approx(plain.config.velocity_scale, rel=0.05)
    assert other.config.reach == pytest.approx(plain.config.reach, rel=0.05)
    assert other.samples == plain.samples  # nor is it a reversal


def test_spikes_of_friction_do_not_decide_the_unit():
    samples = sine(3.0)
    spiked = samples.friction_N.copy()
    spiked[::101] = 1e7
    plain, other = meet(OPEN, samples), meet(OPEN, replace(samples, friction_N=spiked))
    assert other.config.unit_N == pytest.approx(plain.config.unit_N, rel=0.15)


def test_values_that_are_not_finite_are_passed_over():
    samples = sine(3.0)
    friction, velocity = samples.friction_N.copy(), samples.velocity_m_s.copy()
    friction[::7], velocity[3::11] = np.nan, np.inf
    config = chosen(OPEN, velocity, friction)
    assert config.velocity_scale == pytest.approx(0.105, rel=0.01)
    assert config.unit_N == pytest.approx(chosen(OPEN, samples.velocity_m_s, samples.friction_N).unit_N, rel=0.01)


def test_what_is_given_is_kept():
    samples = sine(3.0)
    plain = meet(OPEN, samples).config
    fixed = meet(OPEN.updated({"basis.velocity_range": [-0.3, 0.2]}), samples).config
    assert fixed.learned.velocity_range == ()
    assert chosen_values(fixed) == ((-0.3, 0.2), 0.3, plain.unit_N)
    scaled = meet(OPEN.updated({"force_unit": 12.0}), samples).config
    assert scaled.learned.force_unit == 0.0
    assert chosen_values(scaled) == (plain.reach, plain.velocity_scale, 12.0)
    both = OPEN.updated({"force_unit": 12.0, "basis.velocity_range": [-0.3, 0.2]})
    for known in (both.updated({"theory.kind": "seal"}), both.updated({"model.type": "hammerstein"})):
        contact = meet(known, samples)
        assert (contact.config, contact.samples, contact.dropped, contact.ended) == (known, 0, 0, True)


def test_what_was_learned_wins_over_the_rule():
    first = meet(OPEN, sine(3.0)).config
    assert meet(first, sine(3.0, top=7.0)).config is first
    assert chosen(first, np.full(100, 9.0), np.full(100, 99.0)) == first


def test_a_queue_that_is_full_lets_the_oldest_go(monkeypatch):
    monkeypatch.setattr(first_contact, "LARGEST_QUEUE", 2**12)
    stream = after(standstill(20.0), sine(3.0))
    expected = meet(OPEN, stream)
    assert expected.ended
    assert expected.dropped > 0
    assert expected.dropped % 2**10 == 0
    contact, longest, pushed = FirstContact(OPEN), 0, 0
    for begin in range(0, len(stream), 97):
        part = stream[begin : begin + 97]
        found, pushed = contact.push(part), pushed + len(part)
        longest = max(longest, len(contact))
        if found is not None:
            break
    assert found == expected.config
    assert contact.dropped == expected.dropped
    assert len(contact) + contact.dropped == pushed
    assert longest <= 2**12 + 97
    np.testing.assert_array_equal(contact.queue().stamp_ns, stream.stamp_ns[contact.dropped : pushed])


@pytest.mark.parametrize("count", [0, 1, 2, 31, 32, 500])
def test_a_record_that_ends_first_gives_a_usable_configuration(count):
    contact = meet(OPEN, sine(1.0)[:count])
    assert not contact.ended
    assert contact.samples == count
    assert contact.config.is_met
    low, high = contact.config.reach
    assert low < 0.0 < high


@pytest.mark.parametrize(("velocity", "friction"), [(0.0, 0.0), (0.0, 5.0), (0.1, 0.0)])
def test_where_nothing_moves_or_nothing_resists_the_units_are_fallbacks(velocity, friction):
    config = chosen(OPEN, np.full(50, velocity), np.full(50, friction))
    assert config.velocity_scale == pytest.approx(1.05 * velocity or units.NO_VELOCITY)
    assert config.unit_N == (friction or units.NO_FORCE)


@pytest.mark.parametrize("step", [0.0, 1e-3, 0.01])
def test_quantised_velocities_with_dwells_end_it(step):
    """Their second differences are zero for the most part, so no noise is seen; still it is motion that ends it."""
    samples = sine(4.0)
    velocity = step * np.round(samples.velocity_m_s / step) if step else samples.velocity_m_s
    velocity = np.repeat(velocity[::8], 8)
    held = replace(samples, velocity_m_s=velocity)
    assert rest_noise(held) == 0.0
    contact = meet(OPEN, held)
    assert contact.ended
    assert contact.samples / RATE < 1.3
    assert contact.config.velocity_scale == pytest.approx(0.105, rel=0.05)


@settings(max_examples=25, deadline=None)
@given(st.floats(-6.0, 4.0), st.floats(-6.0, 4.0))
def test_units_scale_with_the_recording(velocity_decades, force_decades):
    samples = after(standstill(0.5), sine(3.0))
    v, f = 10.0**velocity_decades, 10.0**force_decades
    scaled = replace(samples, velocity_m_s=v * samples.velocity_m_s, friction_N=f * samples.friction_N)
    one, other = meet(OPEN, samples), meet(OPEN, scaled)
    assert other.samples == one.samples
    assert other.config.reach == pytest.approx(tuple(v * end for end in one.config.reach))
    assert other.config.velocity_scale == pytest.approx(v * one.config.velocity_scale)
    assert other.config.unit_N == pytest.approx(f * one.config.unit_N)


@given(st.integers(0, 10**6), st.integers(100, 3000), st.floats(3.0, 1e9))
def test_the_robust_top_is_the_largest_speed_unless_it_stands_alone(seed, count, factor):
    speed = np.random.default_rng(seed).uniform(1e-3, 1.0, count)
    top = robust_top([speed])
    assert 0.0 < top <= speed.max()
    wild = np.append(speed, factor * speed.max())
    assert robust_top([wild]) <= speed.max()


@pytest.mark.parametrize("noise", [1e-6, 1e-3, 1.0])
def test_noise_of_rest_is_found_beside_a_motion(noise):
    samples = after(standstill(2.0, noise=noise), sine(2.0, top=10.0 * noise))
    assert rest_noise(standstill(2.0, noise=noise)) == pytest.approx(noise, rel=0.1)
    assert rest_noise(samples) < 1.1 * noise
    gaps = replace(samples, restart=np.ones(len(samples), np.bool_))
    assert rest_noise(gaps) == 0.0
    assert not shown(samples[:2000])


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_the_levels_next_to_zero_of_a_quantised_channel_are_no_motion(offset):
    """A motor's velocity in steps of 0.02: at rest it shows two levels, for longer than a slow drive would need."""
    rng = np.random.default_rng(4)
    step = 0.02
    rest = standstill(20.0)
    levels = step * (np.round(rng.normal(0.0, 0.6, len(rest)).clip(-1.0, 1.0)) + offset)
    contact = meet(OPEN, after(replace(rest, velocity_m_s=levels), sine(4.0, top=1.0)))
    assert contact.ended
    assert contact.samples > len(rest)
    assert contact.config.velocity_scale > 0.3
