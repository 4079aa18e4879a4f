"""The plants: what they differ in from the theory, and that the model structure can or cannot learn it."""

import numpy as np
import pytest

from friction_estimator.core.fit.batch import predict
from friction_estimator.core.fit.moments import gather
from friction_estimator.core.fit.variable_projection import refine
from friction_estimator.core.model.structure import Model
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.core.settings.units import chosen
from friction_estimator.effects import EFFECTS
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.law import Scaled, scaled_theory
from friction_estimator.rig.plant import CLEAN_TAPS, PLANTS, CleanPlant, RigPlant
from friction_estimator.rig.plants_other import SLIP_LENGTHS_M, SLIP_SHARES, MaxwellSlipPlant, TabulatedPlant
from friction_estimator.rig.plants_seal import MISMATCH_TAPS, FilmLagPlant, ParallelMemoryPlant
from friction_estimator.rig.profiles import Geometry
from friction_estimator.rig.simulate import Scenario, clean_trace, simulate

SEAL = SealConfig()

SEALS = [name for name, plant in PLANTS.items() if plant.motion == LINEAR]
"""The plants whose force is friction alone."""


def trace(plant, condition="b", seconds=4.0, rate=1000.0, law=None):
    scenario = Scenario((segment(*CONDITIONS[condition], seconds),), plant=plant, rate_hz=rate, noise=0.0)
    return clean_trace(scenario, law or PLANTS[plant](SEAL, rate))


def loop_width(t, speed):
    """Friction on the way up less that on the way down at one positive speed, in a late cycle of condition b, N."""
    late = (t.time_s > 1.0) & (t.time_s < 2.0) & (t.velocity_m_s > 0)
    rising, falling = late & (t.acceleration_m_s2 > 0), late & (t.acceleration_m_s2 < 0)
    up = np.interp(speed, t.velocity_m_s[rising], t.friction_N[rising])
    return up - np.interp(speed, t.velocity_m_s[falling][::-1], t.friction_N[falling][::-1])


def unexplained(plant, condition, noise=0.01, seconds=8.0):
    """Rms of what a least-squares fit of the parallel structure leaves beside the noise, over rms of friction."""
    run = simulate(Scenario((segment(*CONDITIONS[condition], seconds),), plant=plant, noise=noise))
    samples = run.paired()
    config = chosen(Config.from_mapping({"theory.kind": "seal"}), samples.velocity_m_s, samples.friction_N)
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


@pytest.mark.parametrize("plant", list(PLANTS))
def test_traits_are_ids_of_the_catalogue(plant):
    assert set(PLANTS[plant].traits) <= set(EFFECTS)


def test_there_are_plants_with_and_without_traits():
    without = [name for name in PLANTS if not PLANTS[name].traits]
    assert "clean" in without
    assert 2 <= len(without) <= len(PLANTS) - 4


@pytest.mark.parametrize("plant", list(PLANTS))
def test_directions_are_alike_where_no_trait_says_otherwise(plant):
    """By the half stroke of a sine, f(t + T/2) = -f(t)."""
    t = trace(plant, seconds=3.0)
    half = round(0.5 / t.step_s)
    late = t.friction_N[2 * half :]
    difference = np.max(np.abs(late[half:] + late[:-half])) / np.max(np.abs(late))
    if "direction_asymmetry" in PLANTS[plant].traits:
        assert difference > 0.02
    else:
        assert difference < 1e-6


@pytest.mark.parametrize("plant", SEALS)
def test_friction_opposes_the_motion(plant):
    t = trace(plant)
    moving = (np.abs(t.velocity_m_s) > 0.02) & (t.time_s > 0.5)
    assert np.all(t.friction_N[moving] * t.velocity_m_s[moving] > 0.0)


@pytest.mark.parametrize("plant", SEALS)
def test_a_machine_of_another_size_has_the_same_friction_in_its_own_units(plant):
    force, motion = 40.0, 0.05
    usual = trace(plant)
    theory = scaled_theory(SEAL, force, motion)
    geometry = Geometry(0.020 * motion, 0.100 * motion)
    scenario = Scenario((segment(*CONDITIONS["b"], 4.0),), plant=plant, noise=0.0, geometry=geometry, seal=theory)
    large = clean_trace(scenario, Scaled(PLANTS[plant](SEAL, 1000.0), force, motion))
    np.testing.assert_allclose(large.friction_N, force * usual.friction_N, rtol=1e-6, atol=1e-6 * force)
    mine = [SealCurve(s).evaluate(t.velocity_m_s, t.pressure_Pa, t.temperature_degC)
            for s, t in ((theory, large), (SEAL, usual))]  # fmt: skip
    np.testing.assert_allclose(mine[0], force * mine[1], rtol=1e-9, atol=1e-9 * force)


