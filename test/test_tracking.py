"""Velocity from position: right where it can be, and the same one by one and at once."""

import numpy as np
import pytest
from joint_bags import START, joint_state, write_joint_bag

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, VELOCITY
from friction_estimator.core.intake.tracking import CORNERS, FILTERS, WARM_UP, Tracker, gains
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.rig.drive import parse_schedule
from friction_estimator.rig.simulate import Scenario, simulate

STROKE_M = 0.04


def stamps(time_s):
    return START + np.rint(time_s * NS_PER_S).astype(np.int64)


def relative_error(found, true, after=300):
    known = np.isfinite(found) & (np.arange(true.size) >= after)
    assert known[after:].mean() > 0.95
    return float(np.sqrt(np.mean((found - true)[known] ** 2)) / np.std(true))


def drive(schedule, rate_hz=1000.0, seed=0, plant="rig"):
    return simulate(Scenario(parse_schedule(schedule), plant=plant, rate_hz=rate_hz, seed=seed)).paired()


def counted(position, counts, phase=0.3):
    step = STROKE_M / counts
    return step * np.floor(position / step + phase)


# The filters


@pytest.mark.parametrize("corner", [1.0, 0.1, 0.003])
def test_the_gains_are_those_of_the_steady_kalman_filter_for_white_jerk(corner):
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    jerk = corner**6 * np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
    covariance = np.eye(3) * 1e3
    gain = np.zeros(3)
    for _ in range(round(40 / corner)):
        covariance = transition @ covariance @ transition.T + jerk
        gain = covariance[:, 0] / (covariance[0, 0] + 1.0)
        covariance = covariance - np.outer(gain, covariance[0])
    # White jerk sampled once a period is not quite what the poles of continuous time stand for.
    np.testing.assert_allclose(gains(corner), gain, rtol=0.02 + 0.3 * corner)


def test_no_delay_at_constant_acceleration():
    time = np.arange(4000) / 1000.0
    found = Tracker().push(stamps(time), 0.3 * time + 0.5 * 0.2 * time**2)
    np.testing.assert_allclose(found[WARM_UP:], (0.3 + 0.2 * time)[WARM_UP:], rtol=1e-6)
    assert np.isnan(found[: WARM_UP - 1]).all()
    assert np.isfinite(found[WARM_UP - 1 :]).all()


# (drive, rate, counts over the stroke, most error relative to the spread of the velocity). The bounds are twice what
# was found; differences of the positions err by 0.3 to 50 times the spread.
DRIVES = [
    ("5:50:20", 1000.0, 4096, 0.005),
    ("1:50:20", 1000.0, 4096, 0.008),
    ("1:50:20", 200.0, 4096, 0.013),
    ("0.5:50:10", 4000.0, 4096, 0.007),
    ("2:50:20:triangle", 1000.0, 4096, 0.024),
    ("6:50:24:speed_steps", 1000.0, 4096, 0.05),
    ("200:50:200", 1000.0, 4096, 0.006),
    ("1:100:20:crank", 500.0, 1000, 0.022),
    ("5:50:20", 1000.0, 65536, 0.0012),
]


@pytest.mark.parametrize(("schedule", "rate_hz", "counts", "most"), DRIVES)
def test_the_memory_fits_the_drive_without_configuration(schedule, rate_hz, counts, most):
    samples = drive(schedule, rate_hz, seed=21)
    tracker = Tracker()
    found = tracker.push(samples.stamp_ns, counted(samples.position_m, counts))
    assert relative_error(found, samples.velocity_m_s) < most
    assert tracker.count == pytest.approx(STROKE_M / counts, rel=1e-3)


@pytest.mark.parametrize(("noise", "most"), [(0.0, 3e-4), (1e-6, 6e-3), (1e-5, 0.025)])
def test_noise_that_is_no_encoder_s(noise, most):
    samples = drive("1:50:20", seed=22)
    shown = samples.position_m + noise * np.random.default_rng(1).standard_normal(len(samples))
    assert relative_error(Tracker().push(samples.stamp_ns, shown), samples.velocity_m_s) < most


@pytest.fixture(scope="module")
def moving():
    return drive("1:50:20", seed=23)


