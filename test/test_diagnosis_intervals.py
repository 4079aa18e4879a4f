"""Intervals hold what chance, another form of the cause, and what no cause explains can make of a quantity."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import abba, chosen, record

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.candidate import Candidate, Model
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.causes import Cause
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.intervals import Curvature, Estimate, estimates
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.result import Found
from friction_estimator.diagnosis.search import Searcher
from friction_estimator.effects import EFFECTS
from friction_estimator.effects.features import Context
from friction_estimator.effects.shapes import FREE, SHAPES
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


def test_an_interval_reaches_to_what_a_refused_cause_would_make_of_the_quantity() -> None:
    """A force that is late beside a film that lags: without the film it is late by another time."""
    data = build_record([record(["time_delay:delay=0.006"], plant="film_lag")], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    search = Searcher(data, SEAL, context, EFFECTS, 0)
    fits = search.fits
    late = fits(fits.base(), "time_delay", {"delay": 0.006})
    both = fits(late.model, "frictional_lag", {"lag": 0.006, "rest": 0.0})
    times = [model.joint.terms[0].params["delay"] for model in (late.model, both.model)]
    (moved,) = fits.moved_by(late.model, both)
    assert moved == {"delay": pytest.approx(abs(times[1] - times[0]))}
    assert moved["delay"] > 1e-4
    for before in (1e-5, 1.0):
        (cause,) = search._beside_refused(
            late.model, [Cause("time_delay", None, 1.0, (), apart={"delay": before})], [both]
        )
        assert cause.apart == {"delay": max(before, moved["delay"])}


@pytest.mark.parametrize("apart", [1e-4, 1e-6, 1e-8, 3e-9, 1e-9, 1e-10])
def test_no_variance_is_below_nothing_however_alike_two_columns_are(apart: float) -> None:
    """Bristles that never slip are all the same spring: by rounding a variance was negative, an interval 1e149 N."""
    rng = np.random.default_rng(2)
    column, block = rng.standard_normal(4000), np.repeat(np.arange(40), 100)
    columns = np.column_stack([column, column + apart * rng.standard_normal(4000)])
    evidence = Evidence(columns, np.zeros(2), rng.standard_normal(4000), np.ones(4000, np.bool_), block, 0)
    hessian = evidence.zz.sum(0)
    known = Curvature(evidence, np.linalg.inv(hessian + np.diag(1e-10 * np.diag(hessian)))).covariance()
    assert np.all(np.diag(known) >= 0.0)
    assert np.all(np.diag(known) < 1e3 / apart**2)


def test_what_no_sample_tells_has_no_interval_and_spoils_no_other() -> None:
    """A column that is zero wherever samples are used: its variance was infinite, and times zero it was NaN in all."""
    terms = Term(EFFECTS["bias_step"], {"at": 40.0}), Term(EFFECTS["inertia"], {})
    joint, data, context = fitted(["inertia:mass=0.5"], *terms)
    before = replace(data, used=data.used & (data.features.time_s < 30.0))
    with np.errstate(all="raise"):
        step, mass = estimates(joint, before, context, 0, 1.0)
    assert np.isnan(step["step"].low)
    assert np.isnan(step["step"].high)
    assert holds(mass["mass"], 0.5)
    assert holds(estimates(joint, data, context, 0, 1.0)[0]["step"], 0.0)


def test_a_step_in_samples_that_are_set_aside_is_known_to_their_ends() -> None:
    """At 30 s the drive stands still between two periods: no sample that counts tells one moment from the next."""
    segments = tuple(segment(t, 29.0, s) for _ in range(4) for t, s in ((1.0, 5.0), (5.0, 10.0)))
    samples = record(["bias_step:step=0.4,at=30.0"], segments=segments, seed=925)
    some = chosen("bias_step", "pressure_dependence")
    (found,) = diagnose([samples], Config(), catalogue=some).effects
    at = found.parameters["at"]
    assert at.low < 30.0 < at.high
    assert at.high - at.low < 1.0


def test_what_no_cause_explains_widens_an_interval() -> None:
    """Bristles that nobody names bend the mass by seven times what chance does."""
    hidden = ["inertia:mass=0.5", "presliding:size=0.04,length=5e-5"]
    joint, data, context = fitted(hidden, Term(EFFECTS["inertia"], {}))
    left = float(np.sum(np.square(joint.residual_N[data.used]))) * 0.8
    chance, whole = (estimates(joint, data, context, 0, one)[0]["mass"] for one in (0.0, left))
    assert not holds(chance, 0.5)
    assert holds(whole, 0.5)


def of_a_slow_breakaway() -> tuple[Candidates, Model, Candidate]:
    """Return fits of a breakaway force on triangles, the base, and the force as it grows more slowly than it does."""
    data = build_record([record(["breakaway:size=0.04,length=5e-5,form=1"], segments=TRIANGLES)], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    fits = Candidates(BaseProblem(data, SEAL), context, EFFECTS, 0)
    base = fits.base()
    slow = fits(base, "breakaway", {"length": 5e-5, "exponent": 0.25, "rest_speed": context.sign_velocity_m_s})
    assert slow is not None
    return fits, base, slow


def test_the_growth_of_a_breakaway_force_with_the_dwell_is_compared() -> None:
    """On a triangle no dwell is near 0.1 s: the height there is told by how the force grows."""
    fits, base, slow = of_a_slow_breakaway()
    data, context = fits.problem.record, fits.context
    best = fits.shaped(base, slow)
    assert best.term.params["exponent"] == 0.5
    # What no cause explains says how much worse a form may be: its values are in the interval then.
    behind = best.gain - slow.gain
    assert not fits.apart(base, best.model, 0.5 * behind)
    apart = fits.apart(base, best.model, 1.5 * behind)
    assert apart["amplitude"] == pytest.approx(best.term.weights[0] - slow.term.weights[0])
    assert apart["amplitude"] > 0.3 * best.term.weights[0]
    known = estimates(best.model.joint, data, context, 0, 0.0)[0]["amplitude"]
    wider = estimates(best.model.joint, data, context, 0, 0.0, [apart])[0]["amplitude"]
    assert not holds(known, slow.term.weights[0])
    assert holds(wider, slow.term.weights[0])


def of_another_rest(rest_speed: float, profile: str) -> Found:
    """Return what is told of a breakaway force of 3 N and 0.1 mm beside a theory whose sign is 2 mm/s wide."""
    hidden = f"breakaway:amplitude=3,length=1e-4,rest_speed={rest_speed}"
    segments = tuple(segment(t, psi, 20.0, profile) for psi in (50.0, 200.0) for t in (1.5, 4.0))
    (found,) = diagnose(
        [record([hidden], segments=segments)], SEAL, catalogue=chosen("breakaway", "presliding")
    ).effects
    return found


@pytest.mark.parametrize("rest_speed", [5e-4, 2e-3, 8e-3])
def test_what_counts_as_rest_is_in_the_interval_of_a_breakaway_force(rest_speed: float) -> None:
    """At a steady acceleration the dwell is in proportion to the speed of rest: only the height after 0.1 s tells it.

    No other speed is chosen for the little that it explains more: as much is told as where the theory's is the one.
    """
    found = of_another_rest(rest_speed, "triangle")
    told = found.parameters
    assert found.experiment
    assert "let the shaft rest" in found.experiment
    assert told["amplitude"].value == pytest.approx(3.0 * np.sqrt(rest_speed / 2e-3), rel=0.1)
    assert 0.0 < told["amplitude"].low < 0.5 * told["amplitude"].value
    assert told["amplitude"].high > 2.0 * told["amplitude"].value
    assert holds(told["amplitude"], 3.0)
    assert holds(told["length"], 1e-4)


@pytest.mark.parametrize("rest_speed", [5e-4, 2e-3, 2e-2])
def test_where_the_drive_rests_the_height_of_a_breakaway_force_is_told(rest_speed: float) -> None:
    found = of_another_rest(rest_speed, "dwell")
    told = found.parameters
    assert found.experiment is None
    assert holds(told["amplitude"], 3.0)
    assert told["amplitude"].high - told["amplitude"].low < 0.8


def test_a_height_is_never_negative_and_a_bias_may_be() -> None:
    """The keys of an effect say what its quantities can be."""
    joint, data, context = fitted(
        ["breakaway:amplitude=0.5,length=5e-5"],
        Term(EFFECTS["breakaway"], {"length": 5e-5, "exponent": 0.5, "rest_speed": 2e-3}),
    )
    wide = [{"amplitude": 10.0}]
    height = estimates(joint, data, context, 0, 0.0, wide)[0]["amplitude"]
    assert height.low == 0.0 < height.value < 1.0
    assert height.high > 10.0
    joint, data, context = fitted(["sensor_bias:bias=0.5"], Term(EFFECTS["sensor_bias"], {}))
    bias = estimates(joint, data, context, 0, 0.0, [{"bias": 10.0}])[0]["bias"]
    assert bias.low < -9.0 < bias.value


def test_other_fits_of_a_cause_count_also_where_the_one_before_it_was_dropped() -> None:
    fits, base, slow = of_a_slow_breakaway()
    bias = fits(base, "sensor_bias", {})
    assert bias is not None
    after = fits(bias.model, "breakaway", slow.term.params | {"exponent": 0.5})
    assert after is not None
    alone = fits.without(after.model, 0)
    assert alone.joint.terms[0].params["exponent"] == 0.5
    # No fit of the search had this model.
    apart = fits.apart(base, alone, 1e3 * float(base.loss.sum()))
    assert apart["amplitude"] == pytest.approx(abs(alone.joint.terms[0].weights[0] - slow.term.weights[0]))


def test_what_the_friction_loses_is_not_what_the_viscosity_does() -> None:
    """In the free shape nothing says how much of the friction is viscous."""
    drift, weights = EFFECTS["viscosity_drift"], np.full(SHAPES, 0.1)
    context = None
    usual = drift.physical({"time_constant": 9.0}, weights[:1], context)
    free = drift.physical({"time_constant": 9.0, "shape": FREE}, weights, context)
    assert "drop" in usual
    assert "drop" not in free
    assert set(free) - {"time_constant"}


def test_a_form_of_which_nothing_can_be_told_gives_way_to_a_plainer_one() -> None:
    """One fast sine does not tell bristles of eight lengths apart: refused with them, they made room for others."""
    data = build_record([record(plant="maxwell_slip", noise=0.03, segments=(segment(1.0, 50.0, 40.0),))], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    fits = Candidates(BaseProblem(data, SEAL), context, EFFECTS, 0)
    base = fits.base()
    plain = fits(base, "presliding", {"length": 1.6e-3})
    assert plain is not None
    several = fits(base, "presliding", {**plain.term.params, "spread": 1.0})
    assert several is not None
    assert several.gain > plain.gain
    assert not fits.known_sign(several)
    assert fits.known_sign(plain)
    assert not fits.apart(base, plain.model, plain.gain)
    assert fits.known_sign(fits.shaped(base, plain))


def test_an_interval_holds_what_rounding_to_coarse_steps_makes_of_the_quantity() -> None:
    """Rounding repeats with the drive: blocks that all have the same error do not scatter about it."""
    inside = []
    for seed, size in ((1, 0.06), (2, -0.05), (3, 0.08)):
        sharp = record([f"gain_step:step={size},at=47.3"], plant="parallel_memory", segments=abba(), seed=seed)
        step = 0.15 * float(np.std(sharp.friction_N))
        coarse = replace(sharp, friction_N=step * np.round(sharp.friction_N / step))
        data = build_record([coarse], SEAL)
        context = data.context(SEAL, float(np.abs(data.friction_N).max()))
        joint = JointFit(BaseProblem(data, SEAL), context)([Term(EFFECTS["gain_step"], {"at": 47.3})], search=False)
        chance = estimates(joint, data, context, 0, 0.0)[0]["step"]
        whole = estimates(joint, data, context, 0, 0.0, lattice_N=step)[0]["step"]
        inside.append((holds(chance, size), holds(whole, size)))
        assert whole.high - whole.low < 0.1
    assert all(with_rounding for _, with_rounding in inside)
    assert not all(without for without, _ in inside)
