"""A fit holds numbers; what it is on the record is made on demand, the same whenever that is."""

import gc
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis_records import abba

from friction_estimator.core import sums
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import joint_fit, own_columns, term_columns
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.evaluation import Evaluation
from friction_estimator.diagnosis.joint import Evaluated, Joint, Solution
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import OwnColumns, Term
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.effects.features import Context, Features
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

OTHERS: list[list[Term]] = [
    [],
    [Term(EFFECTS["inertia"], {})],
    [Term(EFFECTS["sensor_bias"], {})],
    [Term(EFFECTS["time_delay"], {"delay": 0.002})],
]

BRISTLES = Term(EFFECTS["presliding"], {"length": 64e-6, "spread": 1.0})
UNLIKE = Term(EFFECTS["direction_asymmetry"], {"shape": 2.0})
FILM = Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 1.0})

# What runs at a stage of its own, before a time of the whole force, on what bristles carry.
BEHIND_A_FILTER = [
    BRISTLES,
    UNLIKE,
    Term(EFFECTS["sensor_lowpass"], {"time_constant": 2e-3, "poles": 1.0}),
    Term(EFFECTS["saturation"], {"level": 9.0, "soft": 1.0}),
]
ON_A_FILM = [BRISTLES, UNLIKE, FILM]
LATE = [FILM, UNLIKE, Term(EFFECTS["time_delay"], {"delay": 0.002})]


@pytest.fixture(autouse=True)
def as_of_a_long_record(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_fit, "KEPT_BYTES", 0)


def problem_of(hidden: str, plant: str) -> tuple[BaseProblem, Context]:
    run = simulate(Scenario(abba(), plant, 200.0, 0.01, 3, (parse_effect(hidden),)))
    data = build_record([run.samples], SEAL)
    return BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max()))


def fit_of(hidden: str, plant: str = "clean") -> JointFit:
    return JointFit(*problem_of(hidden, plant))


def seen(joint: Joint) -> list[np.ndarray]:
    """Return all that a fit is on the record."""
    f, ref = joint.features, joint.reference
    made = [joint.base.fitted_N, ref.tables, f.force_N, joint.residual_N, *joint.parts_N, joint.tangent[:]]
    return [np.array(values) for values in (*made, joint.penalty, joint.scales, joint.at_end)]


