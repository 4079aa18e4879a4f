"""Fits to the past from which rls goes on: what they gain, and that nothing else depends on them."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.online import relinearisation, workspace
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.online.relinearisation import Kept
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.derive import with_recorded_units
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.simulate import Scenario, simulate

SMALL = {"model.type": "parallel", "fir.order": 2, "basis.finest_level": 1}


def recorded(condition, seconds, rate_hz=1000.0, noise=0.01, seed=0):
    period, pressure = CONDITIONS[condition]
    scenario = Scenario((segment(period, pressure, seconds),), rate_hz=rate_hz, noise=noise, seed=seed)
    return simulate(scenario).paired()


def estimator_for(samples, **settings):
    config = Config.from_mapping({name.replace("__", "."): value for name, value in settings.items()})
    return Estimator(with_recorded_units(config.updated(SMALL), samples.velocity_m_s, samples.friction_N))


@pytest.fixture(scope="module")
def samples():
    return recorded("b", 12.0)


def first_adoption(samples):
    """Return where the first adopted fit was started and adopted, in samples."""
    estimator = estimator_for(samples)
    started = 0
    for k in range(len(samples)):
        before = int(estimator._work.status[workspace.PROPOSED])
        estimator.run(samples[k : k + 1])
        after = int(estimator._work.status[workspace.PROPOSED])
        if after and not before:
            started = k + 1
        if estimator.health.adopted:
            return started, k + 1
    pytest.fail("no fit was adopted: these tests would show nothing")


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_parallel_model_leaves_the_valley_in_which_rls_creeps():
    """Condition b: the best fit plays the two branches against each other with weights twenty times as large."""
    samples = recorded("b", 30.0)
    config = with_recorded_units(
        Config.from_mapping({"model.type": "parallel"}), samples.velocity_m_s, samples.friction_N
    )
    last = slice(-5000, None)
    batch = rms((samples.friction_N - fit_batch(samples, config).predicted_N)[last])
    error = {
        on: rms((samples.friction_N - Estimator(config.updated({"rls.relinearise": on})).run(samples))[last])
        for on in (True, False)
    }
    assert error[True] < 1.05 * batch
    assert error[False] > 1.15 * batch


def test_adoption_does_not_depend_on_how_long_the_fit_takes(samples, monkeypatch):
    quick = estimator_for(samples)
    expected = quick.run(samples)
    propose = relinearisation.propose

    def slow(*arguments):
        time.sleep(0.2)
        return propose(*arguments)

    monkeypatch.setattr(relinearisation, "propose", slow)
    np.testing.assert_array_equal(estimator_for(samples).run(samples), expected)


def test_adopted_fits_change_what_is_predicted(samples):
    assert not np.array_equal(
        estimator_for(samples).run(samples), estimator_for(samples, rls__relinearise=False).run(samples)
    )


@pytest.mark.parametrize("part", [1, 7, 1000])
def test_parts_give_what_the_whole_gives(samples, part):
    whole, parts = estimator_for(samples), estimator_for(samples)
    count = first_adoption(samples)[1] + 200
    expected = whole.run(samples[:count])
    got = np.concatenate([parts.run(samples[k : min(k + part, count)]) for k in range(0, count, part)])
    np.testing.assert_array_equal(got, expected)
    assert whole.health.adopted == 1


def test_the_live_path_adopts_the_same_fit(samples):
    config = estimator_for(samples).config
    count = first_adoption(samples)[1] + 200
    live = Estimator(config)
    step = LiveStep(Intake(config), live)
    got = []
    for k in range(count):
        stamp = int(samples.stamp_ns[k])
        step.stream[:2], step.stamp_ns[:2] = (VELOCITY, FRICTION), (stamp, stamp)
        step.value[:2] = samples.velocity_m_s[k], samples.friction_N[k]
        got += [predicted for *_, predicted in step.run(2, learn=True)]
    blind = replace(samples, pressure_Pa=None, temperature_degC=None, position_m=None)
    expected = Estimator(config).run(blind[:count])
    np.testing.assert_array_equal(got, expected)
    assert live.health.adopted == 1


def test_state_saved_while_a_fit_is_under_way_continues_bit_for_bit(samples):
    started, adopted = first_adoption(samples)
    expected = estimator_for(samples).run(samples)
    for cut in (started, started + 1, adopted - 1, adopted, adopted + 1):
        first = estimator_for(samples)
        first.run(samples[:cut])
        state = first.state()
        assert state["arrays"]["proposal"].any()
        second = estimator_for(samples)
        second.restore(state)
        np.testing.assert_array_equal(second.run(samples[cut:]), expected[cut:])
        np.testing.assert_array_equal(first.run(samples[cut:]), expected[cut:])  # saving changes nothing
    first = estimator_for(samples)
    first.run(samples[: started + 1])
    state = first.state()
    state["arrays"]["proposal"][:] = 0.0
    second = estimator_for(samples)
    second.restore(state)
    assert not np.array_equal(
        second.run(samples[started + 1 :]), expected[started + 1 :]
    )  # it is the proposal that counts


def test_a_state_learned_without_fits_is_taken_and_the_other_way_round(samples):
    for theirs in (True, False):
        first = estimator_for(samples, rls__relinearise=theirs)
        first.run(samples[:3000])
        second = estimator_for(samples, rls__relinearise=not theirs)
        second.restore(first.state())
        np.testing.assert_array_equal(second.parameters.theta, first.parameters.theta)
        assert second._work.status[workspace.KEPT] == 0
        assert np.all(np.isfinite(second.run(samples[3000:6000])))


def test_a_state_with_an_impossible_place_is_refused(samples):
    estimator = estimator_for(samples)
    state = estimator.state()
    state["arrays"]["status"][workspace.SLOT] = 10**6
    with pytest.raises(ConfigError, match="impossible"):
        estimator.restore(state)


def test_without_a_thread_the_fit_runs_in_place(samples, monkeypatch):
    expected = estimator_for(samples).run(samples)

    def refuse(_self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(relinearisation.Fit, "start", refuse)
    estimator = estimator_for(samples)
    np.testing.assert_array_equal(estimator.run(samples), expected)
    assert estimator.state()["version"] == 2


def test_a_fit_that_fails_proposes_nothing(samples, monkeypatch):
    def fail(*_arguments):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(relinearisation, "propose", fail)
    expected = estimator_for(samples, rls__relinearise=False).run(samples)
    np.testing.assert_array_equal(estimator_for(samples).run(samples), expected)


def test_live_and_replay_agree_whatever_the_threads_of_the_machine():
    """Both programs set one thread themselves: a process without the test's own settings gives the same numbers."""
    code = (
        "from friction_estimator.threads import one_thread; one_thread()\n"
        "import hashlib, sys; sys.path.insert(0, sys.argv[1])\n"
        "from test_relinearisation import estimator_for, recorded\n"
        "samples = recorded('b', 4.0); estimator = estimator_for(samples); predicted = estimator.run(samples)\n"
        "print(estimator.health.adopted, hashlib.sha256(predicted.tobytes()).hexdigest())"
    )
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    bare = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", code, str(Path(__file__).parent)]
    answers = [
        subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
        for env in (bare, bare | dict.fromkeys(names, "1"))
    ]
    assert answers[0] == answers[1]
    assert answers[0].startswith("1 ")


