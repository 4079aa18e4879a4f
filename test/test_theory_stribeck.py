"""The Stribeck curve: its formula in each direction, what holds beyond it, and how it is found from few samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import noisy, sine

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.stribeck import REACH, found_stribeck
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.model.theory_stribeck import Stribeck, StribeckCurve
from friction_estimator.core.settings.config import Config

KNOWN = Stribeck(2.0, 3.0, 0.5, 1.5, 4.0, 6.0, 0.002, 0.02, 1.0, -1.0, 1.0)
UNITS = {"basis.velocity_range": [-0.1, 0.1], "force_unit": 3.0, "theory.kind": "stribeck"}


def formula(par: Stribeck, velocity: np.ndarray) -> np.ndarray:
    v = np.clip(velocity, par.low, par.high)
    side = v >= 0.0
    level = np.where(side, par.coulomb_pos, par.coulomb_neg)
    level = level + np.where(side, par.stribeck_pos, par.stribeck_neg) * np.exp(
        -((np.abs(v) / par.stribeck_velocity) ** par.exponent)
    )
    return np.tanh(v / par.sign_velocity) * level + np.where(side, par.viscous_pos, par.viscous_neg) * v


def test_the_curve_is_its_formula_in_both_directions_and_held_beyond():
    velocity = np.linspace(-3.0, 3.0, 1201)
    curve = StribeckCurve(KNOWN)
    np.testing.assert_allclose(curve.evaluate(velocity), formula(KNOWN, velocity), rtol=1e-13)
    assert curve.evaluate(np.array([1.0]))[0] == curve.evaluate(np.array([50.0]))[0]
    assert curve.held == np.count_nonzero(np.abs(velocity) > 1.0) + 1
    assert curve.evaluate(np.zeros(1))[0] == 0.0


def test_the_odd_curve_is_the_mean_of_the_directions():
    velocity = np.linspace(0.01, 0.9, 50)
    odd, both = StribeckCurve(KNOWN.odd), StribeckCurve(KNOWN)
    mean = 0.5 * (both.evaluate(velocity) - both.evaluate(-velocity))
    np.testing.assert_allclose(odd.evaluate(velocity), mean, rtol=1e-13)
    np.testing.assert_allclose(odd.evaluate(-velocity), -mean, rtol=1e-13)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"stribeck.viscous": [1.0]}, r"stribeck\.coulomb is empty"),
        ({"stribeck.coulomb": [1.0, 2.0, 3.0]}, r"stribeck\.coulomb: give one value"),
        ({"learned.stribeck": [1.0, 2.0]}, r"learned\.stribeck has 2 values"),
        ({"learned.stribeck": [0.0] * 11}, "sign_velocity is 0"),
        ({}, "no first contact"),
    ],
)
def test_what_makes_no_curve_is_refused_by_name(values, told):
    with pytest.raises(ConfigError, match=told):
        theory_from_config(Config.from_mapping(UNITS | values))


def test_a_curve_that_is_given_goes_on_straight():
    given_ = {"stribeck.coulomb": [2.0], "stribeck.viscous": [0.0, 10.0]}
    curve = theory_from_config(Config.from_mapping(UNITS | given_))
    np.testing.assert_allclose(curve.evaluate(np.array([-5.0, 5.0]), np.zeros(2), np.zeros(2)), [-2.0, 52.0])


# --- found from samples ------------------------------------------------------------------------------------------


def error(found: Stribeck, true: Stribeck, velocity: np.ndarray) -> float:
    """Return the rms error over the rms of the friction."""
    truth = formula(true, velocity)
    return float(np.sqrt(np.mean((formula(found, velocity) - truth) ** 2) / np.mean(truth**2)))


def test_two_strokes_with_noise_say_the_curve_and_its_asymmetry():
    velocity = sine(1.0)
    found = found_stribeck(velocity, noisy(formula(KNOWN, velocity), 0.02))
    assert error(found, KNOWN, velocity) < 0.01
    for side in (1.0, -1.0):
        assert error(found, KNOWN, side * np.abs(velocity)) < 0.015
    assert (found.low, found.high) == pytest.approx((-REACH * 0.025, REACH * 0.025), rel=0.02)


@given(speed=st.floats(1e-4, 1e3), force=st.floats(1e-3, 1e6))
@settings(max_examples=10, deadline=None)
def test_it_scales_with_the_units(speed, force):
    velocity = sine(1.0)
    friction = noisy(formula(KNOWN, velocity), 0.02)
    one = StribeckCurve(found_stribeck(velocity, friction)).evaluate(velocity)
    other = StribeckCurve(found_stribeck(speed * velocity, force * friction)).evaluate(speed * velocity)
    np.testing.assert_allclose(other, force * one, rtol=1e-5, atol=1e-5 * force)


def test_a_sensor_wired_the_other_way_gives_the_curve_negated():
    velocity = sine(1.0)
    friction = noisy(formula(KNOWN, velocity), 0.02)
    one, other = found_stribeck(velocity, friction), found_stribeck(velocity, -friction)
    np.testing.assert_allclose(formula(other, velocity), -formula(one, velocity))


def test_the_direction_that_was_not_seen_is_the_mirror_image():
    velocity = np.abs(sine(1.0))
    found = found_stribeck(velocity, noisy(formula(KNOWN, velocity), 0.02))
    np.testing.assert_allclose(formula(found, -velocity), -formula(found, velocity), rtol=0.01)
    assert error(found, KNOWN, velocity) < 0.02


@pytest.mark.parametrize("count", [1, 2, 10, 29, 30, 60])
@pytest.mark.parametrize("seed", range(3))
def test_few_samples_give_a_modest_curve(count, seed):
    rng = np.random.default_rng(seed)
    velocity = rng.uniform(-0.1, 0.1, count)
    friction = 3.0 * np.sign(velocity) + rng.standard_normal(count)
    found = found_stribeck(velocity, friction)
    everywhere = StribeckCurve(found).evaluate(np.linspace(-10.0, 10.0, 2001))
    assert np.abs(everywhere).max() <= 2.0 * np.abs(friction).max()


def test_one_speed_is_coulomb():
    velocity = 0.05 * np.sign(sine(1.0))
    friction = noisy(3.0 * np.sign(velocity), 0.05)
    values = StribeckCurve(found_stribeck(velocity, friction)).evaluate(np.array([-0.1, -0.05, 0.01, 0.05, 0.1]))
    np.testing.assert_allclose(np.abs(values), 3.0, rtol=0.05)


def test_a_falling_branch_ends_above_zero_where_nobody_has_been():
    true = Stribeck(1.0, 1.0, 5.0, 5.0, 0.0, 0.0, 0.001, 0.02, 1.0, -9.0, 9.0)
    velocity = sine(1.0)
    found = found_stribeck(velocity, noisy(formula(true, velocity), 0.02))
    beyond = np.linspace(0.025, 1.0, 100)
    assert (formula(found, beyond) > 0.0).all()
    assert error(found, true, beyond[beyond < 0.05]) < 0.25


@pytest.mark.parametrize("velocity", [np.zeros(100), np.zeros(0)])
def test_where_nothing_moves_nothing_is_found(velocity):
    assert found_stribeck(velocity, np.ones(velocity.size)) is None
