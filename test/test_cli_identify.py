"""The verb `identify`: the contract's fields, the batch fit as a bound, the excess of the laws, wrong uses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.write import write_samples
from friction_estimator.cli.main import main
from friction_estimator.core.fit.batch import predict
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config

DEMO = Path(__file__).parents[1] / "bags" / "demo"


def run(*words):
    try:
        return main([*map(str, words)])
    except SystemExit as end:
        return end.code


def identified(capsys, *words):
    assert run("identify", *words, "--json", "-") == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("model", ["hammerstein", "parallel"])
def test_json_has_the_fields_of_replay_and_the_rank(capsys, model):
    assert run("replay", DEMO, "--model", model, "--json", "-") == 0
    replayed = json.loads(capsys.readouterr().out)
    result = identified(capsys, DEMO, "--model", model)
    assert set(result) >= set(replayed) | {"identifiable_rank"}
    assert result["schema"] == "friction_estimator/identify/2"
    assert result["samples"] == replayed["samples"]
    assert 0 < result["identifiable_rank"] < result["parameter_count"]
    assert len(result["singular_values"]) == result["parameter_count"]
    above = np.array(result["singular_values"]) > result["singular_value_threshold"]
    assert above.sum() == result["identifiable_rank"]
    # The same law over the same record: `identify` reports what `replay` does, and its excess over the fit.
    assert result["online"]["rls"]["nrmse"] == replayed["nrmse"]
    for row in result["online"].values():
        assert row["excess"] == pytest.approx(row["nrmse"] / result["nrmse"])
        assert row["excess_final"] == pytest.approx(row["nrmse_final"] / result["nrmse_final"])
    assert result["online"]["rls"]["excess"] > 1.0


def test_the_parameters_are_those_of_the_figures(capsys, tmp_path):
    """config.yaml that is written starts a frozen model with exactly the reported error."""
    out = tmp_path / "out"
    result = identified(capsys, DEMO, "--fit-only", "--out", out)
    assert "online" not in result
    config = read_config(out / "config.yaml")
    samples = to_samples(read_recording(DEMO), config).samples
    learned = Model(config).split(Model(config).initial_theta())
    np.testing.assert_array_equal(learned.fir_taps, result["parameters"]["fir_taps"])
    assert nrmse(samples.friction_N, predict(samples, config, learned)) == pytest.approx(result["nrmse"], rel=1e-12)
    assert json.loads((out / "summary.json").read_text()) == result
    for name in ("report.html", "figures/signals.png", "bag/metadata.yaml"):
        assert (out / name).stat().st_size > 0


def test_what_comes_after_the_freeze_is_not_fitted(capsys, tmp_path):
    samples = to_samples(read_recording(DEMO), Config()).samples
    half = round(0.5 * len(samples))
    spoilt = samples.friction_N.copy()
    spoilt[half:] *= -1.0
    write_samples(tmp_path / "spoilt", Samples(samples.stamp_ns, samples.velocity_m_s, spoilt, samples.restart))
    write_samples(
        tmp_path / "whole", Samples(samples.stamp_ns, samples.velocity_m_s, samples.friction_N, samples.restart)
    )
    settings = tmp_path / "units.yaml"
    settings.write_text("/**:\n  ros__parameters:\n    force_unit: 3.0\n")
    words = ("--freeze-after", 0.5, "--fit-only", "--config", settings)
    one, other = (identified(capsys, tmp_path / name, *words) for name in ("spoilt", "whole"))
    assert one["parameters"] == other["parameters"]
    assert other["nrmse_frozen"] < 0.05 < one["nrmse_frozen"]


def test_one_law_can_be_chosen(capsys):
    assert list(identified(capsys, DEMO, "--law", "nlms")["online"]) == ["nlms"]


@pytest.mark.parametrize("fraction", ["0", "1.5", "-1"])
def test_a_wrong_fraction_is_one_line(capsys, fraction):
    assert run("identify", DEMO, "--freeze-after", fraction) == 2
    error = capsys.readouterr().err
    assert "freeze-after" in error
    assert "Traceback" not in error
    assert len(error.strip().splitlines()) == 1


def test_a_missing_recording_is_one_line(capsys, tmp_path):
    assert run("identify", tmp_path / "none") == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_too_large_a_structure_names_the_remedy(capsys, tmp_path):
    settings = tmp_path / "large.yaml"
    settings.write_text("/**:\n  ros__parameters:\n    fir: {order: 64}\n")
    assert run("identify", DEMO, "--config", settings) == 2
    assert "lower fir.order" in capsys.readouterr().err


def test_real_axis_frozen_after_the_first_half(shared_data, capsys, tmp_path):
    """EMPS, laps 1-2 learned, laps 3-4 predicted: at most 0.055, where Coulomb, viscous and offset reach 0.068."""
    table = shared_data / "emps_nlgreyfast" / "data.csv"
    time_s, velocity, friction = np.loadtxt(table, delimiter=",", skiprows=1, usecols=(0, 6, 8), unpack=True)
    stamp = np.rint(time_s * 1e9).astype(np.int64) + 10**9
    write_samples(tmp_path / "emps", Samples(stamp, velocity, friction, np.arange(stamp.size) == 0))
    result = identified(capsys, tmp_path / "emps", "--model", "hammerstein", "--freeze-after", 0.5)
    assert result["nrmse_frozen"] <= 0.055
    half = round(0.5 * stamp.size)
    columns = np.column_stack([np.sign(velocity), velocity, np.ones(stamp.size)])
    known = columns @ np.linalg.lstsq(columns[:half], friction[:half], rcond=None)[0]
    assert result["nrmse_frozen"] < 0.85 * nrmse(friction[half:], known[half:])
    assert run("replay", tmp_path / "emps", "--model", "hammerstein", "--freeze-after", 0.5, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["nrmse_frozen"] <= 0.055


@pytest.mark.usefixtures("blank_drawings")
def test_extension_terms_are_fitted(capsys, tmp_path):
    """With a spring on the load cell only the model that has the spring fits, from a file with learned values too."""
    samples = to_samples(read_recording(DEMO), Config()).samples
    position = np.cumsum(samples.velocity_m_s) * np.diff(samples.stamp_ns, prepend=samples.stamp_ns[0]) / 1e9
    sprung = replace(samples, position_m=position, friction_N=samples.friction_N + 50.0 * position)
    write_samples(tmp_path / "bag", sprung)
    extended = tmp_path / "extended.yaml"
    extended.write_text("/**:\n  ros__parameters:\n    extension: {terms: ['side_spring:centre=0.0']}\n")
    plain = identified(capsys, tmp_path / "bag", "--fit-only")
    assert run("identify", tmp_path / "bag", "--config", extended, "--fit-only", "--out", tmp_path / "out") == 0
    capsys.readouterr()
    fitted = identified(capsys, tmp_path / "bag", "--config", tmp_path / "out" / "config.yaml", "--law", "rls")
    assert fitted["nrmse"] < 0.9 * plain["nrmse"]
    assert fitted["parameters"]["extension_weights"] == pytest.approx([50.0], rel=0.15)
    assert len(fitted["standard_errors"]["extension_weights"]) == 1
