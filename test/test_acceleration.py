"""Acceleration from velocity: corners of the velocity are kept, and nothing else is taken for one."""

import numpy as np
import pytest

from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.intake.acceleration import AccelerationFilter
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.derivative import kernel
from friction_estimator.core.intake.pairing import FRICTION, POSITION, VELOCITY
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings.config import Config

HALF_WIDTH = 0.025


def samples_of(t, v):
    return Samples(np.round(t * 1e9).astype(np.int64), v, np.zeros(t.size), np.arange(t.size) == 0)


def filtered(samples, sizes=None):
    given, parts, at = AccelerationFilter(HALF_WIDTH), [], 0
    for size in sizes or [len(samples)]:
        parts.append(given.push(samples[at : at + size]))
        at += size
    return in_sequence([*parts, given.drain()])


def cubic(t, v):
    """The plain cubic over the same even samples; its ends are left out."""
    half = round(HALF_WIDTH * (t.size - 1) / (t[-1] - t[0]))
    return np.convolve(v, kernel(half)[::-1], "same") / (t[1] - t[0]), slice(half, t.size - half)


def trapezoids(t, rng):
    """Velocity of moves with ramps of 60 to 200 ms, and its acceleration; corners lie anywhere between samples."""
    corners = np.cumsum(rng.uniform(0.06, 0.2, 400))
    heights = np.repeat(rng.uniform(-1.0, 1.0, 200), 2)
    v = np.interp(t, corners, heights)
    place = np.clip(np.searchsorted(corners, t) - 1, 0, corners.size - 2)
    return v, (np.diff(heights) / np.diff(corners))[place] * (t > corners[0])


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_corners_of_the_velocity_are_not_rounded(rate):
    rng = np.random.default_rng(4)
    t = np.arange(round(20 * rate)) / rate
    v, a = trapezoids(t, rng)
    v = v + 0.003 * rng.standard_normal(t.size)
    rounded, inside = cubic(t, v)
    wrong, of_cubic = filtered(samples_of(t, v)).acceleration_m_s2[inside] - a[inside], rounded[inside] - a[inside]
    assert rms(of_cubic) > 0.15 * rms(a)
    assert rms(wrong) < 0.5 * rms(of_cubic)
    # What is left is at the corners themselves, of which a sample may lie on either side.
    assert np.quantile(np.abs(wrong), 0.95) < 0.35 * np.quantile(np.abs(of_cubic), 0.95)
    # It is the mean of what may be: it leans to neither side, so that no coefficient is shrunk.
    assert abs(np.mean(wrong * a[inside])) < 0.02 * np.mean(np.square(a))


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("kind", ["white", "low-pass", "stairs", "fast"])
def test_what_is_no_corner_stays_with_the_cubic(rate, kind):
    rng = np.random.default_rng(7)
    t = np.arange(round(10 * rate)) / rate
    v = np.sin(2 * np.pi * 0.7 * t) + 0.3 * np.sin(2 * np.pi * 2.1 * t)
    a = 2 * np.pi * (0.7 * np.cos(2 * np.pi * 0.7 * t) + 0.63 * np.cos(2 * np.pi * 2.1 * t))
    noise = 0.003 * rng.standard_normal(t.size)
    if kind == "white":
        v = v + noise
    elif kind == "low-pass":  # as a drive's own filter leaves it
        v = v + 3.0 * np.convolve(noise, np.exp(-np.arange(20) / 5.0) / 5.0, "same")
    elif kind == "stairs":  # whole counts a sample
        v = np.round(v / 0.05) * 0.05
    else:  # too fast for the cubic, but smooth
        v = v + 0.05 * np.sin(2 * np.pi * 25.0 * t) + 0.01 * noise
        a = a + 2.5 * np.pi * np.cos(2 * np.pi * 25.0 * t)
    plain, inside = cubic(t, v)
    found = filtered(samples_of(t, v)).acceleration_m_s2
    assert rms((found - a)[inside]) < 1.1 * rms((plain - a)[inside])
    if kind != "fast":  # which may be followed better
        assert rms((found - plain)[inside]) < 0.35 * rms((plain - a)[inside])


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_where_two_corners_are_in_a_window_the_acceleration_is_in_doubt(rate):
    """By about as much as it is off, and what is off by much is in doubt."""
    rng = np.random.default_rng(5)
    t = np.arange(round(20 * rate)) / rate
    corners = np.cumsum(np.tile([0.02, 0.3], 60))  # ramps of 20 ms between constant speeds
    heights = np.repeat(rng.uniform(-1.0, 1.0, 60), 2)
    v = np.interp(t, corners, heights)
    a = np.interp(t, corners[:-1] + 1e-9, np.diff(heights) / np.diff(corners)) * 0.0
    for start, end, slope in zip(corners, corners[1:], np.diff(heights) / np.diff(corners), strict=False):
        a[(t > start) & (t <= end)] = slope
    found = filtered(samples_of(t, v + 0.003 * rng.standard_normal(t.size)))
    inside = slice(round(0.5 * rate), -round(rate))
    wrong, doubt = (found.acceleration_m_s2 - a)[inside], np.sqrt(found.acceleration_doubt[inside])
    certain = doubt == 0.0
    assert 0.5 < np.mean(certain) < 0.95
    assert rms(wrong) > 0.1 * rms(a)
    assert rms(wrong[certain]) < 0.3 * rms(wrong)
    assert np.mean(np.abs(wrong[~certain]) < 4.0 * doubt[~certain]) > 0.9


