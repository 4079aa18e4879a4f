"""Static friction curves: known curves come back, units do not matter, and poor data give modest answers."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.baselines import BASELINES, LEAST_SAMPLES, StaticCurve, fit_baselines, scores
from friction_estimator.core.fit.stribeck import found_stribeck

SHAPE = {"width_m_s": 1e-3}
BOTH = {"coulomb_N": 20.0, "viscous_N_s_m": 160.0, "offset_N": -3.0}
EACH = {"coulomb_pos_N": 20.0, "coulomb_neg_N": 26.0, "viscous_pos_N_s_m": 160.0, "viscous_neg_N_s_m": 230.0}
STRIBECK = {"stribeck_m_s": 0.012}

KNOWN = {
    "coulomb_viscous": StaticCurve("coulomb_viscous", SHAPE | BOTH),
    "coulomb_viscous_asymmetric": StaticCurve("coulomb_viscous_asymmetric", SHAPE | EACH),
    "stribeck": StaticCurve("stribeck", SHAPE | BOTH | STRIBECK | {"stribeck_N": 9.0, "stribeck_exponent": 2.0}),
    "stribeck_asymmetric": StaticCurve(
        "stribeck_asymmetric",
        SHAPE | EACH | STRIBECK | {"stribeck_pos_N": 9.0, "stribeck_neg_N": 14.0, "stribeck_exponent": 1.0},
    ),
}


def drive(n, top=0.13):
    """Two sines whose speeds fill the range, slow ones as well."""
    t = np.arange(n) / n
    return top * np.sin(40 * np.pi * t) * np.sin(2.6 * np.pi * t + 0.3)


def measured(curve, velocity, noise=0.01, seed=0):
    friction = curve.evaluate(velocity)
    return friction + noise * np.std(friction) * np.random.default_rng(seed).standard_normal(velocity.size)


@pytest.mark.parametrize("name", BASELINES)
def test_a_known_curve_comes_back(name):
    velocity = drive(20_000)
    found = fit_baselines(velocity, measured(KNOWN[name], velocity))[name]
    assert set(found.parameters) == set(KNOWN[name].parameters)
    assert found.parameters == pytest.approx(KNOWN[name].parameters, rel=0.03)
    wide = np.linspace(-0.2, 0.2, 1001)  # half as fast again as the samples
    truth = KNOWN[name].evaluate(wide)
    assert np.abs(found.evaluate(wide) - truth).max() < 0.01 * np.abs(truth).max()


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_exponent_is_told(exponent):
    velocity = drive(20_000)
    curve = StaticCurve("stribeck", {**KNOWN["stribeck"].parameters, "stribeck_exponent": exponent})
    assert fit_baselines(velocity, measured(curve, velocity))["stribeck"].parameters["stribeck_exponent"] == exponent


def test_a_falling_viscous_branch_is_followed():
    velocity = drive(5000)
    curve = StaticCurve("coulomb_viscous", SHAPE | {"coulomb_N": 20.0, "viscous_N_s_m": -50.0, "offset_N": 0.0})
    found = fit_baselines(velocity, measured(curve, velocity))["coulomb_viscous"].parameters
    assert found["viscous_N_s_m"] == pytest.approx(-50.0, rel=0.03)


def test_a_richer_form_never_fits_worse():
    velocity = drive(20_000)
    for curve in KNOWN.values():
        friction = measured(curve, velocity, 0.05)
        nrmse = scores(fit_baselines(velocity, friction), velocity, friction)
        for poor, rich in [
            ("coulomb_viscous", "stribeck"),
            ("coulomb_viscous_asymmetric", "stribeck_asymmetric"),
        ]:
            assert nrmse[rich] < nrmse[poor] * 1.0001


def test_asymmetric_beats_symmetric_on_asymmetric_data_not_seen():
    velocity = drive(20_000)
    curves = fit_baselines(velocity, measured(KNOWN["stribeck_asymmetric"], velocity))
    other = drive(7000, 0.12)[::-1]
    nrmse = scores(curves, other, measured(KNOWN["stribeck_asymmetric"], other, seed=1))
    assert nrmse["stribeck_asymmetric"] < 0.012
    assert nrmse["stribeck_asymmetric"] < 0.4 * nrmse["stribeck"]
    assert nrmse["coulomb_viscous_asymmetric"] < 0.9 * nrmse["coulomb_viscous"]


@settings(max_examples=15, deadline=None)
@given(speed=st.floats(-5, 4), force=st.floats(-4, 5))
def test_units_do_not_matter(speed, force):
    per_speed, per_force = 10.0**speed, 10.0**force
    velocity = drive(600)
    friction = measured(KNOWN["stribeck_asymmetric"], velocity, 0.03)
    plain, scaled = fit_baselines(velocity, friction), fit_baselines(velocity * per_speed, friction * per_force)
    wide = np.linspace(-0.2, 0.2, 401)
    for name in BASELINES:
        expected = plain[name].evaluate(wide)
        found = scaled[name].evaluate(wide * per_speed) / per_force
        assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max(), name


@pytest.mark.parametrize("power", [-20, 10])
def test_powers_of_two_scale_to_the_last_bits(power):
    velocity = drive(600)
    friction = measured(KNOWN["stribeck"], velocity)
    plain, scaled = (fit_baselines(velocity * k, friction / k) for k in (1.0, 2.0**power))
    for name in BASELINES:
        np.testing.assert_allclose(
            scaled[name].evaluate(velocity * 2.0**power) * 2.0**power, plain[name].evaluate(velocity), rtol=1e-9
        )


def test_mirrored_data_give_the_mirrored_curve():
    velocity = drive(3000)
    friction = measured(KNOWN["stribeck_asymmetric"], velocity)
    there, back = fit_baselines(velocity, friction), fit_baselines(-velocity, -friction)
    grid = np.linspace(-0.2, 0.2, 401)
    for name in BASELINES:
        np.testing.assert_allclose(back[name].evaluate(-grid), -there[name].evaluate(grid), rtol=1e-5, atol=1e-4)


RNG = np.random.default_rng(3)
POOR = {
    "one direction": RNG.uniform(1e-4, 0.13, 3000),
    "one direction, fast": RNG.uniform(0.05, 0.13, 3000),
    "the other direction, fast": -RNG.uniform(0.05, 0.13, 3000),
    "one speed": np.full(3000, 0.1),
    "one speed with 1 % ripple": 0.1 + 0.001 * RNG.standard_normal(3000),
    "one speed with 0.01 % ripple": 0.1 + 0.00001 * RNG.standard_normal(3000),
    "one speed both ways": RNG.choice([-0.1, 0.1], 3000),
    "two speeds": RNG.choice([0.05, 0.1], 3000),
    "fast both ways": RNG.choice([-1.0, 1.0], 3000) * RNG.uniform(0.05, 0.13, 3000),
    "mostly standstill": np.where(RNG.random(3000) < 0.9, 0.0, RNG.uniform(-0.1, 0.1, 3000)),
    "few": RNG.uniform(-0.1, 0.1, LEAST_SAMPLES),
    "few of one direction": RNG.uniform(0.02, 0.1, LEAST_SAMPLES),
    "a wild velocity": np.append(RNG.uniform(-0.1, 0.1, 2999), 1.0),
}


@pytest.mark.parametrize("noise_N", [0.0, 0.2, 6.0])
@pytest.mark.parametrize("case", POOR)
def test_poor_data_give_modest_curves(case, noise_N):
    velocity = POOR[case]
    friction = KNOWN["stribeck"].evaluate(np.clip(velocity, -0.13, 0.13))
    friction = friction + noise_N * np.random.default_rng(4).standard_normal(velocity.size)
    wide = np.linspace(-0.2, 0.2, 4001)
    for name, curve in fit_baselines(velocity, friction).items():
        assert np.abs(curve.evaluate(wide)).max() < 2.5 * np.abs(friction).max(), name


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_unseen_direction_mirrors_the_other(sign):
    velocity = sign * np.abs(drive(3000))
    for curve in fit_baselines(velocity, measured(KNOWN["stribeck_asymmetric"], velocity, 0.1)).values():
        np.testing.assert_allclose(curve.evaluate(-velocity), -curve.evaluate(velocity), atol=1e-3)


def test_a_single_speed_is_coulombs():
    for curve in fit_baselines(np.full(100, 0.1), np.full(100, 7.0)).values():
        np.testing.assert_allclose(curve.evaluate(np.array([-0.15, 0.01, 0.1, 0.15])), [-7, 7, 7, 7], rtol=0.01)


def test_no_friction_is_no_friction():
    velocity = drive(100)
    for curve in fit_baselines(velocity, np.zeros(100)).values():
        assert not curve.evaluate(velocity).any()


def test_what_cannot_be_answered_is_said():
    with pytest.raises(UnanswerableError, match=str(LEAST_SAMPLES)):
        fit_baselines(drive(LEAST_SAMPLES - 1), np.ones(LEAST_SAMPLES - 1))
    with pytest.raises(UnanswerableError, match="nothing moves"):
        fit_baselines(np.zeros(100), np.ones(100))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", [0, 1])
def test_values_that_are_no_numbers_are_refused(bad, channel):
    samples = [drive(100), np.ones(100)]
    samples[channel][50] = bad
    with pytest.raises(ValueError, match="finite"):
        fit_baselines(*samples)


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match="shape"):
        fit_baselines(np.ones(100), np.ones(99))


def test_it_is_deterministic_and_touches_no_input():
    velocity = drive(1000)
    friction = measured(KNOWN["stribeck"], velocity)
    velocity.flags.writeable = friction.flags.writeable = False
    assert fit_baselines(velocity, friction) == fit_baselines(velocity, friction)


def test_a_million_samples_in_bounded_memory():
    velocity = drive(1_000_000)
    friction = measured(KNOWN["stribeck"], velocity)
    tracemalloc.start()
    try:
        curves = fit_baselines(velocity, friction)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 64e6  # four channels of 8 MB, a block and the bins
    assert curves["stribeck"].parameters == pytest.approx(KNOWN["stribeck"].parameters, rel=0.01)


def test_emps_gives_its_published_parameters(shared_data):
    table = np.genfromtxt(shared_data / "emps_nlgreyfast" / "data.csv", delimiter=",", names=True)
    curves = fit_baselines(table["v_m_s"], table["friction_N"])
    found = curves["coulomb_viscous"].parameters  # IDIM-LS, Janot et al. 2019: 20.39 N, 203.5 N s/m, -3.16 N
    assert found["coulomb_N"] == pytest.approx(20.4, abs=0.3)
    assert found["viscous_N_s_m"] == pytest.approx(203.5, abs=2.0)
    assert found["offset_N"] == pytest.approx(-3.17, abs=0.05)
    nrmse = scores(curves, table["v_m_s"], table["friction_N"])
    assert nrmse["coulomb_viscous_asymmetric"] < 0.85 * nrmse["coulomb_viscous"] < 0.06


def test_samples_that_are_not_used_change_nothing():
    velocity = drive(3000)
    friction = measured(KNOWN["stribeck"], velocity, 0.1)
    use = np.random.default_rng(3).random(velocity.size) < 0.6
    spoiled_v, spoiled_f = velocity.copy(), friction.copy()
    spoiled_v[~use], spoiled_f[~use] = 1e9, np.nan
    assert fit_baselines(spoiled_v, spoiled_f, use=use) == fit_baselines(velocity[use], friction[use])
    assert found_stribeck(spoiled_v, spoiled_f, use) == found_stribeck(velocity[use], friction[use])
    with pytest.raises(UnanswerableError, match="there are 29"):
        fit_baselines(velocity, friction, use=np.arange(velocity.size) < 29)