def test_wraps_and_positions_set_anew_are_no_motion(moving):
    shown = counted(moving.position_m, 4096)
    span = 1300 * STROKE_M / 4096
    wrapped = np.mod(shown + 0.02, span)
    assert np.ptp(wrapped) < 0.99 * np.ptp(shown)
    assert relative_error(Tracker().push(moving.stamp_ns, wrapped), moving.velocity_m_s) < 0.01
    anew = shown.copy()
    anew[7000:] += 0.5
    anew[3000] = 9.0
    assert relative_error(Tracker().push(moving.stamp_ns, anew), moving.velocity_m_s) < 0.01


def test_missing_messages_and_uneven_stamps(moving):
    rng = np.random.default_rng(2)
    kept = rng.random(len(moving)) > 0.2
    found = Tracker().push(moving.stamp_ns[kept], counted(moving.position_m[kept], 4096))
    assert relative_error(found, moving.velocity_m_s[kept]) < 0.012
    time = np.sort(moving.time_s + 2e-4 * rng.standard_normal(len(moving)))
    shown = counted(np.interp(time, moving.time_s, moving.position_m), 4096)
    true = np.interp(time, moving.time_s, moving.velocity_m_s)
    assert relative_error(Tracker().push(stamps(time), shown), true) < 0.01


def test_what_is_no_position_harms_no_velocity_after_it(moving):
    shown = counted(moving.position_m, 4096)
    clean = Tracker().push(moving.stamp_ns, shown)
    shown[5000], shown[5001], shown[5002] = np.nan, np.inf, 1e300
    found = Tracker().push(moving.stamp_ns, shown)
    assert np.isnan(found[5000:5003]).all()
    np.testing.assert_allclose(found[5100:], clean[5100:], atol=0.02 * np.std(moving.velocity_m_s))
    assert np.isfinite(found[5003:]).all()


def test_a_gap_and_a_jump_of_the_clock_begin_anew(moving):
    shown = counted(moving.position_m, 4096)
    late = moving.stamp_ns.copy()
    late[4000:] += NS_PER_S
    late[8000:] -= 5 * NS_PER_S
    found = Tracker().push(late, shown)
    for begin in (0, 4000, 8000):
        assert np.isnan(found[begin : begin + WARM_UP - 1]).all()
        assert np.isfinite(found[begin + WARM_UP - 1 : begin + 3000]).all()


def test_one_position_at_a_time_is_the_same_bit_for_bit(moving):
    shown = counted(moving.position_m, 4096)[:3000]
    whole, single = Tracker(), Tracker()
    at_once = whole.push(moving.stamp_ns[:3000], shown)
    one_by_one = np.concatenate([single.push(moving.stamp_ns[k : k + 1], shown[k : k + 1]) for k in range(3000)])
    np.testing.assert_array_equal(at_once, one_by_one)
    assert CORNERS.size == FILTERS


# As an input


def events_of(samples, shown):
    stream = np.tile([POSITION, FRICTION], len(samples))
    return stream, np.repeat(samples.stamp_ns, 2), np.column_stack([shown, samples.friction_N]).ravel()


def test_positions_stand_for_velocities_until_one_comes():
    intake = Intake(Config())
    time = np.arange(3000) / 1000.0
    samples = Samples(stamps(time), np.full(3000, 0.1), np.ones(3000), time == 0.0)
    stream, stamp, value = events_of(samples, 0.1 * time)
    first = intake.push(stream[:4000], stamp[:4000], value[:4000])
    assert len(first) == 1000  # for a second a velocity topic might still be found
    np.testing.assert_allclose(first.velocity_m_s, 0.1, rtol=1e-9)
    assert intake.pairer.tracks
    intake.push(VELOCITY, stamp[4000], 0.7)
    after = intake.push(stream[4000:4002], stamp[4000:4002], value[4000:4002])
    assert after.velocity_m_s.tolist() == [0.7]
    assert not intake.pairer.tracks
    assert len(intake.push(stream[4002:], stamp[4002:], value[4002:])) == 0


@pytest.mark.parametrize(
    ("values", "used"),
    [
        ({"input.velocity_from": "topic"}, 0),
        ({"input.velocity_from": "position"}, 3000 - WARM_UP + 1),
        ({"input.mode": "joint_state"}, 3000 - WARM_UP + 1),
        ({"input.mode": "float64"}, 0),
    ],
)
def test_where_the_velocity_comes_from_can_be_said(values, used):
    intake = Intake(Config().updated(values))
    time = np.arange(3000) / 1000.0
    samples = Samples(stamps(time), np.full(3000, 0.1), np.ones(3000), time == 0.0)
    assert len(intake.push(*events_of(samples, 0.1 * time))) == used


