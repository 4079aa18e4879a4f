"""Pairing by stamp and admission in time order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, PRESSURE, VELOCITY, Pairer, Sequencer
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import SyncConfig

MS = 1_000_000


def push_all(intake: Intake, events):
    """Push (stream, stamp_ms, value) one at a time; return used stamps in ms, and the samples."""
    out = [intake.push(stream, stamp * MS, value) for stream, stamp, value in events]
    return [int(s // MS) for part in out for s in part.stamp_ns]


def both(stamps):
    return [event for t in stamps for event in ((VELOCITY, t, 0.1 * t), (FRICTION, t, 1.0 * t))]


def test_equal_stamps_are_joined_whatever_the_interleaving():
    intake = Intake(Config())
    events = [(VELOCITY, t, t) for t in (1, 2, 3)] + [(FRICTION, t, -t) for t in (1, 2, 3)]
    assert push_all(intake, events) == [1, 2, 3]
    assert intake.counts == {"used": 3}


def test_a_lost_message_costs_one_sample():
    intake = Intake(Config())
    assert push_all(intake, [e for e in both(range(1, 8)) if e[:2] != (FRICTION, 4)]) == [1, 2, 3, 5, 6, 7]
    assert intake.counts == {"used": 6, "unmatched": 1}


def test_duplicate_zero_and_late_stamps_are_counted_under_their_reason():
    intake = Intake(Config())
    assert push_all(intake, both([1, 2, 2, 0, 3, 5, 4, 6])) == [1, 2, 3, 5, 6]
    assert intake.counts == {"used": 5, "duplicate_stamp": 1, "zero_stamp": 1, "backward_stamp": 1}


def test_a_repeated_message_of_one_stream_only_is_a_duplicate():
    intake = Intake(Config())
    events = [(VELOCITY, 1, 0), (FRICTION, 1, 0), (VELOCITY, 1, 0), (VELOCITY, 2, 0), (FRICTION, 2, 0)]
    assert push_all(intake, events) == [1, 2]
    assert intake.counts == {"used": 2, "duplicate_stamp": 1}


@pytest.mark.parametrize("absurd", [np.inf, -np.inf, 1e308, -2e12])
def test_magnitudes_that_no_sensor_reads_are_refused_as_infinite(absurd):
    intake = Intake(Config())
    events = [(VELOCITY, 1, absurd), (FRICTION, 1, 1.0), (VELOCITY, 2, 0.1), (FRICTION, 2, absurd), *both([3])]
    assert push_all(intake, events) == [3]
    assert intake.counts == {"used": 1, "infinite": 2}


@pytest.mark.parametrize("absurd", [np.nan, np.inf, 1e308, -2e12])
def test_a_held_channel_passes_over_them(absurd):
    intake = Intake(Config())
    for stream, value in ((PRESSURE, absurd), (POSITION, 0.25), (POSITION, absurd), (VELOCITY, 0.1)):
        intake.push(stream, MS, value)
    samples = intake.push(FRICTION, MS, 1.0)
    assert np.isnan(samples.pressure_Pa[0])
    assert samples.position_m[0] == 0.25


def test_magnitudes_whose_squares_underflow_are_zero():
    intake = Intake(Config())
    intake.push(VELOCITY, MS, -1e-300)
    samples = intake.push(FRICTION, MS, 5e-324)
    assert (samples.velocity_m_s[0], samples.friction_N[0]) == (0.0, 0.0)
    intake.push(VELOCITY, 2 * MS, -1e-29)
    samples = intake.push(FRICTION, 2 * MS, 1e-29)
    assert (samples.velocity_m_s[0], samples.friction_N[0]) == (-1e-29, 1e-29)


def test_bag_loop_keeps_every_sample_and_restarts():
    intake = Intake(Config())
    stamps = [*range(1, 3001), *range(1, 3001)]
    used = push_all(intake, both(stamps))
    assert used == stamps
    assert intake.sequencer.jumps == 1


def test_bag_loop_survives_topics_that_wrap_at_different_moments():
    intake = Intake(Config())
    events = [*both(range(1, 2001)), (VELOCITY, 2001, 0), (VELOCITY, 1, 0), (FRICTION, 2001, 0), (FRICTION, 1, 0)]
    assert push_all(intake, events)[-2:] == [2001, 1]
    assert intake.counts == {"used": 2002}


@pytest.mark.parametrize("wild", [10**9, 1])
def test_one_wild_stamp_does_not_stall_the_stream(wild):
    intake = Intake(Config())
    events = [*both(range(5000, 5010)), (VELOCITY, wild, 0.0), *both(range(5010, 5020))]
    assert push_all(intake, events) == list(range(5000, 5020))
    assert intake.counts == {"used": 20, "unmatched": 1}


def test_gap_restarts_the_delay_lines():
    intake = Intake(Config())
    out = [intake.push(stream, t * MS, v) for stream, t, v in both([1, 2, 3, 4, 50, 51])]
    assert [bool(r) for part in out for r in part.restart] == [True, False, False, False, True, False]
    assert intake.sequencer.gaps == 1


@pytest.mark.parametrize("slower", [3, 10, 100])
def test_a_sensor_that_becomes_slower_is_not_all_gaps(slower):
    """After a burst, or when a driver changes its rate."""
    period = 1_000_000
    stamps = np.cumsum(np.repeat([period, slower * period], 300)) + 10**9
    sequencer = Sequencer(SyncConfig())
    values = np.zeros(stamps.size)
    _, restart = sequencer.admit(stamps, values, values)
    assert not restart[-100:].any()
    assert abs(sequencer.period_s - slower * 1e-3) < 0.1 * slower * 1e-3


def test_slop_takes_the_nearest_and_uses_each_message_once():
    pairer = Pairer(SyncConfig(slop=0.0004))
    pairer.push(VELOCITY, np.array([1000, 1500, 2000]) * 1000, np.array([1.0, 1.5, 2.0]))
    joined = pairer.push(FRICTION, np.array([1600, 2100]) * 1000, np.array([16.0, 21.0]))
    np.testing.assert_array_equal(joined.velocity_m_s, [1.5, 2.0])
    np.testing.assert_array_equal(joined.stamp_ns, [1_600_000, 2_100_000])
    assert pairer.dropped == {"unmatched": 1}


def test_held_channel_is_the_last_value_stamped_at_or_before_the_sample():
    intake = Intake(Config())
    intake.push(PRESSURE, np.array([10, 20, 30]) * MS, np.array([1.0, 2.0, 3.0]))
    stamps = np.repeat([5, 10, 19, 20, 35], 2) * MS
    samples = intake.push(np.tile([VELOCITY, FRICTION], 5), stamps, np.zeros(10))
    np.testing.assert_array_equal(samples.pressure_Pa, [np.nan, 1.0, 1.0, 2.0, 3.0])
    assert np.isnan(samples.temperature_degC).all()


def test_a_nan_of_a_held_channel_keeps_the_value_before():
    intake = Intake(Config())
    intake.push(POSITION, np.array([1, 2]) * MS, np.array([0.5, np.nan]))
    samples = intake.push([VELOCITY, FRICTION], np.array([3, 3]) * MS, np.zeros(2))
    np.testing.assert_array_equal(samples.position_m, [0.5])


def test_full_queue_drops_the_oldest():
    pairer = Pairer(SyncConfig(queue=4))
    pairer.push(VELOCITY, np.arange(1, 11), np.zeros(10))
    assert pairer.waiting == (4, 0)
    assert pairer.dropped == {"unmatched": 6}
    pairer.flush()
    assert pairer.waiting == (0, 0)
    assert pairer.dropped == {"unmatched": 10}


def test_friction_sign_is_applied_once():
    intake = Intake(Config.from_mapping({"input.friction_sign": -1}))
    intake.push(VELOCITY, 1, 0.1)
    np.testing.assert_array_equal(intake.push(FRICTION, 1, 2.0).friction_N, [-2.0])


def test_a_velocity_of_another_scale_is_divided_by_its_gain_and_one_of_the_position_is_not():
    def velocities(given, velocity):
        intake = Intake(Config.from_mapping({"input.velocity_gain": 0.6} | given))
        time = np.arange(1, 301)
        intake.push(POSITION, time * MS, 0.5e-3 * time)
        if velocity:
            intake.push(VELOCITY, time * MS, np.full(300, 0.3))
        return intake.push(FRICTION, time * MS, np.ones(300)).velocity_m_s

    np.testing.assert_array_equal(velocities({}, velocity=True), np.full(300, 0.3 / 0.6))
    followed = velocities({"input.velocity_from": "position"}, velocity=False)
    np.testing.assert_allclose(followed[-50:], 0.5, rtol=0.02)


def test_values_that_are_no_measurement_are_refused():
    sequencer = Sequencer(SyncConfig())
    values = np.array([1.0, np.nan, np.inf, 1e300, -1e13, 2.0])
    sequencer.admit(np.arange(1, 7), np.zeros(6), values)
    assert sequencer.counts == {"used": 2, "nan": 1, "infinite": 3}


event = st.tuples(
    st.sampled_from([VELOCITY, FRICTION, PRESSURE]),
    st.integers(0, 40),
    st.floats(allow_nan=True, allow_infinity=True, width=32),
)


@given(st.lists(event, max_size=120), st.integers(1, 7))
def test_one_event_at_a_time_and_in_blocks_give_the_same_samples(events, block):
    config = Config.from_mapping({"sync.queue": 5, "sync.jump_back": 0.02})
    single, blocks = Intake(config), Intake(config)
    stream = np.array([e[0] for e in events], np.int64)
    stamp = np.array([e[1] for e in events], np.int64) * MS
    value = np.array([e[2] for e in events], np.float64)
    one = [single.push(stream[i], stamp[i], value[i]) for i in range(len(events))]
    many = [
        blocks.push(stream[i : i + block], stamp[i : i + block], value[i : i + block])
        for i in range(0, len(events), block)
    ]
    for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart", "pressure_Pa"):
        first = np.concatenate([getattr(part, name) for part in one]) if one else np.zeros(0)
        second = np.concatenate([getattr(part, name) for part in many]) if many else np.zeros(0)
        np.testing.assert_array_equal(first, second)
    single.flush()
    blocks.flush()
    assert single.counts == blocks.counts
    # Every message ends in exactly one sample or one reason.
    messages = sum(1 for e in events if e[0] != PRESSURE)
    joined = sum(single.sequencer.counts.values())
    assert 2 * joined + sum(single.pairer.dropped.values()) == messages


@pytest.mark.parametrize("size", [1, 3, 5, 8, 50])
@pytest.mark.parametrize("pushed", [2, 5, 9])
def test_other_settings_keep_what_waits(size, pushed):
    """Where there is less room the oldest go, and are counted; the others find their partners."""
    from dataclasses import replace

    pairer = Pairer(SyncConfig(queue=5))
    stamps = np.arange(1, pushed + 1)
    pairer.push(VELOCITY, stamps, stamps * 0.1)
    pairer.retune(replace(SyncConfig(), queue=size))
    kept = min(pushed, size, 5)
    assert pairer.waiting == (kept, 0)
    assert pairer.dropped.get("unmatched", 0) == pushed - kept
    pairs = pairer.push(FRICTION, stamps, stamps * 1.0)
    np.testing.assert_array_equal(pairs.stamp_ns, stamps[pushed - kept :])
    np.testing.assert_array_equal(pairs.velocity_m_s, stamps[pushed - kept :] * 0.1)
