"""The record of a diagnosis: time, place, pieces, standstill; and the same features live."""

from dataclasses import fields, replace

import numpy as np
import pytest

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.intake.encoder import wraps_undone
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.excitation import assess, notes
from friction_estimator.diagnosis.floor import noise_floor
from friction_estimator.diagnosis.record import blocks, build_record
from friction_estimator.effects.features import FeatureMaker

RATE_HZ = 100


def test_constant_friction_has_nothing_to_explain():
    samples = replace(recorded(), friction_N=np.full(len(recorded()), 3.3))
    with pytest.raises(UnanswerableError, match=r"friction is constant at 3\.3 N in all 6000 samples"):
        build_record([samples], Config())


def recorded(seconds=60.0, period_s=4.0, noise=0.0, pauses=(), origin=0.0, seed=0):
    """A sine with a position; `pauses` are (at, for) in s, over which nothing was recorded and the shaft stood."""
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    v = np.sin(2 * np.pi * t / period_s)
    x = origin + (1.0 - np.cos(2 * np.pi * t / period_s)) * period_s / (2 * np.pi)
    time = t.copy()
    restart = t == 0.0
    for at, span in pauses:
        time[t >= at] += span
        restart |= t == t[t >= at][0]
    shown = v + noise * np.random.default_rng(seed).standard_normal(t.size)
    stamps = 1 + np.round(time * NS_PER_S).astype(np.int64)
    return Samples(stamps, shown, np.sign(v) + 0.5 * v, restart, position_m=x)


def without(samples, first_s, last_s):
    """Return the samples without those of a piece, which begin anew after the gap."""
    time = (samples.stamp_ns - 1) / NS_PER_S
    kept = (time < first_s - 1e-6) | (time > last_s - 1e-6)
    parts = {f.name: getattr(samples, f.name) for f in fields(samples)}
    part = replace(samples, **{name: values[kept] for name, values in parts.items() if values is not None})
    part.restart[np.flatnonzero(np.diff(np.flatnonzero(kept)) > 1)[0] + 1] = True
    return part


def test_what_follows_a_gap_that_may_hide_a_reversal_is_left_out():
    """Where bristles stand then nobody knows, until the shaft has run 4 % of its stroke: 0.05 m at 1 m/s."""
    turned = build_record([without(recorded(), 21.0, 23.0)], Config())
    assert np.flatnonzero(~turned.used & (turned.features.time_s > 1.0)).tolist() == list(range(2100, 2106))
    # Back on the same side after a whole period: two reversals.
    twice = build_record([without(recorded(), 21.0, 25.0)], Config())
    assert not twice.used[2100]
    # No acceleration of this record turns the shaft within 50 ms.
    lost = build_record([without(recorded(), 21.0, 21.05)], Config())
    assert lost.used[2050:2200].all()


def test_what_follows_the_begin_of_a_recording_is_left_out():
    """Which way the shaft came before it nobody knows: the force of the first samples is that of another motion."""
    for parts in ([recorded()], [recorded(), recorded()]):
        data = build_record(parts, Config())
        run = np.concatenate([np.abs(part.position_m - part.position_m[0]) for part in parts])
        begin = np.concatenate([part.stamp_ns < part.stamp_ns[0] + 10**9 for part in parts])
        stroke = np.ptp(parts[0].position_m)
        assert not data.used[begin & (run < 0.0399 * stroke)].any()
        assert data.used[begin & (run > 0.0401 * stroke)].all()


def test_of_a_short_run_between_two_pauses_half_is_used():
    """Runs at constant speed, each from where the shaft was brought by hand: slow ones end within a length."""
    speeds = [sign * speed for speed in (0.005, 0.02, 0.1, 0.5, 1.0) for sign in (1.0, -1.0)]
    n = 3 * RATE_HZ
    v = np.repeat(speeds, n)
    x = np.concatenate([speed * np.arange(n) / RATE_HZ for speed in speeds])
    run = np.repeat(np.arange(len(speeds)), n)
    stamps = 1 + np.round((np.arange(v.size) / RATE_HZ + 10.0 * run) * NS_PER_S).astype(np.int64)
    begins = np.arange(v.size) % n == 0
    data = build_record([Samples(stamps, v, np.sign(v) + 0.5 * v, begins, position_m=x)], Config())
    used = data.used.reshape(len(speeds), n)
    assert not used[:, :2].any()
    assert np.all(used.mean(axis=1) > 0.45)
    assert np.all(used[-2:].mean(axis=1) > 0.9)  # a fast one loses 4 % of the whole way alone


