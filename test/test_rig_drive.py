"""The drive: profiles whose derivatives are derivatives, schedules that do not jump."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.rig.drive import (
    CONDITIONS,
    PA_PER_PSI,
    Segment,
    celsius,
    parse_schedule,
    run_drive,
    segment,
)
from friction_estimator.rig.profiles import PROFILES, Geometry

GEOMETRY = Geometry(eccentric_m=0.02, rod_m=0.07)
profile = pytest.mark.parametrize("profile", list(PROFILES))


def one(profile, cycles=2, period=1.0, rate=4000.0, geometry=GEOMETRY):
    return run_drive((Segment(period, 0.0, cycles, profile),), geometry, rate)


@profile
def test_velocity_and_acceleration_are_the_derivatives_of_position(profile):
    d = one(profile, cycles=7)
    h = 1.0 / 4000.0
    top, hardest = np.abs(d.velocity_m_s).max(), np.abs(d.acceleration_m_s2).max()
    mean_velocity = 0.5 * (d.velocity_m_s[1:] + d.velocity_m_s[:-1])
    mean_acceleration = 0.5 * (d.acceleration_m_s2[1:] + d.acceleration_m_s2[:-1])
    # The trapezoidal rule is right to second order, except where the acceleration jumps (first order there).
    np.testing.assert_allclose(np.diff(d.position_m) / h, mean_velocity, atol=0.25 * hardest * h + 1e-4 * top)
    jumps = np.abs(np.diff(d.acceleration_m_s2)) > 0.1 * hardest
    np.testing.assert_allclose((np.diff(d.velocity_m_s) / h)[~jumps], mean_acceleration[~jumps], atol=1e-3 * hardest)
    assert np.count_nonzero(jumps) <= 7 * 30


@profile
@given(st.floats(1e-3, 0.5), st.floats(1.1, 50.0), st.floats(0.05, 20.0))
def test_every_cycle_runs_over_the_stroke_from_rest_to_rest(profile, r, rod_ratio, period):
    d = one(profile, 1, period, 2000.0 / period, Geometry(r, r * rod_ratio))
    top = np.abs(d.velocity_m_s).max()
    assert d.position_m[0] == pytest.approx(-r, rel=1e-12)
    assert abs(d.velocity_m_s[0]) <= 1e-12 * top
    assert d.position_m.min() == pytest.approx(-r, rel=1e-9)
    assert d.position_m.max() == pytest.approx(r, rel=1e-4)
    assert abs(d.position_m[-1] + r) <= top * 1.01 * period / 2000.0


@profile
def test_position_and_velocity_are_continuous_from_segment_to_segment(profile):
    others = [Segment(0.37, 2e5, 2, name) for name in PROFILES]
    parts = [part for other in others for part in (other, Segment(1.0, 1e5, 1, profile))]
    rate = 5000.0
    d = run_drive(tuple(parts), GEOMETRY, rate)
    assert np.abs(np.diff(d.position_m)).max() <= np.abs(d.velocity_m_s).max() * 1.001 / rate
    assert np.abs(np.diff(d.velocity_m_s)).max() <= np.abs(d.acceleration_m_s2).max() * 1.001 / rate
    assert np.abs(np.diff(d.pressure_Pa)).max() <= 1e5 * math.pi / 2 / (0.0925 * rate) * 1.01


def test_the_eccentric_of_the_paper_reaches_the_stated_speeds():
    assert np.abs(one("sine", period=1.0).velocity_m_s).max() == pytest.approx(0.126, abs=5e-4)
    assert np.abs(one("sine", period=5.0).velocity_m_s).max() == pytest.approx(0.025, abs=2e-4)


def test_a_long_rod_makes_the_crank_a_sine_and_a_short_one_adds_the_second_harmonic():
    sine, long = one("sine"), one("crank", geometry=Geometry(0.02, 200.0))
    np.testing.assert_allclose(long.position_m, sine.position_m, atol=0.02 * 1e-4)
    short = one("crank", cycles=1, geometry=Geometry(0.02, 0.08))
    spectrum = np.abs(np.fft.rfft(short.acceleration_m_s2))
    assert spectrum[2] / spectrum[1] == pytest.approx(0.25, abs=0.01)  # r/l


def test_the_triangle_runs_at_constant_speed_outside_its_turns():
    speed = np.abs(one("triangle").velocity_m_s)
    assert np.mean(np.isclose(speed, speed.max(), rtol=1e-9)) > 0.9


def test_speed_steps_change_the_speed_without_reversal():
    velocity = one("speed_steps", cycles=1).velocity_m_s
    assert (velocity[1 : velocity.size // 2] > 0.0).all()
    levels = np.unique(velocity[velocity > 0].round(9), return_counts=True)[1]
    assert np.count_nonzero(levels > 100) == 6


def test_dwell_rests_for_many_different_times():
    d = one("dwell", cycles=7, rate=1000.0)
    still = np.concatenate([[False], d.velocity_m_s == 0.0, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    times = np.diff(edges.reshape(-1, 2), axis=1).ravel() / 1000.0
    long = times[times > 0.01]
    assert long.min() < 0.05
    assert long.max() > 0.45
    assert np.unique(long.round(2)).size >= 7


def test_the_multisine_has_its_harmonics_and_no_others():
    d = one("multisine", cycles=1)
    spectrum = np.abs(np.fft.rfft(d.velocity_m_s))
    present = np.flatnonzero(spectrum > 1e-6 * spectrum.max())
    np.testing.assert_array_equal(present, [1, 2, 3, 5, 7])
    np.testing.assert_allclose(spectrum[present], spectrum[1], rtol=1e-6)


@given(st.floats(0.01, 100.0), st.floats(0.01, 1000.0))
def test_a_segment_holds_the_nearest_number_of_whole_cycles(period, seconds):
    part = segment(period, 50.0, seconds)
    assert part.cycles >= 1
    assert part.cycles == 1 or abs(part.duration_s - seconds) <= 0.5 * period * (1 + 1e-9)


def test_a_schedule_is_read_as_written():
    parts = parse_schedule(" 5:50:20 , 1:200:10:crank,0.5:-1:3:dwell")
    assert parts == (
        Segment(5.0, 50 * PA_PER_PSI, 4, "sine"),
        Segment(1.0, 200 * PA_PER_PSI, 10, "crank"),
        Segment(0.5, -PA_PER_PSI, 6, "dwell"),
    )
    d = run_drive(parts, GEOMETRY, 1000.0)
    assert d.time_s.size == 33000
    assert d.period_s[[0, 19999, 20000, 29999, 30000]].tolist() == [5.0, 5.0, 1.0, 1.0, 0.5]
    assert d.pressure_Pa[[0, 19999, 29999]].tolist() == [50 * PA_PER_PSI, 50 * PA_PER_PSI, 200 * PA_PER_PSI]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "write PERIOD:PRESSURE_PSI:SECONDS"),
        ("1:50", "write PERIOD:PRESSURE_PSI:SECONDS"),
        ("1:50:5:sine:2", "write PERIOD:PRESSURE_PSI:SECONDS"),
        ("1:50:5,x:50:5", "'x:50:5': PERIOD is 'x', not a number"),
        ("1:nan:5", "PRESSURE_PSI is 'nan'"),
        ("1:50:5:cosine", r"unknown profile 'cosine': choose one of sine, crank"),
        ("0:50:5", "drive period of 0 s"),
        ("1:50:0", "segment of 0 s"),
        ("1:50:-2", "segment of -2 s"),
        ("1:1e9:5", "gauge pressure"),
    ],
)
def test_a_schedule_that_cannot_be_driven_is_refused(text, message):
    with pytest.raises(ConfigError, match=message):
        parse_schedule(text)


def test_a_crank_that_cannot_turn_over_is_refused():
    with pytest.raises(ConfigError, match="too short"):
        Geometry(0.1, 0.1)
    with pytest.raises(ConfigError, match="eccentric"):
        Geometry(0.0, 0.1)


def test_the_paper_s_conditions():
    assert CONDITIONS == {"a": (5.0, 50.0), "b": (1.0, 50.0), "c": (5.0, 200.0)}
    assert celsius(130.0) == pytest.approx(54.444, abs=1e-3)
