"""Load terms: what is known is taken off, what is unknown is learned, what the drive cannot tell apart is said."""

import re

import numpy as np
import pytest

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.batch import fit_batch, predict
from friction_estimator.core.fit.load_report import LearnedLoad
from friction_estimator.core.intake.acceleration import AccelerationFilter
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, VELOCITY
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.load import LOADS, LoadTerms, parse_term
from friction_estimator.core.online import recovery, workspace
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.online.replay import replay
from friction_estimator.core.quantities import ROTARY, Quantities
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings.config import Config

RATE = 200.0
NOISE = 0.002
"""N m: 1 % of the friction."""

INERTIA, SIN, COS = 0.03, 1.1, -0.4
MULTISINE = ((0.35, 0.7), (0.9, 0.35), (1.7, 0.12))
"""Frequency (Hz) and amplitude (rad) of the lines."""

BASE = {"model.type": "hammerstein", "theory.kind": "none", "input.motion": "rotary"}


def config(terms, **more):
    return Config.from_mapping(BASE | {"load.terms": terms} | {k.replace("__", "."): v for k, v in more.items()})


def motion(lines=MULTISINE, seconds=40.0, rate=RATE):
    """Return time, position, velocity and acceleration of a sum of sines."""
    t = np.arange(int(seconds * rate)) / rate
    parts = [(2 * np.pi * f, a, 2 * np.pi * f * t + k) for k, (f, a) in enumerate(lines)]
    q = sum(a * np.sin(p) for _, a, p in parts)
    v = sum(a * w * np.cos(p) for w, a, p in parts)
    return t, q, v, sum(-a * w * w * np.sin(p) for w, a, p in parts)


def friction_of(v):
    return 0.15 * np.tanh(v / 0.05) + 0.08 * np.tanh(v / 0.6) + 0.03 * v