def test_where_encoders_begin_is_no_way_that_a_shaft_runs():
    apart = build_record([recorded(), recorded(origin=100.0)], Config())
    together = build_record([recorded(), recorded()], Config())
    np.testing.assert_array_equal(apart.used, together.used)


def test_gaps_are_recorded_time_and_no_running_time():
    record = build_record([recorded(pauses=((20.0, 30.0), (40.0, 5.0)))], Config())
    f = record.features
    assert f.time_s[-1] == pytest.approx(60.0 + 35.0, abs=0.02)
    assert f.active_time_s[-1] == pytest.approx(60.0, abs=0.02)
    assert np.all(np.diff(f.active_time_s) > 0.0)
    assert f.piece[0] == 0
    assert f.piece[-1] == 2
    assert record.periods_s == pytest.approx((4.0,), rel=0.01)
    assert any("2 gaps or pauses of 35" in note for note in assess(record, record.context(Config(), 1.0)).notes)


def test_recordings_keep_their_origins_and_blocks():
    record = build_record([recorded(20.0), recorded(40.0, origin=7.0)], Config())
    f = record.features
    assert np.unique(f.recording).tolist() == [0, 1]
    np.testing.assert_array_equal(f.recording, record.recording)
    assert f.position_m[-1] > 6.9
    assert record.context(Config(), 1.0).stroke_m == pytest.approx(4.0 / np.pi, rel=0.01)
    for number in range(record.blocks):
        assert np.unique(record.recording[record.block == number]).size == 1
    first, second = record.pairs
    assert first.size > 1000
    np.testing.assert_array_equal(record.recording[first], record.recording[second])


def test_nothing_is_fitted_before_the_shaft_first_moves():
    """Which way it came nobody knows: a seal at rest on bristles carries its whole level, of either sign."""
    samples = recorded()
    assert samples.velocity_m_s[0] == 0.0
    record = build_record([samples], Config())
    assert not record.used[0]
    assert np.flatnonzero(record.standstill).tolist() == [0]


def test_a_short_recording_has_two_blocks_and_a_moment_one():
    number = blocks(np.repeat([0, 1, 2], [20_000, 130, 30]), 40)
    assert [np.unique(number[a:b]).size for a, b in ((20_000, 20_130), (20_130, 20_160))] == [2, 1]


def test_blocks_are_increasing_and_complete():
    recording = np.repeat([0, 1, 2], [500, 20, 80])
    number = blocks(recording, 12)
    assert np.unique(number).tolist() == list(range(int(number[-1]) + 1))
    assert set(np.diff(number).tolist()) <= {0, 1}


def test_noise_about_zero_resets_nothing():
    """Stops on the way and goes on; then turns back. Noise is a hundredth of the speed, once six of them."""
    v = np.repeat([1.0, 0.0, 1.0, 0.0, -1.0], 200) + 0.01 * np.random.default_rng(0).standard_normal(1000)
    v[300] = -0.06
    stamps = 1 + np.arange(1000, dtype=np.int64) * 10_000_000
    f = FeatureMaker(0.0, 0.0, 20.0, 0.05)(Samples(stamps, v, v, np.arange(1000) == 0))
    assert np.isinf(f.since_reversal_s[200:600][f.direction[200:600] > 0]).all(), "it only stood"
    assert np.isinf(f.since_reversal_s[400:600]).all()
    assert f.since_reversal_s[-1] == pytest.approx(2.0, abs=0.1)
    assert f.since_reversal_m[-1] == pytest.approx(2.0, rel=0.01)
    assert 0.0 < f.since_reversal_s[801] < 0.1, "the first samples of a stroke are known at once"


