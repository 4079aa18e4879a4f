"""Fits to the past from which rls goes on: what they gain, and that nothing else depends on them."""

import time

import numpy as np
import pytest

from friction_estimator.core import relinearisation, workspace
from friction_estimator.core.batch import fit_batch
from friction_estimator.core.config import Config
from friction_estimator.core.derive import with_recorded_units
from friction_estimator.core.estimator import Estimator
from friction_estimator.core.relinearisation import Kept
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
    count = 3000
    expected = whole.run(samples[:count])
    got = np.concatenate([parts.run(samples[k : min(k + part, count)]) for k in range(0, count, part)])
    np.testing.assert_array_equal(got, expected)
    assert whole._work.status[workspace.STARTED] > 0


def test_state_saved_while_a_fit_is_under_way_continues_bit_for_bit(samples):
    whole = estimator_for(samples)
    expected = whole.run(samples)
    first = estimator_for(samples)
    due = int(first._work.status[workspace.DUE])
    for cut in (due + 1, due + due // 8, 2 * due + 3):
        first = estimator_for(samples)
        first.run(samples[:cut])
        second = estimator_for(samples)
        second.restore(first.state())
        np.testing.assert_array_equal(second.run(samples[cut:]), expected[cut:])
        np.testing.assert_array_equal(first.run(samples[cut:]), expected[cut:])  # saving changes nothing


def test_an_alarm_forgets_what_was_kept_and_drops_the_fit():
    samples = recorded("a", 20.0, rate_hz=500.0)
    changed = np.where(np.arange(len(samples)) < 6000, samples.friction_N, 3.0 * samples.friction_N)
    samples = type(samples)(samples.stamp_ns, samples.velocity_m_s, changed, samples.restart)
    estimator = estimator_for(samples)
    estimator.run(samples)
    status = estimator._work.status
    assert estimator.health.alarmed == 1
    assert 6000 <= status[workspace.SINCE] < 7000
    kept = Kept.of(estimator.model, estimator._work)
    assert kept.place.max() <= len(samples) - status[workspace.SINCE] - 1
    assert kept.place.size <= len(samples) - status[workspace.SINCE]


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


def test_a_restart_within_a_block_needs_no_filling(samples):
    restart = samples.restart.copy()
    restart[[130, 131, 200]] = True
    cut = type(samples)(samples.stamp_ns, samples.velocity_m_s, samples.friction_N, restart)
    estimator = estimator_for(samples)
    estimator.run(cut[:300])
    kept = Kept.of(estimator.model, estimator._work)
    unused = kept.place[~kept.used & (kept.place >= 128)]
    np.testing.assert_array_equal(unused, [128, 129, 256, 257])


def test_large_structures_and_other_laws_keep_nothing(samples):
    for settings in ({"fir.order": 40, "basis.finest_level": -2}, {"model.law": "nlms"}):
        config = with_recorded_units(Config.from_mapping(settings), samples.velocity_m_s, samples.friction_N)
        estimator = Estimator(config)
        estimator.run(samples[:200])
        assert estimator._work.kept.size == 0


def test_values_set_by_hand_are_not_overridden_by_an_older_fit(samples):
    estimator = estimator_for(samples)
    due = int(estimator._work.status[workspace.DUE])
    estimator.run(samples[: due + 5])
    estimator.parameters = estimator.parameters
    status = estimator._work.status
    assert status[workspace.PROPOSED] == 0
    before = estimator.parameters.theta
    later = slice(due + 5, due + due // 4 + 10)
    estimator.run(samples[later], learn=False)
    np.testing.assert_array_equal(estimator.parameters.theta, before)
