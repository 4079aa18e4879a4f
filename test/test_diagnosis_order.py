"""What was named first stands beside what was named after it (decision 0244)."""

import pytest
from diagnosis_records import chosen, names, record, set_of
from test_diagnosis_search import ONE_SINE, searcher_on

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.causes import Cause
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.search import _Found
from friction_estimator.effects import parse_effect
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, simulate


@pytest.mark.parametrize(("more", "left"), [([], False), (["side_spring:stiffness=3"], True)])
def test_a_cause_that_brings_nothing_beside_those_after_it_is_taken_away(more, left) -> None:
    """Under sines a spring is a mass, but for the ratio of the periods."""
    hidden = ["direction_asymmetry:size=0.3", "inertia:mass=0.3", *more]
    searcher = searcher_on(record(hidden), "direction_asymmetry", "side_spring", "inertia")
    models, causes = [searcher.fits.base()], []
    for name, params in (("direction_asymmetry", {"shape": 1.0}), ("side_spring", {"centre": 0.0}), ("inertia", {})):
        one = searcher.fits(models[-1], name, params)
        models.append(one.model)
        causes.append(Cause(name, 0.01, one.gain, ()))
    found = _Found(models, causes)
    assert searcher._drop_small(found) is not left
    assert [c.name for c in found.causes] == [c.name for c in causes if left or c.name != "side_spring"]
    assert [t.name for t in found.models[-1].joint.terms] == [c.name for c in found.causes]
    assert ("side_spring" in found.dropped) is not left


def test_what_explains_more_beside_a_later_cause_takes_the_place_of_another_of_its_kind() -> None:
    """Wear was named first, then the step; beside both, warming was another form of the wear."""
    hidden = "viscosity_drift:drop=0.136,time_constant=4.69,form=1", "gain_step:step=0.0432,at=1.6186"
    drive = tuple(segment(t, psi, 1.0) for psi in (50.0, 200.0, 200.0, 50.0) for t in (0.25, 0.5))
    scenario = Scenario(drive, "film_lag", 1000.0, 0.01, 2, tuple(parse_effect(e) for e in hidden))
    some = chosen("frictional_lag", "wear", "viscosity_drift", "gain_step")
    result = diagnose([simulate(scenario).samples], Config(), catalogue=some)
    assert set(names(result)) == {"frictional_lag", "viscosity_drift", "gain_step"}
    (step,) = (e.parameters["step"] for e in result.effects if e.name == "gain_step")
    assert step.value == pytest.approx(0.0432, abs=0.004)


@pytest.mark.parametrize(("seed", "enough"), [(1, True), (3, False)])
def test_a_first_cause_brings_its_share_with_what_the_memory_loses_by_it(seed, enough) -> None:
    """By held-out data alone both masses bring more than a trace; neither is there."""
    data = record(plant="parallel_memory", segments=ONE_SINE, seed=seed)
    searcher = searcher_on(data, "inertia", boundary_friction=1.4)
    base = searcher.fits.base()
    mass = searcher.fits(base, "inertia", {})
    assert mass.held_N2 > 0.002 * base.loss.sum()
    assert searcher.guards.brings_share(base, mass, []) is enough


def test_what_is_taken_away_is_in_the_set_of_what_it_cannot_be_told_from() -> None:
    """Bristles were named first; alone a film's lag explains as much, and beside it they bring next to nothing."""
    sine = (segment(2.0, 50.0, 60.0),)
    data = record(["side_spring:size=0.05"], plant="maxwell_slip", noise=0.03, seed=105, segments=sine)
    some = chosen("side_spring", "presliding", "inertia", "direction_asymmetry", "frictional_lag", "time_delay")
    (found,) = diagnose([data], Config(), catalogue=some).effects
    assert {"presliding", "frictional_lag"} <= set_of(found)
