"""Hide an effect in simulated data and require its name; hide none and require none."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_records import abba, chosen, names, record, set_of
from measured_seals import WITHOUT_THEORY, check_measured_seal

from friction_estimator.bag.table import TableSpec, read_table
from friction_estimator.cli.main import main
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.online.replay import replay
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.extend import extended_config
from friction_estimator.diagnosis.summary import as_json, sentences
from friction_estimator.documents.configuration import read_config, write_config
from friction_estimator.effects import EFFECTS, extension_from_config
from friction_estimator.rig.drive import segment

# Off the grids, half of them in another functional form than the regressor.
HIDDEN = [
    "inertia:size=0.04",
    "presliding:size=0.04,length=2.3e-5,form=1",
    "position_dependence:size=0.04,wavelength=0.0037,phase=0.7,form=1",
    "squeeze_film:size=0.04,speed=0.0123",
    "viscosity_drift:size=0.04,time_constant=23,form=1",
    "periodic_disturbance:size=0.02,frequency=17.37,form=1",
    "direction_asymmetry:size=0.04,form=1",
    "stick_slip:size=0.04,frequency=41,form=1",
    "saturation:size=0.04",
    "saturation:size=0.04,form=1",
    "dropout:size=0.04,length=7",
]


@pytest.mark.parametrize("hidden", HIDDEN)
def test_a_hidden_effect_is_named_and_nothing_else(hidden: str) -> None:
    result = diagnose([record([hidden], segments=abba()[:4])], Config())
    name = hidden.split(":", maxsplit=1)[0]
    assert result.verdict == "effects_found"
    assert names(result) == [name]
    if result.faults:  # of the data: neither a gain nor, here, anything left over
        assert result.faults[0].evidence
        assert result.total_gain is None
        return
    first = result.effects[0]
    assert len(first.rivals) <= 2
    assert first.p_value is not None
    assert first.p_value <= 0.01
    gain = first.gain
    assert gain == result.total_gain  # one effect: the chain is this step
    assert gain is not None
    assert 0.0 < gain.low_percent <= gain.reduction_percent <= gain.high_percent
    assert gain.nrmse_before == pytest.approx(result.nrmse_holdout)
    recovered = (gain.nrmse_before**2 - gain.nrmse_after**2) / (gain.nrmse_before**2 - result.noise_floor**2)
    assert recovered > (0.7 if "form=1" in hidden else 0.9)


def test_a_small_effect_in_much_noise_is_named() -> None:
    result = diagnose([record(["inertia:size=0.005"], noise=0.03)], Config())
    assert [e.name for e in result.effects] == ["inertia"]


def test_what_is_small_beside_a_named_cause_is_a_trace() -> None:
    """Alone a ripple of 4 mN would pass: what the form of another cause leaves is as large (decision 0133)."""
    result = diagnose([record(["inertia:mass=0.5", "position_dependence:amplitude=0.004,wavelength=0.004"])], Config())
    assert names(result) == ["inertia"]
    assert [trace.name for trace in result.traces] == ["position_dependence"]
    assert 0.2 < result.traces[0].share_percent < 1.5


def test_fitted_parameters_are_the_true_ones() -> None:
    hidden = ["inertia:mass=0.5", "presliding:amplitude=0.9,length=2.6e-5"]
    result = diagnose([record(hidden, segments=abba()[:4])], Config())
    values = {e.name: e.parameters for e in result.effects}
    assert set(values) == {"inertia", "presliding"}
    assert values["inertia"]["mass"].value == pytest.approx(0.5, rel=0.05)
    assert values["presliding"]["length"].value == pytest.approx(2.6e-5, rel=0.1)
    for parameters in values.values():
        for estimate in parameters.values():
            assert estimate.low < estimate.value < estimate.high


@pytest.mark.parametrize(("noise", "seed"), [(0.01, 1), (0.03, 2)])
def test_nothing_hidden_is_nothing_found(noise: float, seed: int) -> None:
    result = diagnose([record([], noise=noise, seed=seed)], Config())
    assert result.verdict == "nothing_found"
    assert result.effects == ()
    assert result.remainder is None
    assert result.noise_floor == pytest.approx(noise, rel=0.05)
    # The prototype's promise in words: what was tried, and how small an effect would have been seen.
    assert result.detection_limit_N
    assert all(0.0 < limit < 1.0 for limit in result.detection_limit_N.values())
    assert "would have been named" in " ".join(sentences(result, Quantities()))


ONE_SINE = (segment(2.0, 50.0, 40.0),)


@pytest.mark.parametrize(
    ("hidden", "expected"),
    [
        # a = -w^2 x: a mass is a spring of negative stiffness, and no mass is negative
        ("inertia", {"inertia", "side_spring"}),
        # a relaxation that is slow against the period is a spring
        ("side_spring", {"side_spring", "viscoelastic_relaxation"}),
        ("viscoelastic_relaxation", {"side_spring", "viscoelastic_relaxation"}),
    ],
)
def test_what_one_sine_cannot_separate_is_named_as_a_set(hidden: str, expected: set[str]) -> None:
    result = diagnose([record([f"{hidden}:size=0.04"], segments=ONE_SINE)], Config())
    assert len(result.effects) == 1
    first = result.effects[0]
    assert expected <= set_of(first)
    assert first.experiment
    assert any(first.experiment.startswith(f"{first.name} or {rival}: ") for rival in first.rivals)
    assert hidden != "inertia" or "second period" in first.experiment
    assert any("one drive period" in text for text in result.excitation.warnings)


@pytest.mark.parametrize("hidden", ["squeeze_film", "direction_asymmetry", "presliding", "sensor_drift", "wear"])
def test_under_one_sine_the_truth_is_in_the_set(hidden: str) -> None:
    result = diagnose([record([f"{hidden}:size=0.04"], segments=ONE_SINE)], Config())
    assert len(result.effects) == 1
    first = result.effects[0]
    assert hidden in set_of(first)
    assert bool(first.rivals) == bool(first.experiment)
    assert any("one drive period" in text for text in result.excitation.warnings)


def test_a_filter_under_one_sine_is_absorbed_and_the_report_says_that_it_may_be() -> None:
    result = diagnose([record(["sensor_lowpass:size=0.04"], segments=(segment(2.0, 50.0, 60.0),))], Config())
    assert result.verdict == "nothing_found"
    assert any("one drive period" in text for text in result.excitation.warnings)


def test_friction_that_curves_with_pressure_is_fitted_with_its_curvature() -> None:
    levels = (50.0, 200.0, 400.0, 400.0, 200.0, 50.0)
    parts = tuple(segment(period, psi, 10.0) for psi in levels for period in (1.0, 5.0))
    hidden = "pressure_dependence:boundary=2e-7,curvature=1e-12"
    found = diagnose([record([hidden], segments=parts)], Config()).effects[0]
    assert found.name == "pressure_dependence"
    assert found.parameters["curvature"].value == pytest.approx(1e-12, rel=0.1)


ONCE = tuple(segment(t, psi, s) for psi in (50.0, 200.0) for t, s in ((1.0, 20.0), (5.0, 30.0)))


@pytest.mark.parametrize(
    ("hidden", "rival"), [("pressure_dependence", "gain_step"), ("sensor_drift", "pressure_dependence")]
)
def test_a_pressure_that_changes_once_leaves_what_changed_with_it_open(hidden: str, rival: str) -> None:
    """It is warned of, and where friction depends on it, the pressure is preferred to what changed with it."""
    result = diagnose([record([f"{hidden}:size=0.04"], segments=ONCE)], Config())
    first = result.effects[0]
    assert {hidden, rival} <= set_of(first)
    assert "order" in str(first.experiment)
    assert any("randomise the order" in text for text in result.excitation.warnings)
    assert hidden != "pressure_dependence" or names(result) == [hidden]


def test_the_same_seed_gives_the_same_answer() -> None:
    samples = record(["inertia:size=0.03"], segments=abba()[:4])
    one = as_json(diagnose([samples], Config(), seed=4), ["a"], {}, None, Quantities())
    other = as_json(diagnose([samples], Config(), seed=4), ["a"], {}, None, Quantities())
    assert one == other


def test_recordings_may_be_split_and_non_periodic() -> None:
    shapes = tuple(segment(t, 50.0, 20.0, "multisine") for t in (4.0, 7.0))
    whole = record(["inertia:size=0.04"], segments=shapes)
    half = len(whole) // 2
    result = diagnose([whole[:half], whole[half:]], Config())
    assert result.effects[0].name == "inertia"


def test_missing_channels_are_asked_for() -> None:
    samples = record(["position_dependence:size=0.04,wavelength=0.004"], segments=abba()[:4])
    some = chosen("position_dependence", "inertia", "direction_asymmetry", "periodic_disturbance")
    result = diagnose([replace(samples, position_m=None)], Config(), catalogue=some)
    assert ("position_dependence", "position") in result.needs_channel
    assert "position_dependence" not in [e.name for e in result.effects]


def test_too_little_data_cannot_answer() -> None:
    samples = record([])
    with pytest.raises(UnanswerableError, match="too few"):
        diagnose([samples[:200]], Config())
    result = diagnose([samples[:420]], Config())
    assert result.verdict == "undecidable"
    assert result.effects == ()


def test_the_extended_model_predicts_what_the_base_cannot(tmp_path: Path) -> None:
    samples = record(["position_dependence:size=0.04,wavelength=0.004", "presliding:size=0.03"], segments=abba()[:4])
    some = chosen("position_dependence", "presliding", "breakaway", "side_spring", "inertia", "periodic_disturbance")
    result = diagnose([samples], Config(), catalogue=some)
    write_config(tmp_path / "extended.yaml", extended_config(result))
    extended = read_config(tmp_path / "extended.yaml")
    assert {t.split(":")[0] for t in extended.extension.terms} == {"position_dependence", "presliding"}
    still = extended.updated({"model.adapt": False})
    with_terms = replay(samples, still, extension=extension_from_config(still)).figures()["nrmse"]
    bare = still.updated({"extension.terms": (), "learned.extension_weights": ()})
    assert with_terms < 0.3 * replay(samples, bare).figures()["nrmse"]
    assert with_terms < 1.1 * result.noise_floor
    again = diagnose([samples], extended, catalogue=some)  # its own output is a configuration that it takes
    assert {e.name for e in again.effects} == {e.name for e in result.effects}


GAIN_KEYS = {"nrmse_before", "nrmse_after", "reduction_percent", "ci95_percent"}


def check_schema(summary: dict[str, Any]) -> None:
    """The contract, key by key."""
    assert summary["schema"] == "friction_estimator/diagnosis/2"
    assert set(summary) == {
        *("schema", "bags", "units", "verdict", "excitation", "base", "faults", "effects", "total_gain", "traces"),
        *("needs_channel", "unexplained_percent", "extended_model"),
    }
    assert set(summary["excitation"]) == {
        *("cycles", "velocity_range", "reversals", "channels", "warnings", "notes"),
    }
    assert set(summary["base"]) == {"nrmse_holdout", "noise_floor"}
    assert summary["base"]["noise_floor"] <= summary["base"]["nrmse_holdout"]
    for fault in summary["faults"]:
        assert set(fault) == {"name", "evidence", "parameters", "repaired", "figure"}
    keys = {"name", "p_value", "parameters", "gain", "indistinguishable_from", "next_experiment", "figure"}
    for effect in summary["effects"]:
        assert set(effect) == keys
        assert effect["gain"] is None or set(effect["gain"]) == GAIN_KEYS
    for named in (*summary["faults"], *summary["effects"]):
        assert named["name"] in EFFECTS
        for value in named["parameters"].values():
            assert set(value) == {"value", "unit", "ci95"}
    assert (summary["total_gain"] is None) == (not summary["effects"])
    if summary["total_gain"] is not None:
        assert set(summary["total_gain"]) == GAIN_KEYS
    for trace in summary["traces"]:
        assert set(trace) == {"name", "share_percent"}
        assert trace["share_percent"] < 0.2


def test_the_verb_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rosbags")
    bag, out = tmp_path / "run", tmp_path / "out"
    schedule = "1:50:6,5:50:10,1:200:6,5:200:10"
    made = ["simulate", "--out", str(bag), "--plant", "clean", "--rate", "200", "--schedule", schedule]
    assert main([*made, "--effect", "inertia:size=0.04", "--seed", "2"]) == 0
    capsys.readouterr()
    assert main(["diagnose", str(bag), "--out", str(out), "--json", "-"]) == 0
    summary = json.loads(capsys.readouterr().out)
    check_schema(summary)
    assert summary["effects"][0]["name"] == "inertia"
    assert Path(summary["effects"][0]["figure"]).stat().st_size > 5000
    assert (out / "report.html").exists()
    assert main(["diagnose", str(bag), "--config", str(out / "extended.yaml"), "--json", str(tmp_path / "d.json")]) == 0
    assert main(["diagnose", str(tmp_path / "none")]) == 2


def emps(shared_data: Path) -> Samples:
    table = np.genfromtxt(shared_data / "emps_nlgreyfast" / "data.csv", delimiter=",", names=True)
    restart = np.zeros(table.size, np.bool_)
    restart[0] = True
    stamps = np.round(table["t_s"] * 1e9).astype(np.int64)
    return Samples(stamps, table["v_m_s"], table["friction_filt_N"], restart, position_m=np.asarray(table["q_filt_m"]))


def test_measured_ball_screw_shows_its_pitch_and_its_asymmetry(shared_data: Path) -> None:
    settings = Config.from_mapping({"model.type": "hammerstein", "theory.kind": "none"})
    result = diagnose([emps(shared_data)], settings)
    found = {e.name: e for e in result.effects}
    ripple = found["position_dependence"]
    assert ripple.parameters["wavelength"].value == pytest.approx(2.50e-3, abs=0.02e-3)
    assert ripple.gain.reduction_percent >= 5.0
    assert ripple.gain.low_percent > 0.0
    assert set(found) - {"position_dependence"} <= {"direction_asymmetry", "sensor_bias"}
    assert len(found) == 2


def test_a_gain_that_steps_in_the_first_lap_of_a_measured_ball_screw_is_named(shared_data: Path) -> None:
    """A sixth of the record, of twelve blocks two; what explains a hundredth of it is no rival."""
    settings = Config.from_mapping({"model.type": "hammerstein", "theory.kind": "none"})
    measured = emps(shared_data)
    after = measured.stamp_ns - measured.stamp_ns[0] > 4_013_000_000
    stepped = replace(measured, friction_N=np.where(after, 1.107, 1.0) * measured.friction_N)
    some = ("direction_asymmetry", "gain_step", "bias_step", "time_delay", "sensor_lowpass")
    result = diagnose([stepped], settings, catalogue=chosen(*some))
    found = {e.name: e for e in result.effects}
    assert "gain_step" in found
    assert found["gain_step"].parameters["step"].value == pytest.approx(0.107, rel=0.15)
    assert found["gain_step"].parameters["at"].low < 4.013 < found["gain_step"].parameters["at"].high
    assert not {"time_delay", "sensor_lowpass"} & set(found["gain_step"].rivals)


@pytest.mark.parametrize(
    ("seal", "some", "rival"),
    [
        ("O-ring257", tuple(EFFECTS), False),
        ("X-ring257", ("sensor_bias", "direction_asymmetry", "pressure_dependence"), True),
    ],
)
def test_a_recorded_variable_does_not_come_before_what_explains_more(shared_data: Path, seal, some, rival) -> None:
    """At one nominal pressure: of the X-ring its errors do not tell it from a bias, but it explains less than that.

    Of the O-ring the pressure alone gains 9.4 %.
    """
    inputs = {"velocity": "v_m_s", "friction": "friction_N", "pressure": "pressure_Pa", "position": "x_m"}
    spec = TableSpec("t_s", inputs, [("seal", seal), ("nominal_bar", "5")], "segment")
    samples, _ = read_table(shared_data / "seal_zillen_pneumatic" / "data.csv", spec)
    found = diagnose([samples], Config.from_mapping(WITHOUT_THEORY), catalogue=chosen(*some))
    first = found.effects[0]
    assert first.name in {"sensor_bias", "direction_asymmetry"}
    assert ("pressure_dependence" in first.rivals) == rival
    assert found.total_gain.reduction_percent > 30.0


@pytest.mark.parametrize(
    ("seal", "given"), [("O-ring257", {}), ("X-ring257", WITHOUT_THEORY)], ids=["O-ring", "X-ring"]
)
def test_measured_seals(shared_data: Path, seal: str, given: dict[str, object]) -> None:
    """Two of the four pressures; hard/hard_diagnosis.py has all of them, which takes five times as long.

    At 2 and 6 bar alone a step of the bias is named for the X-ring, and the asymmetry as what may look like it.
    """
    check_measured_seal(shared_data, seal, given, slice(1, None, 2))
