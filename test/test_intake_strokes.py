"""Reversals with hysteresis, periods by autocorrelation, channels that agree or do not."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from synthetic import samples_of

from friction_estimator.core.intake.agreement import velocity_over_position_rate
from friction_estimator.core.intake.periods import drive_periods, is_harmonic
from friction_estimator.core.intake.strokes import reversal_speed, reversals

RATE_HZ = 100


def reversed_at(velocity, **more):
    samples = samples_of(velocity, velocity, RATE_HZ, **more)
    return reversals(samples.velocity_m_s, samples.restart, reversal_speed(samples))


def trajectory(seconds, period_s=22.13, rate_hz=RATE_HZ):
    """Time and velocity of a path with several unlike strokes that comes again after `period_s`."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    phase = 2 * np.pi * t / period_s
    return t, np.sin(2 * phase) + 0.8 * np.sin(5 * phase + 1.0) + 0.3 * np.cos(phase) + 0.5 * np.sin(7 * phase + 2.0)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([0.0, 1e-4, 1e-3, 1e-2]), st.integers(0, 2**32 - 1))
@example(1e-2, 85134)  # One sample of a rest is beyond four standard deviations.
def test_noise_makes_no_reversals(noise, seed):
    t = np.arange(6000) / RATE_HZ
    velocity = np.sin(2 * np.pi * t / 6.0 + 0.3) * (np.abs(np.sin(2 * np.pi * t / 6.0 + 0.3)) > 0.3)
    found = reversed_at(velocity + noise * np.random.default_rng(seed).standard_normal(t.size))
    assert found.size == 19


def test_a_reversal_is_where_the_new_stroke_begins():
    t = np.arange(3000) / RATE_HZ
    velocity = np.sin(2 * np.pi * t / 6.0)
    found = reversed_at(velocity)
    np.testing.assert_allclose(t[found], 3.0 * np.arange(1, found.size + 1), atol=0.011)
    resting = np.where(np.abs(velocity) < 0.4, 0.0, velocity)
    np.testing.assert_array_equal(np.abs(resting[reversed_at(resting) - 1]), 0.0)


def test_a_reversal_within_a_gap_is_not_counted():
    velocity = np.repeat([1.0, -1.0, 1.0], 100)
    assert reversed_at(velocity, restart_at=(0,)).tolist() == [100, 200]
    assert reversed_at(velocity, restart_at=(0, 100)).tolist() == [200]


# Periods


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_long_trajectory_has_its_own_period(noise):
    t, v = trajectory(180.0)
    v = v + noise * np.random.default_rng(0).standard_normal(t.size)
    assert drive_periods(t, v, t == 0.0) == pytest.approx((22.13,), rel=2e-3)


@pytest.mark.parametrize("order", [(1.0, 5.0), (5.0, 1.0, 5.0, 1.0)])
@pytest.mark.parametrize("pause_s", [0.0, 30.0])
def test_several_periods_are_found_with_and_without_pauses(order, pause_s):
    parts, times, restart, at = [], [], [], 0.0
    for period in order:
        t = np.arange(int(20 * RATE_HZ)) / RATE_HZ
        parts.append(np.sin(2 * np.pi * t / period) / period)
        times.append(at + t)
        restart.append(t == 0.0)
        at += 20.0 + pause_s
    found = drive_periods(*(np.concatenate(x) for x in (times, parts, restart)))
    assert found == pytest.approx((5.0, 1.0), rel=0.01)


def test_jitter_and_lost_samples_do_not_hide_a_period():
    rng = np.random.default_rng(1)
    t = np.sort(np.arange(8000) / RATE_HZ + rng.uniform(-0.003, 0.003, 8000))
    kept = rng.random(t.size) > 0.05
    kept[np.arange(300, 8000, 400)[:, None] + np.arange(8)] = False
    t = t[kept]
    restart = np.diff(t, prepend=-1.0) > 0.05
    assert restart.sum() > 10
    v = np.sin(2 * np.pi * t / 3.0) + 0.4 * np.sin(4 * np.pi * t / 3.0 + 1.0)
    assert drive_periods(t, v, restart) == pytest.approx((3.0,), rel=0.01)


def test_what_does_not_repeat_has_no_period():
    rng = np.random.default_rng(2)
    t = np.arange(6000) / RATE_HZ
    for v in (
        np.cumsum(rng.standard_normal(t.size)),
        rng.standard_normal(t.size),
        np.full(t.size, 0.3),
        t * 0.1,
    ):
        assert drive_periods(t, v, t == 0.0) == ()
    assert drive_periods(t[:5], t[:5], t[:5] == 0.0) == ()


def test_the_drives_own_lines_are_known():
    assert is_harmonic(0.0452, (22.13,), 180.0)
    assert is_harmonic(3.0, (5.0, 1.0), 60.0)
    assert not is_harmonic(3.1, (5.0, 1.0), 60.0) or not is_harmonic(3.13, (1.0,), 60.0)
    assert not is_harmonic(50.0, (22.13, 1.0), 60.0)
    assert not is_harmonic(0.01, (22.13,), 180.0)
    assert not is_harmonic(3.0, (), 60.0)


# Agreement


@pytest.mark.parametrize("factor", [1.0, 0.5, 2.0])
def test_velocity_and_position_are_compared(factor):
    _, v = trajectory(60.0)
    position = np.cumsum(v) / RATE_HZ
    samples = samples_of(factor * v, v, RATE_HZ, restart_at=(0, 3000))
    ratio, error = velocity_over_position_rate(
        type(samples)(samples.stamp_ns, samples.velocity_m_s, v, samples.restart, position_m=position)
    )
    assert ratio == pytest.approx(factor, rel=0.01)
    assert error < 0.01
    assert velocity_over_position_rate(samples) is None