def events_of(t, q, v, effort):
    stamp = 10**18 + np.round(t * 1e9).astype(np.int64)
    channels = [(POSITION, q), (VELOCITY, v), (FRICTION, effort)]
    stream = np.tile([number for number, values in channels if values is not None], t.size)
    values = np.column_stack([values for _, values in channels if values is not None]).ravel()
    return stream, np.repeat(stamp, stream.size // t.size), values


def admitted(given, t, q, v, effort):
    intake = Intake(given, capacity=t.size + 1)
    samples, last = intake.push(*events_of(t, q, v, effort)), intake.drain()
    return samples if last is None else in_sequence([samples, last])


def pendulum(lines=MULTISINE, seed=0, seconds=40.0):
    """Return time, position, velocity and effort of a driven pendulum with 1 % noise."""
    t, q, v, a = motion(lines, seconds)
    effort = friction_of(v) + INERTIA * a + SIN * np.sin(q) + COS * np.cos(q)
    return t, q, v, effort + NOISE * np.random.default_rng(seed).standard_normal(t.size)


def fitted(given, samples):
    met = chosen(given, samples)
    return fit_batch(samples, met, use=~standstill(samples, met.velocity_scale))


def friction_error(run, velocity):
    """Rms error of the static curve over the velocities driven, beside friction measured with its noise, N m."""
    curve = np.interp(velocity, run.curve.velocity_m_s, run.curve.friction_N)
    return np.hypot(np.sqrt(np.mean(np.square(curve - friction_of(velocity)))), NOISE)


SI = Quantities(ROTARY)

TRUTH = {"inertia": INERTIA, "gravity:sin": SIN, "gravity:cos": COS}


def test_unknown_terms_are_learned_within_their_intervals_by_fit_and_by_rls():
    given = config(["inertia", "gravity"])
    samples = admitted(given, *pendulum())
    online, known = replay(samples, given), config(["inertia=0.03", "gravity:sin=1.1,cos=-0.4"])
    for found in (fitted(given, samples).loads, online.loads):
        assert [load.term for load in found] == list(TRUTH)
        for load in found:
            assert load.separated, load.reason
            assert load.ci95[0] <= TRUTH[load.term] <= load.ci95[1]
            assert load.ci95[1] - load.ci95[0] < 0.1 * max(TRUTH[load.term], 0.3)
        assert [load.unit for load in found] == ["kg m2", "N m", "N m"]
    # The friction is that with the load known.
    told = replay(admitted(known, *pendulum()), known)
    unknown_error, known_error = (friction_error(run, samples.velocity_m_s) for run in (online, told))
    assert unknown_error < 1.1 * known_error
    assert online.config.unit_N < 0.4  # that of friction, not of the effort


def test_spikes_of_the_effort_do_not_make_the_unit_of_force():
    given = config(["inertia", "gravity"])
    t, q, v, effort = pendulum()
    clean = replay(admitted(given, t, q, v, effort), given)
    effort[[10, 500, 501, 3000]] = 1e6, -1e6, 1e6, 1e6
    spiked = replay(admitted(given, t, q, v, effort), given)
    assert spiked.config.unit_N == pytest.approx(clean.config.unit_N, rel=0.05)
    for load in spiked.loads:
        assert load.separated, load.reason
        assert load.ci95[0] <= TRUTH[load.term] <= load.ci95[1]
        assert load.ci95[1] - load.ci95[0] < 0.3 * max(TRUTH[load.term], 0.3)


def test_one_sine_does_not_tell_an_inertia_from_a_spring():
    given = config(["inertia", "spring"])
    t, q, v, a = motion(((0.5, 0.8),))
    samples = admitted(given, t, q, v, friction_of(v) + INERTIA * a + 0.6 * q)
    for found in (fitted(given, samples).loads, replay(samples, given).loads):
        for load, other in zip(found, ("spring", "inertia"), strict=True):
            assert not load.separated
            assert load.ci95 is None
            assert f"{other} acts alike" in load.reason
            assert "second period" in load.reason


def test_a_constant_is_not_told_from_friction_that_differs_between_the_directions():
    given = config(["constant"])
    t, q, v, _ = motion()
    unlike = np.where(v > 0.0, 1.2, 0.8) * friction_of(v)
    samples = admitted(given, t, q, v, unlike + 0.002 * np.random.default_rng(1).standard_normal(t.size))
    for found in (fitted(given, samples).loads, replay(samples, given).loads):
        (load,) = found
        assert not load.separated or load.ci95[0] <= 0.0 <= load.ci95[1]


@pytest.mark.parametrize("law", ["nlms", "lms"])
def test_a_law_without_covariance_gives_values_and_no_interval(law):
    given = config(["inertia", "gravity"], model__law=law)
    found = replay(admitted(given, *pendulum()), given)
    assert all(load.ci95 is None and "covariance" in load.reason for load in found.loads)
    assert found.figures()["nrmse_final"] < 0.2


def test_what_is_known_is_taken_off_and_what_is_not_needed_costs_nothing():
    t, q, v, effort = pendulum(seed=3)
    plain = admitted(config([]), t, q, v, effort)
    np.testing.assert_array_equal(plain.friction_N, effort)
    assert plain.acceleration_m_s2 is None
    less = admitted(config(["gravity:sin=1.1,cos=-0.4", "constant=0.5"]), t, q, v, effort)
    np.testing.assert_allclose(less.friction_N, effort - SIN * np.sin(q) - COS * np.cos(q) - 0.5, atol=1e-12)
    part = LoadTerms(config(["gravity:cos=0"]))
    assert [p.label for p in part.unknown] == ["gravity:sin"]


def test_position_is_integrated_where_none_is_recorded():
    given = config(["gravity:sin=1.0,cos=0"])
    t, q, v, _ = motion()
    samples = admitted(given, t, None, v, np.zeros(t.size))
    np.testing.assert_allclose(samples.friction_N, -np.sin(q - q[0]), atol=2e-3)


def test_samples_come_late_by_half_the_window_and_belong_to_one_instant():
    given = config(["inertia"], load__half_width=0.02)
    t, q, v, a = motion()
    intake = Intake(given, capacity=t.size + 1)
    early = intake.push(*events_of(t, q, v, a))
    assert (len(early), intake.admitted, intake.sequencer.admitted) == (t.size - 4, t.size - 4, t.size)
    last = intake.drain()
    assert len(last) == 4
    whole = in_sequence([early, last])
    np.testing.assert_array_equal(whole.velocity_m_s, v)
    inside = slice(4, -4)
    np.testing.assert_allclose(whole.acceleration_m_s2[inside], a[inside], atol=2e-3 * np.abs(a).max())


def test_acceleration_of_uneven_stamps_is_exact_for_cubics_and_does_not_reach_over_gaps():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.002, 0.008, 300))
    restart = np.isin(np.arange(300), (0, 100, 101, 103, 250))
    v = 0.3 + 2.0 * t - t**2 + 0.4 * t**3
    stamps = np.round(t * 1e9).astype(np.int64)
    samples = Samples(stamps, v, np.zeros(300), restart)
    wanted = 2.0 - 2.0 * t + 1.2 * t**2

    def filtered(sizes):
        given, parts, at = AccelerationFilter(0.025), [], 0
        for size in sizes:
            parts.append(given.push(samples[at : at + size]))
            at += size
        return in_sequence([*parts, given.drain()])

    whole = filtered([300])
    few = np.isin(np.arange(300), (100, 101, 102))  # pieces of one and two samples
    np.testing.assert_allclose(whole.acceleration_m_s2[~few], wanted[~few], rtol=1e-5)
    assert whole.acceleration_m_s2[100] == 0.0
    for sizes in ([1] * 300, [7, 93, 0, 3, 97, 100]):
        parts = filtered(sizes)
        assert parts.acceleration_m_s2.tobytes() == whole.acceleration_m_s2.tobytes()
        assert parts.restart.tobytes() == restart.tobytes()


