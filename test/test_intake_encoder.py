"""Wrapped encoders are unwrapped, live and in recordings alike; what does not wrap is left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.encoder import Encoder, wraps_undone
from friction_estimator.core.intake.pairing import FRICTION, POSITION, VELOCITY
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config

SPAN = 25.0
RATE_HZ = 50.0


def turning(seconds=120.0, top=7.0, rate_hz=RATE_HZ):
    """Time, angle and speed of a shaft that goes some turns to and fro, resting between."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    v = top * np.clip(2.0 * np.sin(2 * np.pi * t / 40.0), -1.0, 1.0) * (np.abs(np.sin(2 * np.pi * t / 40.0)) > 0.2)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) / rate_hz)])
    return t, x, v


def wrapped(x, span=SPAN, low=-12.5):
    return (x - low) % span + low


def unwrapped(t, shown, v, restart=None):
    restart = np.arange(t.size) == 0 if restart is None else restart
    position = shown.copy()
    encoder = Encoder()
    shift = encoder.push(np.round(t * NS_PER_S).astype(np.int64) + 1, v, restart, position)
    np.testing.assert_allclose(position, shown + shift, atol=1e-12)
    return position, encoder.wraps


@pytest.mark.parametrize(("span", "low"), [(25.0, -12.5), (2 * np.pi, 0.0), (2 * np.pi, -np.pi), (0.4, 0.1)])
@pytest.mark.parametrize("gain", [1.0, 0.55])  # velocity channels that are off by such a factor exist
def test_a_wrapped_encoder_is_unwrapped_and_its_modulus_found(span, low, gain):
    t, x, v = turning(top=7.0 * span / SPAN)
    position, wraps = unwrapped(t, wrapped(x, span, low), gain * v)
    assert wraps.count == np.count_nonzero(np.abs(np.diff(wrapped(x, span, low))) > 0.5 * span)
    assert wraps.modulus_m == pytest.approx(span, rel=2e-3)
    error = position - x
    assert np.ptp(error) < 0.02 * span


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_noise_and_a_coarse_velocity_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    t, x, v = turning()
    shown = wrapped(x + rng.uniform(-10.0, 10.0) + 4e-4 * rng.standard_normal(x.size))
    position, wraps = unwrapped(t, shown, np.round(v / 0.022) * 0.022 + 0.011)
    assert wraps.modulus_m == pytest.approx(SPAN, rel=2e-3)
    assert np.ptp(position - x) < 0.02 * SPAN


def test_a_position_that_never_wraps_stays_bit_for_bit():
    rng = np.random.default_rng(0)
    t, x, v = turning()
    for shown in (x, x + 0.01 * rng.standard_normal(x.size), np.repeat(x[::5], 5), np.full(x.size, 3.0)):
        position, wraps = unwrapped(t, shown, v)
        np.testing.assert_array_equal(position, shown)
        assert wraps.count == 0


def test_a_position_set_to_zero_is_no_wrap():
    t, x, v = turning()
    rest = np.flatnonzero(v == 0.0)
    second = np.flatnonzero((v == v.max()) & (t > 40.0))  # on its first stroke it would look like a span from there
    for k in (rest[0], rest[-1], second[60]):
        shown = x.copy()
        shown[k:] -= shown[k]
        shown += 1e-4 * np.random.default_rng(1).standard_normal(x.size)
        position, wraps = unwrapped(t, shown, v)
        np.testing.assert_array_equal(position, shown)
        assert wraps.count == 0


def test_a_wild_value_hides_no_wraps():
    t, x, v = turning()
    shown = wrapped(x)
    shown[150] = 400.0
    position, wraps = unwrapped(t, shown, v)
    assert wraps.modulus_m == pytest.approx(SPAN, rel=2e-3)
    assert np.ptp((position - x)[int(70 * RATE_HZ) :]) < 0.02 * SPAN


def test_turns_go_on_after_a_pause_and_start_anew_when_the_clock_jumps_back():
    t, x, v = turning()
    middle = t.size // 2 + 7
    paused = t + np.where(np.arange(t.size) >= middle, 30.0, 0.0)
    restart = np.isin(np.arange(t.size), (0, middle))
    position, _ = unwrapped(paused, wrapped(x), v, restart)
    assert np.ptp(position - x) < 0.02 * SPAN
    looped = np.concatenate([t, t])
    restart = np.isin(np.arange(looped.size), (0, t.size))
    position, _ = unwrapped(looped, np.tile(wrapped(x), 2), np.tile(v, 2), restart)
    assert np.ptp((position - np.tile(x, 2))[t.size :]) < 0.02 * SPAN


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_one_event_at_a_time_gives_the_positions_of_a_whole_recording(seed):
    rng = np.random.default_rng(seed)
    t, x, v = turning(24.0)
    stamps = np.round(t * NS_PER_S).astype(np.int64) + 1
    stream = np.tile([POSITION, VELOCITY, FRICTION], t.size)
    value = np.stack([wrapped(x), v, np.sign(v)], 1).ravel()
    every = rng.random(stream.size) > 0.02
    stream, stamp, value = stream[every], np.repeat(stamps, 3)[every], value[every]
    whole = Intake(Config()).push(stream, stamp, value)
    intake = Intake(Config())
    parts = [intake.push(a, b, c) for a, b, c in zip(stream, stamp, value, strict=True)]
    for name in ("position_m", "position_shift_m"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(whole, name))
    assert wraps_undone(whole).count == intake.encoder.wraps.count > 0
    assert wraps_undone(whole).modulus_m == pytest.approx(SPAN, rel=1e-2)


def test_samples_without_turns_say_so():
    nothing = np.zeros(2)
    assert wraps_undone(Samples(np.arange(2), nothing, nothing, np.array([True, False]))).count == 0