@pytest.mark.parametrize("seed", [0, 1])
def test_features_are_the_same_piece_by_piece(seed):
    samples = recorded(noise=0.02, pauses=((20.0, 30.0),), seed=seed)
    whole = FeatureMaker(101325.0, 0.0, 54.0, 0.03)(samples)
    make, rng, at = FeatureMaker(101325.0, 0.0, 54.0, 0.03), np.random.default_rng(seed), 0
    parts = []
    while at < len(samples):
        count = int(rng.choice([1, 2, 300]))
        parts.append(make(samples[at : at + count]))
        at += count
    for field in fields(whole):
        np.testing.assert_array_equal(
            np.concatenate([getattr(p, field.name) for p in parts]), getattr(whole, field.name)
        )


def ramped(knots_s, speeds):
    """A velocity that is linear between knots, again and again from the last one on, and its acceleration."""
    knots, time = np.array(knots_s), np.arange(len(recorded())) / RATE_HZ
    velocity = np.interp(time % knots[-1], knots, speeds)
    slope = (np.diff(speeds) / np.diff(knots))[np.searchsorted(knots, (time - 1e-9) % knots[-1]) - 1]
    return replace(recorded(), velocity_m_s=velocity, position_m=None), slope


def test_kinks_of_a_drive_of_ramps_are_left_out():
    """Which of two accelerations holds there lies between two samples."""
    samples, _ = ramped([0.0, 0.5, 2.0, 2.5, 3.0, 3.505, 5.0, 6.0], [0.0, 1.0, 1.0, 0.4, 0.4, -1.0, -1.0, 0.0])
    record = build_record([samples], Config())
    left_out = np.flatnonzero(~record.used[600:]) % 600
    # The one that lies between two samples shows in both.
    kinks = {0, 50, 200, 250, 300, 350, 351, 500}
    assert set(left_out) == kinks
    assert any(" samples at kinks of the velocity are left out" in note for note in notes(record))


def test_the_acceleration_of_ramps_is_theirs_but_at_kinks():
    """No parabola reaches over a kink: it overshot by half of it in the sample after."""
    samples, true = ramped([0.0, 0.5, 2.0, 2.5, 3.003, 3.509, 5.0, 6.0], [0.0, 1.0, 1.0, 0.4, 0.4, -1.0, -1.0, 0.0])
    record = build_record([samples], Config())
    used = np.flatnonzero(record.used)
    np.testing.assert_allclose(record.features.acceleration_m_s2[used], true[used], atol=1e-6)


def test_steps_of_the_velocitys_lattice_are_no_kinks():
    """Between them it bends by rounding alone, beside which each step stood out: a tenth of a record was left out."""
    knots_s = [0.0, 0.4, 2.4, 3.0, 5.0, 5.6, 8.0]
    samples, _ = ramped(knots_s, [0.0, 1.0, 1.0, 0.4, 0.4, -1.0, 0.0])
    samples = replace(samples, velocity_m_s=4e-4 * np.round(0.08 * samples.velocity_m_s / 4e-4))
    left_out = np.flatnonzero(~build_record([samples], Config()).used[800:]) % 800
    assert all(np.abs(k - RATE_HZ * np.array(knots_s)).min() <= 1 for k in left_out)