@pytest.mark.parametrize("kind", ["smooth", "triangle"])
def test_what_is_followed_is_not_in_doubt(kind):
    rng = np.random.default_rng(6)
    t = np.arange(20_000) / 1000.0
    v = np.sin(2 * np.pi * 0.7 * t) if kind == "smooth" else np.abs((t % 2.0) - 1.0)
    found = filtered(samples_of(t, v + 0.003 * rng.standard_normal(t.size)))
    assert np.mean(found.acceleration_doubt > 0.0) < 0.02


def test_a_corner_without_noise_is_exact():
    t = np.arange(400) / 500.0
    v = np.where(t < 0.3511, 2.0 * t, 2.0 * 0.3511 - 5.0 * (t - 0.3511))
    found = filtered(samples_of(t, v))
    np.testing.assert_allclose(found.acceleration_m_s2, np.where(t < 0.3511, 2.0, -5.0), atol=1e-4)
    assert found.acceleration_variance.max() < 1e-6
    for flat in (np.zeros(400), np.full(400, 3.0)):
        assert not filtered(samples_of(t, flat)).acceleration_m_s2.any()


def test_corners_are_the_same_whatever_parts_the_samples_come_in():
    rng = np.random.default_rng(9)
    t = np.cumsum(rng.uniform(0.001, 0.004, 900))
    v, _ = trapezoids(t, rng)
    samples = samples_of(t, v + 0.002 * rng.standard_normal(t.size))
    whole = filtered(samples)
    for sizes in ([1] * 900, [13, 400, 0, 1, 486]):
        parts = filtered(samples, sizes)
        assert parts.acceleration_m_s2.tobytes() == whole.acceleration_m_s2.tobytes()
        assert parts.acceleration_variance.tobytes() == whole.acceleration_variance.tobytes()
        assert parts.acceleration_doubt.tobytes() == whole.acceleration_doubt.tobytes()


INERTIA, SIN, COS = 0.03, 1.1, -0.4

TURN = 0.1
"""Of a triangle, s."""


def friction_of(v):
    return 0.15 * np.tanh(v / 0.05) + 0.08 * np.tanh(v / 0.6) + 0.03 * v


def triangle(rate, seconds, seed, turns=(TURN,)):
    """Return time, position, noisy velocity and effort of a pendulum to and fro; turns take `turns`, s, in turn."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    corners, heights, side, at = [], [], 1.0, 0.4317
    while at < seconds + 2.0:
        corners += [at, at + turns[len(corners) // 2 % len(turns)]]
        heights += [side, -side]
        side, at = -side, at + 0.9873
    v = 2.0 * np.interp(t, corners, heights)
    a = np.interp(t, corners, heights) * 0.0
    for start, end, height in zip(corners[::2], corners[1::2], heights[::2], strict=True):
        a[(t >= start) & (t < end)] = -4.0 * height / (end - start)
    q = np.cumsum(v) / rate
    effort = friction_of(v) + INERTIA * a + SIN * np.sin(q) + COS * np.cos(q)
    return t, q, v + 0.006 * rng.standard_normal(t.size), effort + 0.002 * rng.standard_normal(t.size)


def events(t, q, v, effort):
    stamps = np.repeat(10**18 + np.round(t * 1e9).astype(np.int64), 3)
    return np.tile([POSITION, VELOCITY, FRICTION], t.size), stamps, np.column_stack([q, v, effort]).ravel()


GIVEN = Config.from_mapping(
    {
        "model.type": "hammerstein",
        "theory.kind": "none",
        "input.motion": "rotary",
        "load.terms": ["inertia", "gravity"],
    }
)


@pytest.mark.parametrize(("rate", "turns"), [(200.0, (TURN,)), (500.0, (TURN,)), (500.0, (0.02, 0.09, 0.03, 0.06))])
def test_the_load_of_a_triangle_is_within_its_intervals(rate, turns):
    """Also where turns are shorter than the window of the acceleration, so that two corners lie in it."""
    record = triangle(rate, 24.0, 1, turns)
    intake = Intake(GIVEN, capacity=record[0].size + 1)
    samples = in_sequence([intake.push(*events(*record)), intake.drain()])
    met = chosen(GIVEN, samples)
    batch = fit_batch(samples, met, use=~standstill(samples, met.velocity_scale))
    for found in (batch.loads, replay(samples, GIVEN).loads):
        for load, true in zip(found, (INERTIA, SIN, COS), strict=True):
            assert load.separated, load.reason
            assert load.ci95[0] <= true <= load.ci95[1], load
        assert found[0].value == pytest.approx(INERTIA, rel=0.015)
        assert found[0].ci95[1] - found[0].ci95[0] < 0.1 * INERTIA


def test_live_and_replayed_corners_are_the_same():
    record = triangle(200.0, 5.0, 2)
    intake = Intake(GIVEN, capacity=record[0].size + 1)
    replayed = replay(in_sequence([intake.push(*events(*record)), intake.drain()]), GIVEN)
    step, found = LiveStep(Intake(GIVEN), GIVEN), []
    stream, stamp, value = events(*record)
    for at in range(0, stream.size, 3):
        step.stream[:3], step.stamp_ns[:3], step.value[:3] = (x[at : at + 3] for x in (stream, stamp, value))
        found += step.run(3, learn=True)
    live = np.array([predicted for *_, predicted, _ in found])
    assert live.size == record[0].size - 5
    np.testing.assert_array_equal(live, replayed.predicted_N[: live.size])
