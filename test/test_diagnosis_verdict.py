"""The verdict: which of four, in which order, and that every number in it was computed."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_records import chosen, names, record

from friction_estimator.core.quantities import Quantities
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import Diagnosis, diagnose
from friction_estimator.diagnosis.extend import is_offered
from friction_estimator.diagnosis.intervals import Estimate
from friction_estimator.diagnosis.result import Found
from friction_estimator.diagnosis.summary import UNSIZED, as_json, sentence, sentences
from friction_estimator.effects import EFFECTS
from friction_estimator.rig.drive import segment

PACKAGE = Path(__file__).parents[1] / "friction_estimator"
NEAR_REVERSALS = ("presliding", "stick_slip", "breakaway", "inertia", "viscoelastic_relaxation", "position_dependence")
LIKE_A_FILM = chosen(*NEAR_REVERSALS)
ONLY_MASS = {"inertia": EFFECTS["inertia"]}
FILM = "squeeze_film:size=0.04,speed=0.01"


@pytest.fixture(scope="module")
def unexplained() -> Diagnosis:
    """Nothing but a mass is known, and a squeeze film is there."""
    return diagnose([record([FILM])], Config(), catalogue=ONLY_MASS)


def test_a_cause_outside_the_catalogue_is_unexplained(unexplained: Diagnosis) -> None:
    assert unexplained.verdict == "unexplained"
    assert names(unexplained) == []
    assert unexplained.remainder is not None
    assert unexplained.unexplained_percent > 10.0
    assert unexplained.total_gain is None
    assert unexplained.detection_limit_N == {}  # no promise of what would have been seen beside it
    assert any("no named cause explains" in text for text in unexplained.excitation.warnings)
    assert "no name holds" in sentences(unexplained, Quantities())[0]


def test_what_is_left_is_measured_in_one_way(unexplained: Diagnosis) -> None:
    """Of the held-out error what is above the noise floor, in the summary as in the words."""
    over = unexplained.nrmse_holdout - unexplained.noise_floor
    assert unexplained.unexplained_percent == pytest.approx(100.0 * over / unexplained.nrmse_holdout, rel=1e-6)
    summary = as_json(unexplained, ["a"], {}, None, Quantities())
    assert summary["unexplained_percent"] == unexplained.unexplained_percent


def test_unexplained_offers_no_model(unexplained: Diagnosis) -> None:
    assert not is_offered(unexplained)


def test_a_cause_whose_size_the_record_does_not_tell_is_told_so() -> None:
    """A robot that runs at two speeds: presliding of -0.57 N (-10.8 to 9.6) whose gain was beyond doubt."""
    length = Estimate(3e-5, "m", 1e-5, 5e-5)
    found = Found(
        "presliding", 0.005, {"amplitude": Estimate(-0.57, "N", -10.8, 9.6), "length": length}, None, (), None, "it", 0
    )
    assert UNSIZED in sentence(found, Quantities())
    sized = replace(found, parameters={"amplitude": Estimate(-0.57, "N", -0.9, -0.2), "length": length})
    assert UNSIZED not in sentence(sized, Quantities())
    late = replace(found, name="time_delay", parameters={"delay": Estimate(1e-3, "s", 0.0, 2e-3)})  # it has no other
    assert UNSIZED in sentence(late, Quantities())
    assert UNSIZED not in sentence(replace(late, parameters={"delay": length}), Quantities())


def test_another_cause_beside_what_is_unexplained_is_named_first() -> None:
    result = diagnose([record([FILM, "inertia:size=0.04"])], Config(), catalogue=ONLY_MASS)
    assert result.verdict == "effects_found"
    assert names(result) == ["inertia"]
    assert result.remainder is not None
    assert result.unexplained_percent > 10.0


def test_a_likeness_of_a_cause_outside_the_catalogue_does_not_explain_it() -> None:
    result = diagnose([record([FILM])], Config(), catalogue=LIKE_A_FILM)
    assert result.verdict in ("unexplained", "effects_found")
    assert result.unexplained_percent > 25.0
    assert result.remainder is not None
    assert result.remainder.variable == "acceleration_m_s2"


def test_a_likeness_is_told_from_the_cause_by_what_it_leaves() -> None:
    """Free shapes of the pressure follow a soft rail nearly: what is left goes with the force."""
    without_rail = {name: cls for name, cls in EFFECTS.items() if name != "saturation"}
    result = diagnose([record(["saturation:size=0.04,form=1"], plant="stribeck")], Config(), catalogue=without_rail)
    assert names(result)
    assert result.remainder is not None
    assert result.remainder.variable == "force_N"


@pytest.mark.parametrize(
    ("effect", "seed"), [("stick_slip:size=0.04", 3), ("velocity_noise:size=0.02", 5), ("outliers:size=0.04", 3)]
)
def test_scatter_outside_the_catalogue_is_told_beside_a_cause(effect: str, seed: int) -> None:
    """It raises the noise floor, so no error above the floor tells it."""
    only_trait = {"direction_asymmetry": EFFECTS["direction_asymmetry"]}
    result = diagnose([record([effect], plant="tabulated", seed=seed)], Config(), catalogue=only_trait)
    assert names(result) == ["direction_asymmetry"]
    assert result.remainder is not None
    assert result.remainder.kind == "variance"


def test_even_noise_beside_a_cause_is_no_scatter() -> None:
    only_trait = {"presliding": EFFECTS["presliding"]}
    result = diagnose([record(plant="maxwell_slip")], Config(), catalogue=only_trait)
    assert names(result) == ["presliding"]
    assert result.remainder is None


@pytest.mark.parametrize(("hidden", "likeness"), [("viscosity_drift", "wear"), ("wear", "viscosity_drift")])
def test_a_free_shape_is_no_other_slow_cause(hidden: str, likeness: str) -> None:
    """A share of its own at each speed follows either; which speeds change tells the boundary level from the oil."""
    samples = record([f"{hidden}:size=0.04"], plant="parallel_memory")
    other = diagnose([samples], Config(), catalogue={likeness: EFFECTS[likeness]})
    assert other.verdict == "unexplained"
    assert names(diagnose([samples], Config(), catalogue={hidden: EFFECTS[hidden]})) == [hidden]


def test_a_slow_change_outside_the_catalogue_does_not_hide_itself() -> None:
    """What is left of it is correlated over seconds, as coloured noise might be; but it repeats in the next cycle."""
    result = diagnose([record(["viscosity_drift:size=0.01"])], Config(), catalogue=ONLY_MASS)
    assert result.verdict == "unexplained"
    assert result.remainder is not None
    assert result.remainder.variable == "time_s"


def test_too_little_data_are_undecidable_whatever_they_show() -> None:
    samples = record(["dropout:size=0.04,length=7"])[:420]
    result = diagnose([samples], Config())
    assert result.verdict == "undecidable"
    assert names(result) == []
    assert not is_offered(result)


def test_a_fault_of_the_data_alone_is_a_finding_without_gain() -> None:
    result = diagnose([record(["dropout:size=0.04,length=7"])], Config())
    assert result.verdict == "effects_found"
    assert names(result) == ["dropout"]
    assert result.effects == ()
    assert result.total_gain is None
    assert not is_offered(result)


def test_a_coarse_lattice_does_not_hide_what_rounding_cannot_make() -> None:
    alone = diagnose([record(["quantization:size=0.04"])], Config())
    assert names(alone) == ["quantization"]
    assert alone.unexplained_percent < 5.0
    beside = diagnose([record(["velocity_delay:size=0.03", "quantization:size=0.04"])], Config())
    assert names(beside) == ["quantization", "velocity_delay"]


@pytest.mark.parametrize("form", [0, 1])
def test_steps_of_the_force_that_bristles_conceal_are_told_and_make_no_bias(form: int) -> None:
    """Beside the base model's error they were too small for a name, and what cutting off makes was a bias."""
    samples = record([f"quantization:step=0.1,form={form}"], plant="maxwell_slip", noise=0.03)
    found = diagnose([samples], Config(), catalogue=chosen("presliding", "quantization", "sensor_bias"))
    assert names(found) == ["quantization", "presliding"]


