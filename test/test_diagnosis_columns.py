"""What an effect acts on: the whole force that is there at its stage, in the memories that the base has learned."""

import numpy as np
import pytest
from diagnosis_records import abba

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import build_record
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.rig.drive import segment
from friction_estimator.rig.simulate import Scenario, Simulation, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

BRISTLES = "presliding:length=64e-6,spread=1"
UNLIKE = "direction_asymmetry:shape=0"


def term(text: str) -> Term:
    """Return the regressor that `NAME:key=value,...` describes."""
    name, _, rest = text.partition(":")
    return Term(EFFECTS[name], {k: float(v) for k, v in (item.split("=") for item in rest.split(","))})


@pytest.mark.parametrize(
    ("plant", "hidden", "terms"),
    [
        # What bristles carry jumps and wears with the rest, and is unlike by direction.
        ("maxwell_slip", ["gain_step:step=0.05,at=20"], [BRISTLES, "gain_step:at=20"]),
        ("maxwell_slip", ["wear:size=0.04,length=1"], [BRISTLES, "wear:length=1"]),
        ("maxwell_slip", ["direction_asymmetry:asymmetry=0.06"], [BRISTLES, UNLIKE]),
        # They carry the level of a film that lags.
        ("maxwell_slip", ["frictional_lag:lag=0.005"], [BRISTLES, "frictional_lag:lag=0.005,rest=0"]),
        ("maxwell_slip", ["frictional_lag:lag=0.005,form=1"], [BRISTLES, "frictional_lag:lag=0.005,rest=0,delayed=1"]),
        # A filter of a part of a sample sees how they bend within one.
        (
            "maxwell_slip",
            ["sensor_lowpass:time_constant=3e-4"],
            [BRISTLES, "sensor_lowpass:time_constant=3e-4,poles=1"],
        ),
        # A rail and a gap see the force with what makes the directions unlike.
        (
            "clean",
            ["direction_asymmetry:asymmetry=0.3", "saturation:level=9,form=1"],
            [UNLIKE, "saturation:level=9,soft=1"],
        ),
        ("clean", ["direction_asymmetry:asymmetry=0.3", "backlash:gap=1e-5"], [UNLIKE, "backlash:gap=1e-5"]),
        # The rail bends the force behind two unlike memories.
        ("parallel_memory", ["saturation:level=9,form=1"], ["saturation:level=9,soft=1"]),
    ],
)
def test_an_effect_acts_on_all_that_is_there_at_its_stage(plant, hidden, terms) -> None:
    run = simulate(Scenario(abba(), plant, 200.0, 0.01, 3, tuple(parse_effect(e) for e in hidden)))
    data = build_record([run.samples], SEAL)
    fit = JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))
    left = fit([term(text) for text in terms], search=False).residual_N[data.used]
    assert np.sqrt(np.mean(np.square(left))) < (1.05 if terms[1:] == [UNLIKE] else 1.03) * run.noise_N.std()


def test_the_slope_of_a_lag_counts_what_follows_it() -> None:
    """Bristles carry the level of the film: without them in the slope the steps of the lag ended halfway."""
    hidden = (parse_effect("frictional_lag:lag=0.005,form=1"),)
    run = simulate(Scenario(abba(), "maxwell_slip", 200.0, 0.01, 3, hidden))
    data = build_record([run.samples], SEAL)
    fit = JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))
    found = fit([term(BRISTLES), term("frictional_lag:lag=0.0035,rest=0,delayed=1")], search=False)
    assert found.terms[1].params["lag"] == pytest.approx(0.005, rel=0.01)


def test_a_fixed_point_that_runs_away_ends_at_its_best_round() -> None:
    """What a hard rail cuts off, the data do not tell: the force beyond it drifts from round to round."""
    hidden = (parse_effect("saturation:size=0.04"),)
    run = simulate(Scenario(abba(), "maxwell_slip", 200.0, 0.01, 3, hidden))
    data = build_record([run.samples], SEAL)
    fit = JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))
    without = fit([term(BRISTLES)], search=False)
    rail = Term(EFFECTS["saturation"], {"level": run.effects[0].values["level"], "soft": 0.0})
    beside = fit([*without.terms, rail], without, search=False)
    assert beside.coefficients.cost < without.coefficients.cost


