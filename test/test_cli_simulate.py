"""The verb `simulate`: what it writes, what it says, how it refuses; and the example recordings it made."""

import json
from pathlib import Path

import numpy as np
import pytest
from documented import commands

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.write import written
from friction_estimator.cli.main import main
from friction_estimator.cli.simulate import add_recording
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.online.replay import replay
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import write_config
from friction_estimator.effects import EFFECTS, parse_effect
from friction_estimator.rig.drive import parse_schedule, segment
from friction_estimator.rig.simulate import Scenario, simulate

BAGS = Path(__file__).parents[1] / "bags"
CHANNELS = ("stamp_ns", "velocity_m_s", "friction_N", "restart", "pressure_Pa", "temperature_degC", "position_m")
SHORT = ["--schedule", "0.5:50:2,0.25:200:1:crank", "--rate", "200"]


def read(path):
    return to_samples(read_recording(path), Config()).samples


def run(*words):
    """Return the exit code; usage errors leave through SystemExit."""
    try:
        return main(["simulate", *map(str, words)])
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_recording_holds_the_simulated_samples_to_the_bit(tmp_path, storage):
    assert run("--out", tmp_path / "bag", *SHORT, "--seed", 3, "--plant", "clean", "--storage", storage) == 0
    scenario = Scenario(parse_schedule(SHORT[1]), plant="clean", rate_hz=200.0, seed=3)
    recorded, wanted = read(tmp_path / "bag"), simulate(scenario).samples
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(recorded, name), getattr(wanted, name), err_msg=name)


@pytest.mark.parametrize("effect", ["duplicate_stamps:fraction=0.05", "clock_jump:jump=-2,at=1", "dropout", "outliers"])
def test_faulty_recordings_read_as_the_simulation_pairs_them(tmp_path, effect):
    simulation = simulate(Scenario(parse_schedule(SHORT[1]), rate_hz=200.0, effects=(parse_effect(effect),)))
    with written(tmp_path / "bag") as writer:
        add_recording(writer, simulation)
    recorded, wanted = read(tmp_path / "bag"), simulation.paired()
    for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart"):
        np.testing.assert_array_equal(getattr(recorded, name), getattr(wanted, name), err_msg=name)