def test_a_bias_beside_steps_is_known_to_half_a_step() -> None:
    """Cut off with 0.3 of a step more, or rounded with 0.2 less, is one record: its sign was wrong."""
    raw = record(noise=0.01)
    samples = replace(raw, friction_N=0.2 * np.floor(raw.friction_N / 0.2 + 1.3))
    found = diagnose([samples], Config(), catalogue=chosen("quantization", "sensor_bias"))
    assert names(found) == ["quantization", "sensor_bias"]
    bias = found.effects[0].parameters["bias"]
    assert bias.value == pytest.approx(0.16, abs=0.01)  # 0.8 of a step as if rounded
    assert bias.high > 0.255  # 1.3 of a step as it was cut off


SLOW_DRIVES = {
    "levels": (segment(9.0, 50.0, 54.0, "triangle"), segment(15.0, 200.0, 60.0, "speed_steps")),
    "sines": (segment(16.0, 50.0, 64.0, "speed_steps"), segment(10.0, 200.0, 60.0)),
}


@pytest.mark.parametrize(("plant", "drive"), [("stribeck", "levels"), ("parallel_memory", "sines")])
def test_what_steps_of_the_force_do_at_a_few_levels_is_no_other_cause(plant: str, drive: str) -> None:
    """The fit had followed the rounded levels; rounding that again with another origin says nothing of them."""
    samples = record(["quantization:step=1.3"], plant=plant, segments=SLOW_DRIVES[drive])
    some = chosen("quantization", "pressure_dependence", "side_spring", "presliding", "velocity_delay")
    found = diagnose([samples], Config(), catalogue=some)
    assert names(found) == ["quantization"]
    assert found.unexplained_percent < 5.0