@pytest.mark.parametrize(
    "terms",
    [
        ["inertia", "gravity"],
        ["inertia=0.03", "spring"],
        ["constant=0.2"],
        ["load_dependence", "inertia=0.03", "gravity"],
    ],
)
def test_the_live_step_gives_what_replay_gives(terms):
    given = config(terms)
    t, q, v, effort = pendulum(seconds=6.0)
    t = t + np.where(t > 4.0, 3.0, 0.0)  # a gap
    replayed = replay(admitted(given, t, q, v, effort), given)
    step, found = LiveStep(Intake(given), given), []
    stream, stamp, value = events_of(t, q, v, effort)
    for at in range(0, stream.size, 3):
        step.stream[:3], step.stamp_ns[:3], step.value[:3] = (x[at : at + 3] for x in (stream, stamp, value))
        found += step.run(3, learn=True)
    live = np.array([predicted for *_, predicted, _ in found])
    late = 5 if LoadTerms(given).needs("acceleration") else 0
    assert live.size == t.size - late
    np.testing.assert_array_equal(live, replayed.predicted_N[: live.size])


def test_a_force_unit_that_rises_keeps_what_was_learned_of_the_load():
    """The first contact meets a tenth of the speed and of the friction: range and unit grow with what follows."""
    given = config(["inertia", "gravity"])
    t, q, v, effort = pendulum(seconds=12.0)
    slow = np.arange(1200) / RATE
    dither = 0.02 * np.sin(2.0 * np.pi * 0.4 * slow)
    quiet = 0.01 * np.tanh(np.gradient(dither, slow) / 1e-3) + SIN * np.sin(dither) + COS * np.cos(dither)
    t = np.concatenate([slow, slow[-1] + 1.0 / RATE + t])
    both = [np.concatenate(pair) for pair in ((dither, q), (np.gradient(dither, slow), v), (quiet, effort))]
    samples = admitted(given, t, *both)
    online = replay(samples, given)
    assert online.estimator.config.unit_N > 1.5 * online.contact.config.unit_N
    for load in online.loads:
        assert load.value == pytest.approx(TRUTH[load.term], abs=0.05)
    step, found = LiveStep(Intake(given), given), []
    stream, stamp, value = events_of(t, *both)
    for at in range(0, stream.size, 3):
        step.stream[:3], step.stamp_ns[:3], step.value[:3] = (x[at : at + 3] for x in (stream, stamp, value))
        found += step.run(3, learn=True)
    live = np.array([predicted for *_, predicted, _ in found])
    np.testing.assert_array_equal(live, online.predicted_N[: live.size])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("weight", "unknown load term 'weight': choose one of inertia"),
        ("inertia=heavy", "is not inertia=number"),
        ("inertia=1e13", "is not inertia=number"),
        ("inertia=nan", "is not inertia=number"),
        ("gravity=3", "gravity:sin=VALUE,cos=VALUE"),
        ("spring:center=0", "no 'center'; it has stiffness, centre"),
        ("spring:centre", "is not centre=number"),
        ("gravity:sin=1,sin=2", "sin is given twice"),
        ("load_dependence=0.03", "name it alone"),
    ],
)
def test_a_term_that_cannot_be_read_is_refused_in_one_line(text, words):
    with pytest.raises(ConfigError, match=words) as caught:
        parse_term(text)
    assert str(caught.value).startswith("load.terms: ")
    assert "\n" not in str(caught.value)