def test_a_gap_is_found_although_the_base_has_bent_towards_it() -> None:
    """Beside the plateau that the search finds the gap is one sample shorter: there the fit leaves the noise."""
    run, fit = fitted_to("backlash:gap=1e-5,form=1", "stribeck")
    found = fit([Term(EFFECTS["backlash"], {"gap": 1.2e-5, "soft": 1.0})], fit())
    assert found.terms[0].params["gap"] == pytest.approx(1e-5, rel=0.05)
    assert np.std(found.residual_N) < 1.05 * run.noise_N.std()


def test_what_lies_beyond_a_bracket_is_no_gain() -> None:
    """A gap wants the force ahead: a delay stands at the end of its bracket, and less than that it cannot be."""
    _, fit = fitted_to("backlash:gap=1e-5,form=1", "stribeck")
    alone = fit()
    late = fit([Term(EFFECTS["time_delay"], {"delay": 0.005})], alone)
    losses = [joint.held_out_loss(alone.base.problem.record, 0).sum() for joint in (alone, late)]
    assert losses[1] > 0.98 * losses[0]
    assert late.at_end.any()


def fitted_to(hidden: str, plant: str) -> tuple[Simulation, JointFit]:
    """Return a recording with an effect hidden, and what fits to it."""
    run = simulate(Scenario(abba(), plant, 200.0, 0.01, 3, (parse_effect(hidden),)))
    data = build_record([run.samples], SEAL)
    return run, JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))


def test_a_filter_of_two_poles_has_their_time() -> None:
    """One pole of the same delay is a worse fit, whose time is another one."""
    hidden = (parse_effect("sensor_lowpass:time_constant=0.012,form=1"),)
    run = simulate(Scenario(abba(), "stribeck", 200.0, 0.01, 3, hidden))
    data = build_record([run.samples], SEAL)
    fit = JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))
    (one,), (two,) = (fit([term(f"sensor_lowpass:time_constant=0.01,poles={n}")]).terms for n in (1, 2))
    assert two.params["time_constant"] == pytest.approx(0.012, rel=0.02)
    assert two.params["time_constant"] != pytest.approx(one.params["time_constant"], rel=0.02)


def test_a_filter_of_two_poles_is_the_same_in_pieces() -> None:
    run = simulate(Scenario(abba()[:1], "clean", 200.0, 0.01, 3))
    data = build_record([run.samples], SEAL)
    joint = JointFit(BaseProblem(data, SEAL), data.context(SEAL, float(np.abs(data.friction_N).max())))()
    params = {"time_constant": 0.012, "poles": 2.0}
    machine = EFFECTS["sensor_lowpass"].columns(params)
    pieces = [machine(joint.features[part], joint.reference) for part in (slice(0, 333), slice(333, None))]
    whole = EFFECTS["sensor_lowpass"].columns(params)(joint.features, joint.reference)
    assert np.array_equal(np.concatenate(pieces), whole)
    assert np.abs(whole).max() > 0.1


def test_bristles_are_found_where_the_base_has_bent_towards_them() -> None:
    """Sharp turns: the first sample after one is past the short bristles, one exponential fits the longest."""
    parts = ((1.3, 50.0, 6.5, "crank"), (4.0, 50.0, 12.0, "triangle"), (1.3, 200.0, 6.5, "crank"))
    drive = tuple(segment(*part) for part in (*parts, (4.0, 200.0, 12.0, "triangle")))
    run = simulate(Scenario(drive, "maxwell_slip", 200.0, 0.01, 3))
    data = build_record([run.samples], SEAL)
    context = data.context(SEAL, float(np.abs(data.friction_N).max()))
    fits = Candidates(BaseProblem(data, SEAL), context, EFFECTS, 0)
    base = fits.base()
    plain = fits(base, "presliding", {"length": 8e-4})
    assert plain is not None
    left = fits.shaped(base, plain).model.joint.residual_N[data.used]
    assert np.sqrt(np.mean(np.square(left))) < 1.1 * run.noise_N.std()