@pytest.mark.parametrize(
    "terms",
    [
        [],
        [Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 0.0}), Term(EFFECTS["inertia"], {})],
        BEHIND_A_FILTER,
        [Term(EFFECTS["backlash"], {"gap": 1.2e-5, "soft": 1.0})],
    ],
    ids=["base", "film", "bristles behind a filter", "gap"],
)
def test_what_was_let_go_is_made_again_to_the_bit(terms) -> None:
    fit = fit_of("frictional_lag:lag=0.004", "maxwell_slip" if BRISTLES in terms else "clean")
    joint = fit(terms)
    first, held = seen(joint), joint.residual_N
    assert joint.residual_N is held
    for others in OTHERS[:2]:
        assert np.isfinite(fit(others).residual_N).all()
    again = joint.residual_N
    assert again is not held  # else this compares an array with itself
    for before, after in zip(first, seen(joint), strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize(
    ("beside", "share"),
    [([], 2e-3), (BEHIND_A_FILTER[2:3], 2e-3), ([FILM], 2e-3)],
    ids=["nothing", "filter", "film"],
)
def test_the_tangent_has_in_it_what_bristles_carry_of_the_curve(beside, share) -> None:
    """Without it curve and level, each fitted to the other, ran away (decision 0214)."""
    problem, context = problem_of("frictional_lag:lag=0.004", "maxwell_slip")
    evaluated = Evaluation(problem, context)
    joint = JointFit(problem, context)([BRISTLES, *beside])
    found, terms = joint.coefficients, joint.terms

    def at(weights: np.ndarray) -> tuple[Evaluated, float]:
        """Return the model with its tables made from itself, and the level at rest."""
        source = replace(found, weights=weights), terms
        made = evaluated(Solution(*source, source, tuple(dict.fromkeys(t.refined, (0.0, 1.0)) for t in terms)))
        return made, made.reference.at_rest_N

    here, level = at(found.weights)
    tangent = here.tangent[:] * np.pad(here.tangent.norm, (0, here.tangent.shape[1] - here.tangent.norm.size))
    for j, weight in enumerate(found.weights):
        step = 1e-3 * max(abs(weight), 0.1)
        there, moved = at(found.weights + step * (np.arange(found.weights.size) == j))
        # The bristles' coefficients are forces over the level at rest, which moves with the curve.
        carried = there.parts_N[0] * moved / level - here.parts_N[0]
        slope = (there.base.fitted_N - here.base.fitted_N + carried) / step
        np.testing.assert_allclose(tangent[:, j], slope, atol=share * np.abs(slope).max())


def test_of_many_fits_few_have_what_is_as_long_as_the_record() -> None:
    fit = fit_of("inertia:size=0.04")
    joints = [fit(terms) for terms in OTHERS]
    assert len({float(np.abs(joint.residual_N).sum()) for joint in joints}) == len(joints)
    gc.collect()
    assert sum(type(one) is Evaluated for one in gc.get_objects()) <= 1


def test_a_fit_that_is_done_leaves_nothing_to_a_search_for_garbage() -> None:
    """Those are seldom: with a cycle in it, what a fit had made of the record stayed for dozens of fits."""
    fit = fit_of("frictional_lag:lag=0.004")
    gc.collect()
    before = sum(type(one) is OwnColumns for one in gc.get_objects())
    gc.disable()
    try:
        joint = fit([Term(EFFECTS["frictional_lag"], {"lag": 0.004, "rest": 1.0}), Term(EFFECTS["inertia"], {})])
        assert np.isfinite(joint.residual_N).all()
        assert sum(type(one) is OwnColumns for one in gc.get_objects()) == before
    finally:
        gc.enable()


def test_what_was_made_at_a_time_goes_with_its_features(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search for a time tries some twenty: what was made at the last of them stayed, 0.4 GB of 400,000 samples."""
    fit = fit_of("time_delay:delay=0.003", "rig")
    tried: list[weakref.ref[Features]] = []
    alive = []
    features_at = Record.features_at

    def noted(record: Record, *given: Any) -> Features:
        alive.append(sum(one() is not None for one in tried))
        made = features_at(record, *given)
        tried.append(weakref.ref(made))
        return made

    monkeypatch.setattr(Record, "features_at", noted)
    gc.disable()
    try:
        joint = fit(LATE)
        assert np.isfinite(joint.residual_N).all()
    finally:
        gc.enable()
    assert len(tried) > 12
    assert max(alive) <= 1


@pytest.mark.parametrize("most", [0, 1 << 30], ids=["nothing kept", "all kept"])
@pytest.mark.parametrize("terms", [BEHIND_A_FILTER, ON_A_FILM, LATE], ids=["filter", "film", "delay"])
def test_a_record_in_pieces_gives_what_it_does_as_a_whole(terms, most, monkeypatch) -> None:
    fit = fit_of("frictional_lag:lag=0.004", "maxwell_slip")
    whole = seen(fit(terms, rounds=1))
    for module in (own_columns, term_columns):
        monkeypatch.setattr(module, "parts", lambda n: sums.parts(n, 777))
    monkeypatch.setattr(own_columns, "MOST_KEPT", most)
    for one, other in zip(whole, seen(fit(terms, rounds=1)), strict=True):
        # Columns lie in memory in another order, so products round otherwise, and a fit makes more of that.
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-8 * float(np.abs(one).max(initial=0.0)))


def test_without_its_only_term_a_fit_is_the_bases() -> None:
    """It was the base as it stood beside the term."""
    fit = fit_of("inertia:mass=0.3")
    one = fit([Term(EFFECTS["inertia"], {})])
    assert fit.without(one, 0).coefficients.cost == fit().coefficients.cost > one.coefficients.cost


def test_bristles_that_would_push_are_held_at_zero_where_the_fit_would_go_on_below() -> None:
    """The conditions of Karush, Kuhn and Tucker: what is held would only gain below zero, what is free nothing."""
    problem, context = problem_of("backlash:gap=5e-6", "maxwell_slip")
    fit = JointFit(problem, context)
    found = fit([BRISTLES], fit())
    bristles, used = found.terms[0], problem.record.used
    left = found.residual_N[used]
    held = bristles.held
    assert held.any()
    assert (bristles.weights[bristles.one_sided & ~held] > 0.0).any()
    assert not (bristles.weights[bristles.one_sided] < 0.0).any()
    columns = bristles.columns(found.features, found.reference)[used]
    pull = left @ columns / np.sqrt(np.square(columns).sum(0) * np.square(left).sum())
    assert (pull[held] < -1e-3).all()
    assert np.abs(pull[~held]).max() < 1e-3
    assert found.at_end.sum() == held.sum()