def test_a_coefficient_is_named_once():
    with pytest.raises(ConfigError, match="inertia is named twice"):
        LoadTerms(config(["inertia=2", "inertia"]))


def test_friction_that_follows_the_load_needs_one():
    with pytest.raises(ConfigError, match="name these too"):
        LoadTerms(config(["load_dependence"]))


@pytest.mark.parametrize("name", list(LOADS))
def test_columns_are_finite_for_wild_samples(name):
    given = config(
        [name, "inertia"] if name == "load_dependence" else [name], basis__velocity_range=[-1.0, 1.0], force_unit=1.0
    )
    t, q, v, effort = pendulum(seconds=4.0)
    v[100], q[200] = 1e12, 1e12
    samples = admitted(given, t, q, v, effort)
    estimator = Estimator(given)
    assert np.isfinite(estimator.run(samples)).all()
    estimator.check_state()


def test_a_state_keeps_the_load_and_one_from_before_is_one_without():
    given = config(["inertia"], basis__velocity_range=[-6.0, 6.0], force_unit=0.3)
    samples = admitted(given, *pendulum(seconds=6.0))
    one, two = Estimator(given), Estimator(given)
    one.run(samples)
    two.restore(one.state())
    assert two.loads == one.loads
    assert Estimator(one.learned_config).parameters.load_weights.tolist() == one.parameters.load_weights.tolist()
    bare = config([], basis__velocity_range=[-6.0, 6.0], force_unit=0.3)
    former = Estimator(bare).state()
    del former["structure"]["load.terms"], former["structure"]["load.half_width"]
    Estimator(bare).restore(former)
    with pytest.raises(ConfigError, match=r"load\.terms"):
        Estimator(given).restore(former)
    without = one.state()
    del without["arrays"]["noise"]  # as from before it was there
    Estimator(given).restore(without)
    del without["arrays"]["residual"]
    two.restore(without)
    assert two.work.residual[recovery.PRESENT] == one.work.moments[workspace.MISFIT_POWER] > 0.0
    for value in (-1.0, np.nan):
        unsound = one.state()
        unsound["arrays"]["noise"][0, 0] = value
        with pytest.raises(ConfigError, match="state array noise"):
            two.restore(unsound)


def test_the_mass_of_a_measured_axis_is_found(shared_data):
    """Published: 95.109 kg by another model of the friction (Janot, Gautier, Brunot 2019)."""
    table = np.genfromtxt(shared_data / "emps_nlgreyfast" / "data.csv", delimiter=",", names=True)
    given = Config.from_mapping({"model.type": "hammerstein", "theory.kind": "none", "load.terms": ["inertia"]})
    columns = (table[name] for name in ("t_s", "q_filt_m", "v_m_s", "motor_force_N"))
    (mass,) = fitted(given, admitted(given, *columns)).loads
    assert mass.unit == "kg"
    assert mass.separated
    assert mass.ci95[0] <= 95.109 <= mass.ci95[1]
    assert mass.ci95[1] - mass.ci95[0] < 3.5


def test_after_a_change_of_the_friction_the_load_is_learned_anew():
    given = config(["inertia", "gravity"])
    t, q, v, effort = pendulum()
    effort = effort + np.where(t > 15.0, 0.6, 0.0) * friction_of(v)
    online = replay(admitted(given, t, q, v, effort), given)
    assert online.health.alarmed > online.health.restored
    for load in online.loads:
        assert load.separated, load.reason
        assert load.ci95[0] <= TRUTH[load.term] <= load.ci95[1], load.text(SI)


def slow_then_fast(seed: int, slow_seconds: float = 60.0):
    """Return time, position, noisy velocity and effort: inertia acts like gravity on a slow sine, then not."""
    parts = [motion(((f, 0.9),), seconds) for f, seconds in ((0.25, slow_seconds), (0.7, 12.0))]
    slow, fast = (part[0] for part in parts)
    t = np.append(slow, slow[-1] + 1.0 + fast)  # a gap: no shaft jumps from one sine into the other
    q, v, a = (np.concatenate([part[k] for part in parts]) for k in (1, 2, 3))
    rng = np.random.default_rng(seed)
    effort = friction_of(v) + INERTIA * a + SIN * np.sin(q) + COS * np.cos(q) + NOISE * rng.standard_normal(t.size)
    return t, q, v + 0.003 * np.abs(v).max() * rng.standard_normal(t.size), effort