@pytest.mark.parametrize("step", [0.1, 0.4])
def test_the_bias_of_steps_that_are_cut_off_is_not_told_beside_them(step: float) -> None:
    """Few strokes and a jump of the gain: the base alone did not show that the mean is off by half a step."""
    hidden = ["gain_step:step=0.2,at=4.5", f"quantization:step={step},form=1"]
    samples = record(hidden, segments=(segment(3.0, 50.0, 9.0),), noise=0.005)
    found = diagnose([samples], Config(), catalogue=chosen("quantization", "gain_step", "sensor_bias"))
    assert names(found) == ["quantization", "gain_step"]
    assert "half a step is taken off" in found.faults[0].evidence


@pytest.mark.parametrize("seed", [2, 3])
def test_a_soft_rail_that_only_begins_to_bend_is_told(seed: int) -> None:
    """Far above the force its level and its share are one number, and the fit ran to where no force comes."""
    samples = record(["saturation:size=0.01,form=1"], noise=0.03, seed=seed)
    assert names(diagnose([samples], Config(), catalogue=chosen("saturation", "wear"))) == ["saturation"]


def test_a_fault_that_was_repaired_completely_is_a_note() -> None:
    samples = record()
    assert samples.position_m is not None
    low = samples.position_m.min() - 0.01
    wrapped = replace(samples, position_m=low + np.mod(samples.position_m - low, 0.02))
    result = diagnose([wrapped], Config())
    assert result.verdict == "nothing_found"
    assert any("wrap" in note for note in result.excitation.notes)


NUMBERS = ("p_value", "gain", "total_gain")


def named_values(node: ast.AST) -> list[tuple[object, ast.AST | None]]:
    """Return what a node gives names to: keywords, assignments, keys."""
    if isinstance(node, ast.keyword):
        return [(node.arg, node.value)]
    if isinstance(node, ast.AnnAssign):
        return [(getattr(node.target, "id", None), node.value)]
    if isinstance(node, ast.Assign):
        return [(getattr(target, "id", None), node.value) for target in node.targets]
    if isinstance(node, ast.Dict):
        return [(getattr(k, "value", None), v) for k, v in zip(node.keys, node.values, strict=True)]
    return []


def constants(tree: ast.AST) -> list[int]:
    """Return the lines at which a number in the text stands for a p-value or a gain."""
    pairs = [pair for node in ast.walk(tree) for pair in named_values(node)]
    found = [value for name, value in pairs if name in NUMBERS and isinstance(value, ast.Constant)]
    return sorted(value.lineno for value in found if isinstance(value.value, int | float))


def test_no_p_value_and_no_gain_is_a_literal() -> None:
    places = [
        f"{path.relative_to(PACKAGE)}:{line}"
        for folder in ("diagnosis", "effects", "report", "cli")
        for path in sorted((PACKAGE / folder).glob("*.py"))
        for line in constants(ast.parse(path.read_text()))
    ]
    assert places == []


def test_the_literal_is_recognised() -> None:
    assert constants(ast.parse("a = Fault(p_value=1e-12)\np_value: float = 0.0\nx = {'gain': 3.0}")) == [1, 2, 3]
    assert constants(ast.parse("a = Fault(p_value=None)\np_value = min(1.0, p)")) == []