def test_the_same_options_write_the_same_file(tmp_path):
    for name in ("one", "two"):
        assert run("--out", tmp_path / name / "bag", *SHORT, "--effect", "stick_slip") == 0
    one, two = (tmp_path / name / "bag" / "bag.mcap" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()


def test_json_alone_is_on_stdout_and_states_the_truth(tmp_path, capsys):
    words = ["--out", tmp_path / "bag", *SHORT, "--effect", "sensor_bias:size=0.1", "--temperature-degf", 77, "--json"]
    assert run(*words) == 0
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert summary["schema"] == "friction_estimator/simulate/1"
    assert summary["temperature_degC"] == pytest.approx(25.0)
    assert [part["cycles"] for part in summary["schedule"]] == [4, 4]
    (effect,) = summary["truth"]["effects"]
    assert effect["name"] == "sensor_bias"
    assert effect["size"] == pytest.approx(0.1, rel=1e-6)
    assert parse_effect(effect["spec"]).values == effect["values"]
    assert "sensor_bias" in captured.err


def test_the_channels_are_sent_when_they_change(tmp_path):
    assert run("--out", tmp_path / "bag", "--schedule", "1:50:2,1:200:2", "--rate", 1000) == 0
    streams = read_recording(tmp_path / "bag").streams
    assert len(streams["velocity"]) == len(streams["friction"]) == len(streams["position"]) == 4000
    assert len(streams["temperature"]) == 40
    assert 40 < len(streams["pressure"]) < 200


@pytest.mark.parametrize(
    ("words", "seconds"),
    [(["--cycles", "2"], 2.0), (["--seconds", "3.4"], 3.0), (["--condition", "a", "--seconds", "1"], 5.0)],
)
def test_conditions_run_for_whole_cycles(tmp_path, capsys, words, seconds):
    assert run("--out", tmp_path / "bag", "--rate", 100, "--json", "-", *words) == 0
    assert json.loads(capsys.readouterr().out)["duration_s"] == seconds


def test_the_catalogue_is_json_with_keys_units_and_ranges(capsys):
    assert run("--list-effects") == 0
    catalogue = {entry["name"]: entry for entry in json.loads(capsys.readouterr().out)}
    assert set(catalogue) == set(EFFECTS)
    for entry in catalogue.values():
        for key in entry["keys"]:
            assert {"name", "unit", "default", "range", "description"} <= set(key)
    assert "kg" in {key["unit"] for key in catalogue["inertia"]["keys"]}


def test_help_ends_with_an_example(capsys):
    assert run("--help") == 0
    assert "example:\n  friction_estimator simulate --out" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--out BAG is missing"),
        (["--effect", "gravitation"], "unknown effect 'gravitation': choose one of"),
        (["--effect", "inertia:weight=2"], "has no key 'weight'"),
        (["--effect", "inertia:mass=x"], "mass='x' is no number"),
        (["--effect", "pressure_dependence:size=0.1"], "cannot reach size=0.1"),
        (["--schedule", "1:50"], "write PERIOD:PRESSURE_PSI:SECONDS"),
        (["--schedule", "1:50:5", "--cycles", "3"], "--cycles goes with --condition"),
        (["--schedule", "1:50:5", "--condition", "a"], "not allowed with"),
        (["--condition", "d"], "invalid choice: 'd'"),
        (["--plant", "dirty"], "invalid choice: 'dirty'"),
        (["--rate", "nan"], "a rate of nan Hz"),
        (["--rate", "fast"], "invalid float value: 'fast'"),
        (["--noise", "-1"], "a noise of -1"),
        (["--cycles", "0"], "0 cycles"),
        (["--temperature", "200"], "outside -40 to 150 degC"),
        (["--eccentric", "0.2", "--rod", "0.1"], "too short"),
        (["--seed", "-3"], "a seed of -3"),
    ],
)
def test_a_wrong_use_is_refused_in_one_line_and_writes_nothing(tmp_path, capsys, words, message):
    target = [] if not words else ["--out", tmp_path / "bag", "--rate", "200"]
    words = target + words if "--rate" not in words else ["--out", tmp_path / "bag", *words]
    assert run(*words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert captured.err.startswith("friction_estimator simulate: ")
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_contradicts_the_storage_is_refused(tmp_path, capsys):
    assert run("--out", tmp_path / "x.mcap", "--storage", "sqlite3", *SHORT) == 2
    assert "x.mcap" in capsys.readouterr().err


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A configuration that learned from the example recording."""
    folder = tmp_path_factory.mktemp("learned")
    samples = read(BAGS / "demo")
    write_config(folder / "config.yaml", replay(samples, Config()).estimator.learned_config)
    return folder / "config.yaml"


def test_a_learned_model_plays_the_plant_it_was_learned_from(tmp_path, learned, capsys):
    words = ["--out", tmp_path / "bag", "--condition", "b", "--cycles", 3, "--rate", 200, "--noise", 0, "--json"]
    assert run(*words, "--config", learned) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["plant"] == "identified"
    assert "warning" not in captured.err
    truth = simulate(Scenario((segment(1.0, 50.0, 3.0),), rate_hz=200.0)).clean_N
    assert nrmse(truth[200:], read(tmp_path / "bag").friction_N[200:]) < 0.03


def test_a_learned_model_knows_its_limits(tmp_path, learned, capsys):
    out = ["--out", tmp_path / "bag", "--rate", 200, "--config", learned]
    assert run(*out, "--plant", "rig") == 2
    assert "holds a learned model" in capsys.readouterr().err
    assert run(*out, "--effect", "wear") == 2
    assert "wear acts on the oil film" in capsys.readouterr().err
    assert run(*out, "--schedule", "0.5:50:2", "--effect", "inertia:mass=1") == 0
    assert "samples lie outside the learned velocities" in capsys.readouterr().err


def test_a_configuration_without_learned_values_sets_the_theory(tmp_path, capsys):
    (tmp_path / "seal.yaml").write_text("/**: {ros__parameters: {seal: {boundary_friction: 0.4}}}", encoding="utf-8")
    forces = []
    for words in ([], ["--config", tmp_path / "seal.yaml"]):
        assert run("--out", tmp_path / "bag", *SHORT, "--json", *words) == 0
        forces.append(json.loads(capsys.readouterr().out)["truth"]["clean_friction_rms_N"])
    assert forces[1] > 1.5 * forces[0]


def example_commands():
    """The commands that bags/README.md states, by recording."""
    stated = [command.words for command in commands("bags/README.md")]
    return {Path(words[2]).name: words[3:] for words in stated if words[:2] == ["simulate", "--out"]}


@pytest.mark.parametrize("name", [item.name for item in sorted(BAGS.iterdir()) if item.is_dir()])
def test_the_example_recordings_are_what_their_commands_make(tmp_path, name):
    """To rounding: the last bit of a sine is the processor's."""
    assert run("--out", tmp_path / "bag", *example_commands()[name]) == 0
    kept, made = read(BAGS / name), read(tmp_path / "bag")
    np.testing.assert_array_equal(kept.stamp_ns, made.stamp_ns)
    for channel in CHANNELS[1:]:
        a, b = getattr(kept, channel), getattr(made, channel)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=channel)


def test_the_example_recordings_are_small():
    assert sum(item.stat().st_size for item in BAGS.rglob("*") if item.is_file()) < 600_000