def test_an_interval_of_rls_is_as_wide_as_that_of_the_fit():
    """Where a turn of the shaft is sharper than the basis most of the misfit is in a few samples about it."""
    given = config(["inertia", "gravity"])
    t, q, v, a = motion(MULTISINE, 40.0)
    load, rng = INERTIA * a + SIN * np.sin(q) + COS * np.cos(q), np.random.default_rng(2)
    effort = np.tanh(v / 0.02) * (0.5 + 0.3 * np.exp(-np.abs(v) / 0.3)) + load + NOISE * rng.standard_normal(t.size)
    samples = admitted(given, t, q, v + 0.003 * np.abs(v).max() * rng.standard_normal(t.size), effort)
    for ours, theirs in zip(replay(samples, given).loads, fitted(given, samples).loads, strict=True):
        assert ours.separated
        assert theirs.separated
        assert 0.75 < (ours.ci95[1] - ours.ci95[0]) / (theirs.ci95[1] - theirs.ci95[0]) < 1.5, ours.text(SI)


@pytest.mark.parametrize("fault", [lambda effort: effort[0], lambda effort: 1e6])
def test_a_fault_that_was_undone_leaves_the_intervals_as_they_were(fault):
    """Two seconds of a stuck or broken sensor: an alarm, then the model from before."""
    given = config(["inertia", "gravity"])
    t, q, v, effort = pendulum(seconds=60.0)
    clean = replay(admitted(given, t, q, v, effort), given)
    effort[6000:6400] = fault(effort[6000:])
    samples = admitted(given, t, q, v, effort)
    judged = replay(samples, given)
    assert judged.estimator.health.restored == 1
    for ours, before in zip(judged.loads, clean.loads, strict=True):
        assert ours.separated, ours.text(SI)
        assert ours.ci95[0] <= TRUTH[ours.term] <= ours.ci95[1]
        assert 0.8 < (ours.ci95[1] - ours.ci95[0]) / (before.ci95[1] - before.ci95[0]) < 1.5
    # While it is held the model from before predicts, and its intervals are told.
    estimator = Estimator(chosen(given, samples[:2000]))
    estimator.run(samples[:6000])
    calm = estimator.loads
    estimator.run(samples[6000:6200])
    assert estimator.health.held
    for held, before in zip(estimator.loads, calm, strict=True):
        assert held.separated, held.text(SI)
        assert 0.8 < (held.ci95[1] - held.ci95[0]) / (before.ci95[1] - before.ci95[0]) < 1.5


def test_noise_of_the_acceleration_does_not_separate_an_inertia():
    """One slow sine: but for a third harmonic of some per cent, position and acceleration are one."""
    given = config(["inertia", "gravity"])
    t, q, v, effort = slow_then_fast(1)
    slow = slice(0, round(40 * RATE))
    samples = admitted(given, t[slow], q[slow], v[slow], effort[slow])
    for found in (fitted(given, samples).loads, replay(samples, given).loads):
        for load in found:
            assert not load.separated or load.ci95[0] <= TRUTH[load.term] <= load.ci95[1], load.text(SI)
        assert not found[0].separated


@pytest.mark.parametrize("seed", [1, 2])
def test_a_direction_that_the_drive_first_shows_after_a_minute_is_learned_and_no_alarm(seed):
    given = config(["inertia", "gravity"])
    online = replay(admitted(given, *slow_then_fast(seed)), given)
    assert online.health.alarmed == 0
    for load in online.loads[:2]:
        assert load.separated, load.reason
        assert load.ci95[0] <= TRUTH[load.term] <= load.ci95[1]
        assert load.value == pytest.approx(TRUTH[load.term], rel=0.1)


def test_the_variance_of_an_acceleration_is_that_of_its_noise():
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.001, 0.003, 20000))
    stamps = np.round(t * 1e9).astype(np.int64)
    clean, noisy = np.sin(2.0 * t), np.sin(2.0 * t) + 0.01 * rng.standard_normal(t.size)
    found = []
    for v in (clean, noisy):
        given = AccelerationFilter(0.025)
        samples = Samples(stamps, v, np.zeros(t.size), np.arange(t.size) == 0)
        found.append(in_sequence([given.push(samples), given.drain()]))
    error = found[1].acceleration_m_s2 - found[0].acceleration_m_s2
    assert np.mean(found[1].acceleration_variance) == pytest.approx(np.mean(np.square(error)), rel=0.05)
    assert found[0].acceleration_variance.max() < 1e-4 * found[1].acceleration_variance.mean()