def test_a_velocity_that_is_not_wanted_is_passed_over():
    intake = Intake(Config().updated({"input.velocity_from": "position"}))
    time = np.arange(100) / 100.0
    for k in range(100):
        intake.push(VELOCITY, stamps(time)[k], 7.0)
        intake.push(POSITION, stamps(time)[k], 0.1 * time[k])
        intake.push(FRICTION, stamps(time)[k], 1.0)
    assert intake.counts == {"used": 100 - WARM_UP + 1, "unmatched": WARM_UP - 1}


def test_live_is_replay_bit_for_bit():
    samples = drive("1:50:6", seed=24)
    config = Config().updated({"input.velocity_from": "position"})
    stream, stamp, value = events_of(samples, counted(samples.position_m, 4096))
    expected = replay(Intake(config).push(stream, stamp, value), config)
    live = LiveStep(Intake(config), config)
    predicted = []
    for k in range(0, stream.size, 2):
        live.stream[:2], live.stamp_ns[:2], live.value[:2] = stream[k : k + 2], stamp[k : k + 2], value[k : k + 2]
        predicted += [prediction[3] for prediction in live.run(2, learn=True)]
    np.testing.assert_array_equal(predicted, expected.predicted_N)


@pytest.mark.parametrize(("schedule", "most"), [("5:50:60", 3.0), ("1:50:60", 2.0)])
def test_friction_is_predicted_nearly_as_well_as_with_the_true_velocity(schedule, most):
    samples = drive(schedule, seed=25)
    config = Config().updated({"input.velocity_from": "position"})
    tracked = Intake(config).push(*events_of(samples, counted(samples.position_m, 4096)))
    true, found = (replay(each, Config()).figures()["nrmse_final"] for each in (samples, tracked))
    assert found < most * true


# Recordings


def joint_messages(seconds=20.0, rate_hz=200.0, *, velocity=False):
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    turning = 1.5 * np.cos(2 * np.pi * 0.5 * time)
    shown = np.round(np.cumsum(turning) / rate_hz * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    effort = 0.8 * np.tanh(turning / 0.05) + 0.3 * turning
    rows = zip(shown.tolist(), turning.tolist(), effort.tolist(), strict=True)
    return turning, [(["hip"], [x], [v] if velocity else [], [f]) for x, v, f in rows]


def test_a_joint_state_without_velocity_is_replayed_without_configuration(tmp_path):
    turning, messages = joint_messages()
    path = write_joint_bag(tmp_path / "bag", {"/joint_states": messages}, 200.0)
    recording = read_recording(path)
    assert any("no velocity: a tracking filter makes it of the position" in note for note in recording.notes)
    admitted = to_samples(recording, Config())
    assert len(admitted.samples) == len(messages) - WARM_UP + 1
    assert admitted.tracker is not None
    assert admitted.tracker.count == pytest.approx(2 * np.pi / 4096, rel=1e-3)
    assert relative_error(admitted.samples.velocity_m_s, turning[WARM_UP - 1 :]) < 0.02
    with pytest.raises(UnanswerableError, match="velocity is empty"):
        read_recording(path, Config().updated({"input.velocity_from": "topic"}).input)


def test_a_velocity_that_is_there_is_taken_unless_the_position_is_wanted(tmp_path):
    turning, messages = joint_messages(velocity=True)
    path = write_joint_bag(tmp_path / "bag", {"/joint_states": messages}, 200.0)
    plain = to_samples(read_recording(path), Config())
    assert plain.tracker is None
    np.testing.assert_array_equal(plain.samples.velocity_m_s, turning)
    config = Config().updated({"input.velocity_from": "position"})
    wanted = to_samples(read_recording(path, config.input), config)
    assert wanted.tracker is not None
    assert not np.array_equal(wanted.samples.velocity_m_s, turning[WARM_UP - 1 :])


def test_messages_of_joint_state_are_what_the_test_thinks():
    assert joint_state(START, ["hip"], [1.0], [], [2.0])