def test_an_alarm_forgets_what_was_kept_and_drops_the_fit():
    samples = recorded("a", 20.0, rate_hz=500.0)
    changed = np.where(np.arange(len(samples)) < 6000, samples.friction_N, 3.0 * samples.friction_N)
    samples = replace(samples, friction_N=changed)
    estimator = estimator_for(samples)
    estimator.run(samples)
    assert estimator.health.alarmed == 1
    count = int(estimator._work.status[workspace.KEPT])
    assert len(samples) - 7000 < count <= len(samples) - 6000
    kept = Kept.of(estimator.model, estimator._work)
    assert kept.place.max() == count - 1
    unit = estimator.config.force_unit
    np.testing.assert_array_equal(kept.inputs.target[-1], samples.friction_N[-1] / unit)
    assert np.abs(kept.inputs.target).max() > np.abs(samples.friction_N[:6000]).max() / unit


def test_kept_samples_are_those_of_the_record(samples):
    estimator = estimator_for(samples)
    estimator.run(samples)
    unit = estimator.config.force_unit
    kept = Kept.of(estimator.model, estimator._work)
    place = kept.place.astype(int)
    assert place.size > 0.8 * workspace.KEPT_BLOCKS * workspace.KEPT_BLOCK
    assert np.unique(place).size == place.size
    np.testing.assert_array_equal(kept.inputs.target, samples.friction_N[place] / unit)
    index, value = estimator.model.basis.rows(samples.velocity_m_s[place])
    np.testing.assert_array_equal(kept.inputs.index, index)
    np.testing.assert_array_equal(kept.inputs.value, value)


