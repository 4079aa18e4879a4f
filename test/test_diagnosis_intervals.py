"""Intervals hold what chance, another form of the cause, and what no cause explains can make of a quantity."""

import numpy as np
import pytest
from diagnosis_records import abba, record

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.candidates import Candidates, Form
from friction_estimator.diagnosis.intervals import Estimate, estimates
from friction_estimator.diagnosis.joint import Joint, JointFit
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.search import Cause
from friction_estimator.effects import EFFECTS
from friction_estimator.effects.features import Context
from friction_estimator.effects.shapes import FREE, HATS
from friction_estimator.rig.drive import segment

SEAL = Config.from_mapping({"theory.kind": "seal"})
TRIANGLES = tuple(
    segment(t, psi, s, p) for psi in (50.0, 200.0) for t, s, p in ((1.3, 13.0, "crank"), (4.0, 20.0, "triangle"))
)


def fitted(hidden: list[str], *terms: Term, plant: str = "clean") -> tuple[Joint, Record, Context]:
    """Return the fit of some terms to a recording, with the record and the facts about it."""
    data = build_record([record(hidden, plant=plant, segments=abba())], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    return JointFit(BaseProblem(data, SEAL), context)(terms, search=False), data, context


def holds(interval: Estimate, value: float) -> bool:
    """Return whether a value lies in an interval."""
    return interval.low <= value <= interval.high


def test_a_gap_is_known_to_a_sample_at_the_best() -> None:
    """Its columns jump: a small step moves no sample, and a slope of nothing once made an interval of no width."""
    found = fitted(["backlash:gap=1e-5"], Term(EFFECTS["backlash"], {"gap": 1.04e-5}), plant="stribeck")
    (alone,), (beside,) = (estimates(*found, 0, left_N2=left) for left in (0.0, 100.0))
    assert holds(alone["gap"], 1e-5)
    assert alone["gap"].high - alone["gap"].low > 1e-7
    assert beside["gap"].high > alone["gap"].high


def test_what_no_cause_explains_widens_an_interval() -> None:
    """Bristles that nobody names bend the mass by seven times what chance does."""
    hidden = ["inertia:mass=0.5", "presliding:size=0.04,length=5e-5"]
    joint, data, context = fitted(hidden, Term(EFFECTS["inertia"], {}))
    left = float(np.sum(np.square(joint.residual_N[data.used]))) * 0.8
    chance, whole = (estimates(joint, data, context, 0, one)[0]["mass"] for one in (0.0, left))
    assert not holds(chance, 0.5)
    assert holds(whole, 0.5)


def test_the_growth_of_a_breakaway_force_with_the_dwell_is_compared() -> None:
    """On a triangle no dwell is near 0.1 s: the height there is told by how the force grows."""
    data = build_record([record(["breakaway:size=0.04,length=5e-5,form=1"], segments=TRIANGLES)], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    fits = Candidates(BaseProblem(data, SEAL), context, EFFECTS, 0)
    base = fits.base()
    slow = fits(base, "breakaway", {"length": 5e-5, "exponent": 0.25, "rest_speed": context.sign_velocity_m_s})
    assert slow is not None
    best = fits.shaped(base, slow)
    assert best.term.params["exponent"] == 0.5
    (other,) = fits.forms(base, best.model)
    assert other.apart["amplitude"] == pytest.approx(best.term.weights[0] - slow.term.weights[0])
    assert other.apart["amplitude"] > 0.3 * best.term.weights[0]


def test_forms_that_fit_as_well_are_what_an_interval_holds() -> None:
    forms = (Form(0.3, {"amplitude": 2.0}), Form(-0.1, {"amplitude": 0.5, "length": 1e-5}), Form(5.0, {"length": 1.0}))
    cause = Cause("breakaway", None, 10.0, (), {}, forms)
    assert cause.apart(0.0) == {"amplitude": 0.5, "length": 1e-5}
    assert cause.apart(0.4) == {"amplitude": 2.0, "length": 1e-5}


def test_what_the_friction_loses_is_not_what_the_viscosity_does() -> None:
    """In the free shape nothing says how much of the friction is viscous."""
    drift, weights = EFFECTS["viscosity_drift"], np.full(HATS, 0.1)
    context = None
    usual = drift.physical({"time_constant": 9.0}, weights[:1], context)
    free = drift.physical({"time_constant": 9.0, "shape": FREE}, weights, context)
    assert "drop" in usual
    assert "drop" not in free
    assert set(free) - {"time_constant"}
