"""The plants: what they differ in from the theory, and that the model structure can or cannot learn it."""

import numpy as np
import pytest

from friction_estimator.core.fit.batch import predict
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.fit.variable_projection import refine
from friction_estimator.core.model.structure import Model
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import SealConfig
from friction_estimator.core.settings.units import chosen
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.plant import CLEAN_TAPS, PLANTS, CleanPlant, RigPlant
from friction_estimator.rig.simulate import Scenario, clean_trace, simulate

SEAL = SealConfig()


def trace(plant, condition="b", seconds=4.0, rate=1000.0, law=None):
    scenario = Scenario((segment(*CONDITIONS[condition], seconds),), plant=plant, rate_hz=rate, noise=0.0)
    return clean_trace(scenario, law or PLANTS[plant](SEAL, rate))


def unexplained(plant, condition, noise=0.01, seconds=8.0):
    """Rms of what a least-squares fit of the parallel structure leaves beside the noise, over rms of friction."""
    run = simulate(Scenario((segment(*CONDITIONS[condition], seconds),), plant=plant, noise=noise))
    samples = run.paired()
    config = chosen(Config(), samples.velocity_m_s, samples.friction_N)
    model = Model(config)
    start = np.eye(config.fir.order + 1)[0]
    fit = model.split(refine(gather(model, samples), start))
    settled = slice(config.fir.order, None)  # before, the delay lines are filled as if the shaft had stood there
    error = (samples.friction_N - run.noise_N - predict(samples, config, fit))[settled]
    return np.sqrt(np.mean(np.square(error)) / np.mean(np.square(run.clean_N)))


def test_the_rig_leaves_about_two_percent_unexplained_at_condition_b():
    assert 0.015 < unexplained("rig", "b") < 0.03


@pytest.mark.parametrize("condition", ["a", "b"])
def test_the_model_learns_the_clean_plant_whole(condition):
    assert unexplained("clean", condition, noise=0.0) < 3e-4


@pytest.mark.parametrize("condition", ["a", "b", "c"])
@pytest.mark.parametrize("plant", list(PLANTS))
def test_no_plant_is_the_identifier_s_own_theory(plant, condition):
    run = simulate(Scenario((segment(*CONDITIONS[condition], 5.0),), plant=plant, noise=0.0))
    assert np.std(run.clean_N - run.theory_N) > 0.05 * np.std(run.clean_N)


def test_the_clean_plant_is_odd():
    """The even part of the static curve is a hypothesis of the diagnosis, so the plant must not have one."""
    v = np.linspace(-0.2, 0.2, 401)
    np.testing.assert_array_equal(CleanPlant.extra(v), -CleanPlant.extra(-v))
    half = trace("clean", seconds=2.0).friction_N[4:]  # by the half stroke of a sine: f(t + T/2) = -f(t)
    np.testing.assert_allclose(half[1000:2000], -half[:1000], atol=1e-6)


def test_the_clean_plant_has_a_short_memory_of_gain_one():
    assert sum(CLEAN_TAPS) == pytest.approx(1.0)
    for rate in (200.0, 1000.0, 5000.0):
        t = trace("clean", rate=rate)
        every = round(1.0 / rate / t.step_s)
        static = SealCurve(SEAL).evaluate(t.velocity_m_s, t.pressure_Pa, t.temperature_degC)
        static = static + CleanPlant.extra(t.velocity_m_s)
        padded = np.concatenate([np.full(2 * every, static[0]), static])
        wanted = sum(tap * padded[(2 - i) * every :][: static.size] for i, tap in enumerate(CLEAN_TAPS))
        np.testing.assert_allclose(t.friction_N, wanted, atol=1e-12)


def test_the_rig_s_film_lags():
    """Slower friction on the way up than on the way down: the film of a moment ago was thinner."""
    t = trace("rig", law=RigPlant(SEAL, 1000.0, film_lag_s=0.01))
    late = t.time_s > 1.0
    rising = late & (t.velocity_m_s > 0) & (t.acceleration_m_s2 > 0)
    falling = late & (t.velocity_m_s > 0) & (t.acceleration_m_s2 < 0)
    up = np.interp(0.05, t.velocity_m_s[rising][:400], t.friction_N[rising][:400])
    down = np.interp(0.05, t.velocity_m_s[falling][:400][::-1], t.friction_N[falling][:400][::-1])
    assert up > 1.1 * down


def test_without_lag_the_rig_is_a_static_curve():
    t = trace("rig", law=RigPlant(SEAL, 1000.0, film_lag_s=1e-9))
    plant = RigPlant(SEAL, 1000.0)
    static = plant.curve.evaluate(t.velocity_m_s, t.pressure_Pa, t.temperature_degC)
    np.testing.assert_allclose(t.friction_N, static, rtol=1e-9, atol=1e-12)


def test_the_rig_s_directions_differ():
    t = trace("rig", condition="b")
    assert np.abs(t.friction_N.max() + t.friction_N.min()) > 0.02 * t.friction_N.max()