def test_every_part_of_a_long_record_is_kept_alike():
    """Uniform over time, whatever the period of the drive: a chi-square test over tenths, pooled over lengths."""
    samples = recorded("b", 60.0)
    tenths = np.zeros(10)
    for length in range(20_000, 60_000, 4_001):
        estimator = estimator_for(samples)
        estimator.run(samples[:length])
        first = Kept.of(estimator.model, estimator._work).place[:: workspace.KEPT_BLOCK]
        tenths += np.histogram(first, 10, (0, length))[0]
    assert np.sum(np.square(tenths - tenths.mean()) / tenths.mean()) < 27.9  # 0.1 % of chi-square with 9 degrees


def test_a_restart_within_a_block_needs_no_filling_and_a_pause_does(samples):
    restart = samples.restart.copy()
    restart[[130, 131, 200]] = True
    cut = replace(samples, restart=restart)
    learn = np.ones(300, np.bool_)
    learn[220:225] = False
    estimator = estimator_for(samples)
    estimator.run(cut[:300], learn)
    kept = Kept.of(estimator.model, estimator._work)
    # Places count what was learned from: the pause takes five, so 220 and 221 are the first two after it.
    np.testing.assert_array_equal(kept.place[~kept.used], [128, 129, 220, 221, 256, 257])
    np.testing.assert_array_equal(kept.inputs.target[220], samples.friction_N[225] / estimator.config.force_unit)


def test_time_that_was_not_learned_from_is_not_kept(samples):
    learn = np.ones(len(samples), np.bool_)
    learn[3000:9000] = False
    estimator = estimator_for(samples)
    estimator.run(samples, learn)
    assert estimator._work.status[workspace.KEPT] == np.count_nonzero(learn)


def test_one_wild_velocity_does_not_hide_the_reversals(samples):
    velocity = samples.velocity_m_s.copy()
    velocity[500] = 5.0 * np.abs(velocity).max()
    config = estimator_for(samples).config
    estimator = Estimator(config)
    estimator.run(replace(samples, velocity_m_s=velocity))
    assert estimator.health.outside == 1
    assert estimator.health.adopted >= 1


def test_nothing_is_fitted_before_the_shaft_came_back():
    samples = recorded("a", 12.0)
    forward = replace(samples, velocity_m_s=np.abs(samples.velocity_m_s), friction_N=np.abs(samples.friction_N))
    estimator = estimator_for(forward)
    estimator.run(forward)
    assert estimator._work.status[workspace.PROPOSED] == 0
    assert not estimator._work.proposal.any()


def test_large_structures_and_other_laws_keep_nothing(samples):
    for settings in ({"fir.order": 40, "basis.finest_level": -2}, {"model.law": "nlms"}):
        config = with_recorded_units(Config.from_mapping(settings), samples.velocity_m_s, samples.friction_N)
        estimator = Estimator(config)
        estimator.run(samples[:200])
        assert estimator._work.kept.size == 0


def test_values_set_by_hand_are_not_overridden_by_an_older_fit(samples):
    started, adopted = first_adoption(samples)
    touched = estimator_for(samples)
    touched.run(samples[: started + 5])
    touched.parameters = touched.parameters  # the same values, but set: the fit under way is dropped
    touched.run(samples[started + 5 : adopted])
    untouched = estimator_for(samples)
    untouched.run(samples[:adopted])
    assert (touched.health.adopted, untouched.health.adopted) == (0, 1)
    assert not np.array_equal(touched.parameters.theta, untouched.parameters.theta)
