"""Rivals: angles between effects on a record, and the drive that would tell them apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_records import chosen

from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.library import build_library, columns_of
from friction_estimator.diagnosis.odd_curve import SPLINES
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.rivals import Alike, alike, closest
from friction_estimator.diagnosis.trials import SEPARATES, Drive, Outcome, Trials
from friction_estimator.diagnosis.words import next_experiment
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.effects.features import Context
from friction_estimator.rig.drive import Segment, segment
from friction_estimator.rig.simulate import Scenario, simulate

SEAL = Config.from_mapping({"theory.kind": "seal"})

ONE_SINE = (segment(1.0, 50.0, 24.0),)
TWO_PERIODS = (segment(1.0, 50.0, 12.0), segment(3.0, 50.0, 12.0))


def made(segments: tuple[Segment, ...], hidden: str, seed: int = 2) -> Samples:
    scenario = Scenario(segments, plant="clean", rate_hz=100.0, seed=seed, effects=(parse_effect(hidden),))
    return simulate(scenario).samples


def fitted(samples: Sequence[Samples]) -> tuple[Record, Context, Joint]:
    record = build_record(samples, Config())
    context = record.context(Config(), float(np.abs(record.friction_N).max()))
    return record, context, JointFit(BaseProblem(record, SEAL, Capacity(SPLINES, Config().fir.order)), context)()


def column(name: str, model: Joint, context: Context) -> np.ndarray:
    effect = EFFECTS[name]
    return columns_of(effect, effect.grid(context)[0], model.features, model.reference)[:, 0]


def against(
    samples: Sequence[Samples], name: str, others: Sequence[str], scale: float = 1.0, weight: float = 1.0
) -> dict[str, Alike]:
    record, context, model = fitted(samples)
    evidence = model.evidence(record, 0)
    catalogue = chosen(*others)
    library = build_library(catalogue, model.features, model.reference, context, evidence)
    return alike(evidence, library, scale * weight * column(name, model, context))


def test_inertia_and_a_spring_are_one_under_one_sine_and_two_under_two_periods() -> None:
    one = against([made(ONE_SINE, "inertia:size=0.04")], "inertia", ["side_spring", "sensor_bias"])
    assert one["side_spring"].share == pytest.approx(1.0, abs=1e-3)
    assert one["sensor_bias"].share < 0.1
    two = against([made(TWO_PERIODS, "inertia:size=0.04")], "inertia", ["side_spring"])
    assert two["side_spring"].share < 0.8
    assert closest(one, 2.0, 0.03) == ["side_spring"]
    assert not closest(two, 2.0, 0.03)


def test_two_recordings_are_stacked_in_any_order() -> None:
    slow, fast = made((segment(3.0, 50.0, 18.0),), "inertia:size=0.04"), made(ONE_SINE, "inertia:size=0.04", 5)
    there = against([slow, fast], "inertia", ["side_spring", "squeeze_film"])
    back = against([fast, slow], "inertia", ["side_spring", "squeeze_film"])
    assert there["side_spring"].share < 0.8
    for name, one in there.items():
        assert back[name].share == pytest.approx(one.share, abs=0.02)


@pytest.mark.parametrize("scale", [1e-3, 7.0])
def test_the_share_does_not_depend_on_the_size(scale: float) -> None:
    samples, others = [made(TWO_PERIODS, "inertia:size=0.04")], ["side_spring", "squeeze_film", "presliding"]
    usual, scaled = against(samples, "inertia", others), against(samples, "inertia", others, scale)
    for name, one in usual.items():
        assert scaled[name].share == pytest.approx(one.share, rel=1e-9, abs=1e-12)
        assert scaled[name].lost_N2 == pytest.approx(scale**2 * one.lost_N2, rel=1e-6)


def test_signs_that_physics_gives_are_kept() -> None:
    """A spring of either sign can do what inertia does; a negative mass cannot do what a spring does."""
    samples = [made(ONE_SINE, "inertia:size=0.04")]
    stiff = against(samples, "side_spring", ["inertia"])["inertia"].share
    soft = against(samples, "side_spring", ["inertia"], weight=-1.0)["inertia"].share
    assert stiff == pytest.approx(0.0, abs=1e-6)
    assert soft == pytest.approx(1.0, abs=1e-3)


def test_what_the_base_does_itself_has_no_rivals() -> None:
    record, context, model = fitted([made(ONE_SINE, "inertia:size=0.04")])
    evidence = model.evidence(record, 0)
    library = build_library({"inertia": EFFECTS["inertia"]}, model.features, model.reference, context, evidence)
    assert alike(evidence, library, np.zeros(record.used.size)) == {}


def test_the_loss_of_a_wrong_name_is_what_a_refit_finds() -> None:
    record, context, model = fitted([made(TWO_PERIODS, "inertia:size=0.04")])
    fit = JointFit(model.base.problem, context)
    right = fit([Term(EFFECTS["inertia"], {})])
    wrong = fit([Term(EFFECTS["side_spring"], {"centre": context.centre_m})])
    evidence = model.evidence(record, 0)
    library = build_library({"side_spring": EFFECTS["side_spring"]}, model.features, model.reference, context, evidence)
    one = alike(evidence, library, right.parts_N[0])["side_spring"]
    lost = float(np.square(wrong.residual_N).sum() - np.square(right.residual_N).sum())
    assert one.lost_N2 == pytest.approx(lost, rel=0.2)
    assert one.lost_N2 > 5.0 * one.error_N2


def test_a_second_period_is_simulated_to_separate_inertia_and_spring() -> None:
    record, context, model = fitted([made(ONE_SINE, "inertia:size=0.04")])
    joint = JointFit(model.base.problem, context)([Term(EFFECTS["inertia"], {})])
    trials = Trials(joint, record, SEAL, context, 0)
    found = trials.separation(joint.terms[0], EFFECTS["side_spring"])
    shares = {outcome.drive.words.split(",")[0]: outcome.share for outcome in found}
    assert shares["a second period"] < SEPARATES
    assert found == trials.separation(joint.terms[0], EFFECTS["side_spring"])
    assert [o.lost_N2 for o in found] == sorted((o.lost_N2 for o in found), reverse=True)
    assert trials.separation(joint.terms[0], EFFECTS["wear"]) == []  # once in a machine's life: no drive repeats it


def test_a_drive_that_cannot_be_simulated_says_nothing() -> None:
    record, context, model = fitted([made(ONE_SINE, "inertia:size=0.04")])
    joint = JointFit(model.base.problem, context)([Term(EFFECTS["inertia"], {})])
    none: list[Outcome] = Trials(joint, record, SEAL, replace(context, stroke_m=0.0), 0).separation(
        joint.terms[0], EFFECTS["side_spring"]
    )
    assert none == []


def test_a_sentence_is_offered_unless_its_drives_do_not_separate() -> None:
    drive = Drive("a second period, 3 times as long", ("period",), ())
    other = Drive("speed steps without reversal", ("speed steps",), ())
    name, rival = "inertia", "side_spring"
    said = f"{name} or {rival}: {EFFECTS[name].words.confused_with[rival]}"
    assert "period" in said
    assert next_experiment(name, (rival,)) == said
    assert next_experiment(name, (rival,), lambda _: [Outcome(drive, 0.4, 1.0)]) == said
    apart = [Outcome(other, 0.1, 2.0), Outcome(drive, 0.95, 1.0)]
    assert next_experiment(name, (rival,), lambda _: apart) == f"{name} or {rival}: speed steps without reversal"
    assert next_experiment(name, (rival,), lambda _: [Outcome(drive, 0.95, 1.0)]) is None
    assert next_experiment(name, ()) is None


def test_a_rival_that_was_no_candidate_is_found_by_its_angle() -> None:
    result = diagnose([made(ONE_SINE, "inertia:size=0.04")], Config())
    assert {"inertia", "side_spring"} <= {result.effects[0].name, *result.effects[0].rivals}
    assert "a second period" in (result.effects[0].experiment or "")


@pytest.mark.parametrize(
    ("hidden", "other", "plant", "segments"),
    [
        # A delay and a filter of 0.4 samples differ by what lies between samples.
        (
            "time_delay:delay=0.002",
            "sensor_lowpass",
            "parallel_memory",
            (segment(8.0, 50.0, 64.0, "speed_steps"), segment(4.0, 200.0, 60.0, "dwell")),
        ),
        # Under one period it is a spring and a bit of the base's curve, but for the transient of the first block.
        (
            "viscoelastic_relaxation:size=0.04,time_constant=0.16,form=1",
            "side_spring",
            "clean",
            (segment(2.0, 100.0, 40.0),),
        ),
    ],
)
def test_what_the_record_does_not_tell_apart_is_in_the_set(hidden, other, plant, segments) -> None:
    effect = parse_effect(hidden)
    samples = simulate(Scenario(segments, plant, 200.0, 0.01, 3, (effect,))).samples
    (found,) = diagnose([samples], Config()).effects
    assert {effect.name, other} <= {found.name, *found.rivals}