def test_the_lag_in_front_of_the_curve_vanishes_with_its_time_constant():
    t = trace("film_lag", law=FilmLagPlant(SEAL, 1000.0, film_lag_s=1e-9))
    theory = SealCurve(SEAL).evaluate(t.velocity_m_s, t.pressure_Pa, t.temperature_degC)
    np.testing.assert_allclose(t.friction_N, 1.15 * theory + FilmLagPlant.extra(t.velocity_m_s), rtol=1e-9, atol=1e-12)
    widths = [loop_width(trace("film_lag", law=FilmLagPlant(SEAL, 1000.0, lag)), 0.03) for lag in (1e-9, 3e-3, 6e-3)]
    assert abs(widths[0]) < 0.02
    assert widths[2] > 1.5 * widths[1] > 0.1


def test_the_parallel_plant_remembers_its_mismatch_and_not_the_theory():
    assert sum(MISMATCH_TAPS) == pytest.approx(1.0)
    t = trace("parallel_memory")
    theory = SealCurve(SEAL).evaluate(t.velocity_m_s, t.pressure_Pa, t.temperature_degC)
    every = round(1e-3 / t.step_s)
    mismatch = ParallelMemoryPlant.extra(t.velocity_m_s)
    wanted = sum(tap * np.roll(mismatch, i * every) for i, tap in enumerate(MISMATCH_TAPS))
    settled = len(MISMATCH_TAPS) * every
    np.testing.assert_allclose((t.friction_N - theory)[settled:], wanted[settled:], atol=1e-9)


def test_maxwell_slip_saturates_at_the_coulomb_level_and_builds_up_over_a_distance():
    assert sum(SLIP_SHARES) == pytest.approx(1.0)
    for condition in ("a", "b"):  # the same distance at both periods
        t = trace("maxwell_slip", condition, seconds=10.0)
        carried = MaxwellSlipPlant.elements(t)
        turns = np.flatnonzero((t.velocity_m_s[1:] > 0) & (t.velocity_m_s[:-1] <= 0))[1:]
        run = t.position_m - t.position_m[turns[0]]
        after = slice(turns[0], turns[0] + round(0.1 / t.step_s))
        assert np.all(carried[after][run[after] > 2.0 * max(SLIP_LENGTHS_M)] == pytest.approx(1.0))
        shortest = np.interp(2.0 * min(SLIP_LENGTHS_M), run[after], carried[after])
        assert shortest < -0.3
    plant = MaxwellSlipPlant(SEAL, 1000.0)
    slipping = np.isclose(carried, 1.0) & (t.velocity_m_s > 0.005)
    np.testing.assert_allclose(t.friction_N[slipping], plant.level(t)[slipping], rtol=1e-9)


def test_maxwell_slip_is_finite_at_rest():
    """A shaft that has not moved yet, and one that stands between strokes."""
    scenario = Scenario((segment(2.0, 50.0, 4.0, "dwell"),), plant="maxwell_slip", noise=0.0)
    assert np.all(np.isfinite(clean_trace(scenario, MaxwellSlipPlant(SEAL, 1000.0)).friction_N))


def test_the_table_is_met_at_its_rows_and_starts_at_zero():
    plant = TabulatedPlant(SEAL, 1000.0)
    speed = np.array([0.0, 0.010, 0.080, 0.150])
    np.testing.assert_allclose(plant.extra(speed), [0.0, 1.58, 1.18, 1.55])
    np.testing.assert_allclose(plant.extra(-speed), [0.0, -1.22, -1.07, -1.52])
    beyond = plant.extra(np.array([0.150, 0.200, 0.250]))
    assert np.diff(beyond)[0] == pytest.approx(np.diff(beyond)[1])


@pytest.mark.parametrize("plant", [name for name in PLANTS if name not in SEALS])
def test_the_effort_of_a_joint_is_friction_that_opposes_the_motion_and_its_load(plant):
    scenario = Scenario((segment(2.0, 0.0, 4.0),), plant=plant, noise=0.0, geometry=Geometry(1.0, 5.0))
    t = clean_trace(scenario, PLANTS[plant](SEAL, 1000.0))
    joint, q = PLANTS[plant](SEAL, 1000.0), t.position_m
    moving = np.abs(t.velocity_m_s) > 0.02
    assert np.all(joint.friction(t)[moving] * t.velocity_m_s[moving] > 0.0)
    columns = {"inertia": t.acceleration_m_s2, "gravity:sin": np.sin(q), "gravity:cos": np.cos(q)}
    load = sum(value * columns[name] for name, value in joint.loads.items())
    np.testing.assert_allclose(t.friction_N, joint.friction(t) + load, rtol=1e-12, atol=1e-12)
    assert np.std(load) > 0.5 * np.std(joint.friction(t))  # taken for friction, the load would be a large part of it
