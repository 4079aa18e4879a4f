"""The level of friction in steady sliding, behind one smooth sign or two."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from friction_estimator.effects import EFFECTS
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import THEORY, Reference, tabled
from friction_estimator.effects.shapes import KNOTS, SHAPES, TWICE, weights_at

NARROW, WIDE = 1e-3, 2e-3
SPEEDS = np.geomspace(1e-4, 0.02, 40)
PRESSURES = np.full(SPEEDS.size, 5e5)


def theory(v: np.ndarray, p: np.ndarray) -> np.ndarray:
    return (5.0 + 4e-6 * p - 60.0 * np.abs(v)) * np.tanh(v / WIDE)


def made(rest_N: float, theory_sign: float | None = WIDE) -> Reference:
    """Return the tables of a theory and of Coulomb friction of a narrower sign beside it."""
    axis = VelocityAxis(0.02)

    def force(v: np.ndarray, p: np.ndarray) -> np.ndarray:
        return theory(v, p) + rest_N * np.tanh(v / NARROW)

    pressures = np.array([3e5, 1e6])
    return Reference.of(
        tabled((force, None, None, theory), axis, pressures), axis, pressures, NARROW, None, theory_sign
    )


@pytest.mark.parametrize("rest_N", [0.5, -0.5])
def test_each_part_of_the_level_stands_behind_its_own_sign(rest_N: float) -> None:
    reference = made(rest_N)
    level = 5.0 + 4e-6 * PRESSURES - 60.0 * SPEEDS + rest_N
    np.testing.assert_allclose(reference.level(SPEEDS, PRESSURES), level, rtol=2e-3)
    np.testing.assert_allclose(reference.at_rest_N, 5.0 + 4e-6 * 6.5e5 + rest_N, rtol=3e-3)
    # Behind the narrow sign alone it falls towards rest.
    assert made(rest_N, None).level(SPEEDS[:1], PRESSURES[:1])[0] < 0.6 * level[0]


def test_the_share_of_the_level_that_the_curve_is_has_its_sign() -> None:
    reference = made(0.5)
    for way in (1.0, -1.0):
        share = reference.steady_sign(way * SPEEDS, PRESSURES)
        forces = reference.force(way * SPEEDS, PRESSURES)
        np.testing.assert_allclose(share * reference.level(SPEEDS, PRESSURES), forces, rtol=1e-9)
    assert np.array_equal(made(0.5, None).steady_sign(SPEEDS, PRESSURES), np.tanh(SPEEDS / NARROW))


def test_nothing_is_divided_by_parts_that_cancel() -> None:
    """At one speed the curve is zero, and its level is not."""
    reference = made(-5.0)
    crossing = np.diff(np.sign(reference.force(SPEEDS, PRESSURES))) != 0.0
    assert crossing.any()
    sign = reference.forward_sign(SPEEDS, PRESSURES)
    assert np.all(sign >= np.tanh(SPEEDS / WIDE))
    assert np.all(sign <= np.tanh(SPEEDS / NARROW))


def test_the_theory_is_what_its_parts_add_up_to() -> None:
    reference = made(0.5)
    total = sum(reference.part(part, SPEEDS, PRESSURES) for part in THEORY)
    np.testing.assert_allclose(total, theory(SPEEDS, PRESSURES), rtol=1e-3, atol=1e-3)


def test_what_stands_for_a_theorys_boundary_part_stands_behind_its_sign() -> None:
    """A lagging film takes it at another speed, over that sign: Coulomb friction is the same there."""
    dry = made(0.5).part(THEORY[0], SPEEDS, PRESSURES) / np.tanh(SPEEDS / WIDE)
    np.testing.assert_allclose(dry, dry[-1], rtol=3e-3)


@pytest.mark.parametrize("turned", [-1.0, 0.0, 2.0])
def test_directions_unlike_in_two_ways_are_told_as_the_share_of_the_friction_that_they_are(turned: float) -> None:
    """What changes with the pressure and what does not are badly told apart; their sum is not."""
    reference, asymmetry = made(0.5), EFFECTS["direction_asymmetry"]
    context = SimpleNamespace(pressure_mean_Pa=4e5)
    speed, pressure = np.array([reference.top_m_s / np.sqrt(2.0)]), np.array([4e5])
    level = float(reference.force(speed, pressure)[0])
    # The same even part of the force by either kind of column, or by much of one less much of the other.
    weights = np.zeros(2 * (SHAPES - 1))
    weights[SHAPES - 2 :: SHAPES - 1] = 0.3 - turned, turned * level / reference.top_N
    params = {"shape": TWICE}
    told = asymmetry.told(params, weights, context, reference)["asymmetry"][0]
    ways, nothing = np.array([1.0, -1.0]), Features(*(np.zeros(2) for _ in fields(Features)))
    features = replace(nothing, velocity_m_s=ways * speed, pressure_Pa=np.repeat(pressure, 2), force_N=ways * level)
    columns = asymmetry.columns(params)(features, reference)
    even_N = (columns @ weights).sum()
    assert told == pytest.approx(0.3, rel=1e-3)
    assert even_N / level == pytest.approx(told, rel=1e-3)


def test_splines_are_those_of_scipy_and_make_no_more_than_what_they_are_made_of() -> None:
    place = np.linspace(0.0, 1.0, 301)
    splines = weights_at(place)
    assert np.array_equal(splines, BSpline.design_matrix(place, KNOTS, 2).toarray())
    step = splines @ (np.arange(SHAPES) >= SHAPES // 2)
    assert np.all(np.diff(step) >= -1e-12)
    assert (step[0], step[-1]) == (0.0, 1.0)
    assert np.isnan(weights_at(np.array([np.nan]))).all()
    assert np.array_equal(weights_at(np.array([-0.1, 1.7])), weights_at(np.array([0.0, 1.0])))