def test_a_jump_of_the_velocity_is_no_kink():
    """A measured seal's velocity jumps in every stroke; with both samples of each left out another cause was named."""
    samples = recorded()
    jumps = np.repeat(np.random.default_rng(0).choice([-0.3, 0.0, 0.3], len(samples) // 100), 100)
    jumping = replace(samples, velocity_m_s=samples.velocity_m_s + jumps, position_m=None)
    record = build_record([jumping], Config())
    assert record.used[200:].all()
    assert notes(record) == []


@pytest.mark.parametrize("lattice", [0.0, 1e-3])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_no_smooth_drive_has_kinks_however_unlike_its_parts(noise, lattice):
    """A tenth of it bends five hundred times as much as the rest."""
    slow, fast = recorded(54.0, 8.0, noise), recorded(6.0, 1.0, noise)
    both = replace(
        recorded(),
        velocity_m_s=np.concatenate([slow.velocity_m_s, 8.0 * fast.velocity_m_s]),
        position_m=None,
    )
    if lattice:
        both = replace(both, velocity_m_s=lattice * np.round(both.velocity_m_s / lattice))
    left_out = ~build_record([both], Config()).used
    moved = np.arange(len(both)) > 100
    assert left_out[moved].sum() < 10


def test_standstill_is_masked_and_said():
    samples = recorded()
    rests = np.abs(samples.velocity_m_s) < 0.4
    ramps = 0.9 * np.sin(np.arange(len(samples)) / 50.0)
    stuck = replace(
        samples,
        velocity_m_s=np.where(rests, 0.0, samples.velocity_m_s),
        friction_N=np.where(rests, ramps, samples.friction_N),
        position_m=None,
    )
    record = build_record([stuck], Config())
    np.testing.assert_array_equal(record.standstill, rests)
    np.testing.assert_array_equal(record.used[50:], ~rests[50:])  # before that it has not run 4 % of its stroke
    assert any("stands for" in note for note in assess(record, record.context(Config(), 1.0)).notes)
    moving = build_record([samples], Config()).standstill
    assert not moving[1:].any()  # the first sample comes before the shaft first moves


def test_a_wrapped_position_is_unwrapped_for_callers_without_an_intake_and_noted():
    samples = recorded(period_s=20.0)
    wrapped = replace(samples, position_m=(samples.position_m + 1.0) % 3.0)
    record = build_record([wrapped, wrapped], Config())
    count = np.count_nonzero(np.abs(np.diff(wrapped.position_m)) > 1.5)
    assert wraps_undone(record.samples).count == 2 * count
    assert np.ptp(record.features.position_m[:6000] - samples.position_m) < 0.02
    notes = assess(record, record.context(Config(), 1.0)).notes
    assert any(f"wrapped {2 * count} times by " in note for note in notes)


def test_one_direction_is_said():
    samples = recorded()
    record = build_record([replace(samples, velocity_m_s=2.0 + samples.velocity_m_s, position_m=None)], Config())
    found = assess(record, record.context(Config(), 1.0))
    assert any("one direction only" in warning for warning in found.warnings)
    assert record.periods_s == pytest.approx((4.0,), rel=0.01)


def test_repaired_channels_keep_masks():
    record = build_record([recorded()], Config())
    used = record.used.copy()
    used[100:200] = False
    again = record.with_force(record.friction_N + 1.0, used).with_channels(
        Config(), velocity_m_s=2.0 * record.samples.velocity_m_s
    )
    np.testing.assert_array_equal(again.used, used)
    np.testing.assert_array_equal(again.friction_N, record.friction_N + 1.0)
    assert again.reversal_speed_m_s == pytest.approx(2.0 * record.reversal_speed_m_s)


def test_cycles_that_take_as_long_and_are_others_are_no_pairs():
    """Strokes of a robot's trajectory: equal in time, each at another place with another speed."""
    t = np.arange(120 * RATE_HZ) / RATE_HZ
    cycle = np.floor(t / 4.0).astype(int) % 3
    v = np.array([1.0, 0.3, 0.6])[cycle] * np.sin(2 * np.pi * t / 4.0)
    x = np.cumsum(v) / RATE_HZ
    ripple = 0.2 * np.cos(2 * np.pi * x / 0.05)
    stamps = 1 + np.round(t * NS_PER_S).astype(np.int64)
    data = build_record([Samples(stamps, v, np.sign(v) + ripple, t == 0.0, position_m=x)], Config())
    first, second = data.pairs
    assert first.size > 0.4 * t.size
    again = np.abs(data.features.position_m[first] - data.features.position_m[second])
    assert float(np.median(again)) < 0.01
    assert noise_floor(data, ripple) < 1e-3  # it was 0.139 where neighbouring cycles were paired: all of the ripple