SHARE = 0.06


def geared(seed: int, share: float = SHARE, drive: float = 1.0):
    """A pendulum behind a gear whose teeth rub in proportion to what they carry."""
    t, q, v, a = motion(tuple((drive * f, amplitude) for f, amplitude in MULTISINE))
    load = INERTIA * a + SIN * np.sin(q) + COS * np.cos(q)
    effort = friction_of(v) + share * np.abs(load) * np.tanh(v / 0.05) + load
    return t, q, v, effort + NOISE * np.random.default_rng(seed).standard_normal(t.size)


@pytest.mark.parametrize("share", [SHARE, 0.0])
def test_friction_that_follows_the_load_is_told_from_it(share):
    given = config(["load_dependence", "inertia", "gravity"])
    samples = admitted(given, *geared(1, share))
    batch, online = fitted(given, samples), replay(samples, given)
    for found in (batch.loads, online.loads):
        assert [load.term for load in found] == [*TRUTH, "load_dependence"]
        for load in found:
            assert load.separated, load.reason
            assert load.ci95[0] <= {**TRUTH, "load_dependence": share}[load.term] <= load.ci95[1], load.text(SI)
        assert found[-1].ci95[1] - found[-1].ci95[0] < 0.05
    # What is predicted with fixed values is what the loop predicts, the size of the load taken from the same values.
    fixed = online.estimator.parameters
    frozen = Estimator(online.estimator.config.updated({}))
    frozen.parameters = fixed
    np.testing.assert_allclose(
        frozen.run(samples, learn=False), predict(samples, online.estimator.config, fixed), atol=1e-12
    )


def test_without_the_term_what_follows_the_load_is_named():
    given = config(["inertia", "gravity"])
    t, q, v, effort = geared(2, share=0.5)
    judged = replay(admitted(given, t, q, v, effort), given, freeze_after=0.5)
    (found,) = judged.shortcomings
    assert found.name == "load"
    assert "load_dependence" in found.advice


def test_a_load_given_in_another_scale_than_the_effort_is_named_and_the_advice_helps():
    """The torque channel is 1.4 times too large."""
    terms = [f"inertia={INERTIA}", f"gravity:sin={SIN},cos={COS}"]
    t, q, v, effort = pendulum()
    given = config(terms)
    judged = replay(admitted(given, t, q, v, 1.4 * effort), given, freeze_after=0.5)
    (found,) = judged.shortcomings
    assert found.name == "load_scale"
    times = float(re.search(r"divide it by ([\d.]+)", found.advice)[1])
    assert times == pytest.approx(1.4, abs=0.05)
    helped = replay(admitted(given, t, q, v, 1.4 * effort / times), given, freeze_after=0.5)
    assert not helped.shortcomings
    assert helped.figures()["nrmse_frozen"] < 0.3 * judged.figures()["nrmse_frozen"]


@pytest.mark.parametrize(
    ("holds", "seen", "advice"),
    [(0.0, "nothing of the load given", "leave those terms out"), (-1.0, "-1.0[0-9] times", "the other way about")],
)
def test_a_load_that_the_effort_does_not_hold_or_holds_turned_round_is_no_scale(holds, seen, advice):
    t, q, v, a = motion()
    load = INERTIA * a + SIN * np.sin(q) + COS * np.cos(q)
    given = config([f"inertia={INERTIA}", f"gravity:sin={SIN},cos={COS}"])
    (found,) = replay(admitted(given, t, q, v, friction_of(v) + holds * load), given, freeze_after=0.5).shortcomings
    assert found.name == "load_scale"
    assert re.search(seen, found.text)
    assert advice in found.advice
    assert "divide" not in found.advice


def test_a_load_is_told_in_the_readers_units():
    shown = SI.in_units(["mNm"])
    assert LearnedLoad("gravity:sin", 1.2, "N m", (1.1, 1.3), True, "").told(shown) == (
        "1200 mN m",
        "[1100, 1300] mN m",
    )
    assert LearnedLoad("load_dependence", 0.03, "1", (0.02, 0.04), True, "").told(shown) == ("0.03", "[0.02, 0.04]")
