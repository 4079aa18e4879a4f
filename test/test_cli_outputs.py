"""No verb replaces an input or what a user put there; what it writes is one set, by one writer at a time."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from blank_drawings import blank_drawings as drawn_blank

from friction_estimator.cli.diagnose import refusal as refused_by_diagnose
from friction_estimator.cli.main import main
from friction_estimator.cli.results import RESULTS
from friction_estimator.output.staging import Staging

# Which files there are and whose they are is looked at, not what is in them.
pytestmark = [pytest.mark.xdist_group("cli_outputs"), pytest.mark.usefixtures("blank_drawings")]

SHORT = ("--condition", "b", "--cycles", "3", "--rate", "200")
TABLE = ("--time", "t", "--map", "velocity=v,friction=f")


def run(*words):
    return main([str(word) for word in words])


def contents(folder):
    """Return what is in a folder: name -> bytes of each file."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A recording, results of a replay over it, and a table."""
    folder = tmp_path_factory.mktemp("made")
    assert run("simulate", *SHORT, "--out", folder / "bag") == 0
    with drawn_blank():
        assert run("replay", folder / "bag", "--out", folder / "run") == 0
    rows = [f"{k * 0.01:.2f},{k % 7 - 3},{k % 5}\n" for k in range(1, 200)]
    (folder / "table.txt").write_text("t,v,f\n" + "".join(rows))
    return folder


@pytest.fixture
def place(made, tmp_path):
    """A copy of `made`."""
    return Path(shutil.copytree(made, tmp_path / "place"))


def refused(capsys, place, *words):
    """Run a verb that must change nothing; return its line."""
    before = contents(place)
    capsys.readouterr()
    assert run(*words) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "warning:" not in line]
    assert len(lines) == 1
    assert contents(place) == before
    assert not list(place.rglob(".*"))
    return lines[0]


# Inputs


@pytest.mark.parametrize("verb", ["replay", "identify", "diagnose"])
def test_results_never_replace_the_recording_that_they_are_made_from(place, capsys, verb):
    """As it was: the recording without its other topics, and exit code 0."""
    line = refused(capsys, place, verb, place / "run" / "bag", "--out", place / "run")
    assert "holds the input" in line
    assert "choose another --out, or move the input out" in line
    assert "is the input" in refused(capsys, place, verb, place / "bag", "--out", place / "bag")
    assert "lies in the input" in refused(capsys, place, verb, place / "bag", "--out", place / "bag" / "results")
    metadata = place / "bag" / "metadata.yaml"
    assert "is the input" in refused(capsys, place, verb, metadata, "--out", place / "bag")
    (storage,) = (place / "bag").glob("*.mcap")
    assert "holds the input" in refused(capsys, place, verb, storage, "--out", place / "bag")


def test_a_judge_a_configuration_and_its_theory_table_are_inputs_too(place, capsys):
    run_folder, bag = place / "run", place / "bag"
    assert "holds the input" in refused(capsys, place, "replay", bag, "--test", run_folder / "bag", "--out", run_folder)
    config = run_folder / "config.yaml"
    assert "holds the input" in refused(capsys, place, "replay", bag, "--config", config, "--out", run_folder)
    (place / "curve.json").write_text("velocity_m_s,pressure_Pa,temperature_K,friction_N\n")
    (place / "own.yaml").write_text("/**: {ros__parameters: {theory: {kind: table, table: curve.json}}}")
    words = ("replay", bag, "--config", place / "own.yaml", "--json", place / "curve.json")
    assert "is the input" in refused(capsys, place, *words)


def test_the_document_never_replaces_the_table(place, capsys):
    table = place / "table.txt"
    line = refused(capsys, place, "import", table, *TABLE, "--out", place / "new", "--json", table)
    assert f"--json {table} is the input" in line


def test_the_document_is_no_part_of_the_set(place, capsys):
    words = ("replay", place / "bag", "--out", place / "run", "--json", place / "run" / "summary.json")
    assert "name a file outside of it" in refused(capsys, place, *words)


# What a user put there


@pytest.mark.parametrize(
    "name", ["notes.txt", "figures/mine.png", "bag/notes.txt", "monday/data.mcap", "config_old.yaml"]
)
def test_what_a_user_put_into_the_results_is_kept(place, capsys, name):
    file = place / "run" / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"mine")
    line = refused(capsys, place, "replay", place / "bag", "--out", place / "run")
    assert file.name in line or file.parent.name in line
    assert "move it out" in line


def test_a_recording_of_the_users_in_the_place_of_ours_is_kept(place, capsys):
    unmarked(place / "bag")
    shutil.rmtree(place / "run" / "bag")
    (place / "bag").rename(place / "run" / "bag")
    assert run("simulate", *SHORT, "--out", place / "bag") == 0
    line = refused(capsys, place, "replay", place / "bag", "--out", place / "run")
    assert "was not written by this program" in line


def unmarked(bag):
    """Take the mark from a recording: as others write it, or we did before there was one."""
    text = (bag / "metadata.yaml").read_text().splitlines(keepends=True)
    start = next(k for k, line in enumerate(text) if "custom_data" in line)
    assert "friction_estimator:" in text[start + 1]
    (bag / "metadata.yaml").write_text("".join([*text[:start], "  custom_data: null\n", *text[start + 2 :]]))


@pytest.mark.parametrize("verb", ["simulate", "import"])
def test_a_recording_is_replaced_where_it_is_ours_and_nothing_else_is_in_it(place, capsys, verb):
    words = (verb, *SHORT) if verb == "simulate" else (verb, place / "table.txt", *TABLE)
    assert run(*words, "--out", place / "bag", "--json", place / "bag.json") == 0
    (place / "bag" / "notes.txt").write_text("mine")
    assert "also holds notes.txt" in refused(capsys, place, *words, "--out", place / "bag")
    (place / "bag" / "notes.txt").unlink()
    unmarked(place / "bag")
    assert "not written by this program" in refused(capsys, place, *words, "--out", place / "bag")
    assert "no recording" in refused(capsys, place, *words, "--out", place / "run")
    assert "a file stands there" in refused(capsys, place, *words, "--out", place / "run" / "config.yaml")


def test_results_of_one_kind_do_not_replace_those_of_another(place, capsys):
    for verb, words in (("diagnose", (place / "bag",)), ("reproduce", ())):
        assert "such results" in refused(capsys, place, verb, *words, "--out", place / "run")
    assert "such results" in refused(capsys, place, "replay", place / "run" / "bag", "--out", place / "bag")


def test_results_as_they_were_before_there_was_a_mark_are_ours(place):
    unmarked(place / "run" / "bag")
    assert RESULTS.refusal(place / "run") is None


@pytest.mark.parametrize(
    "words",
    [
        ("replay", "bag"),
        ("replay", "bag", "run/bag"),
        ("identify", "bag", "--fit-only"),
        ("diagnose", "bag"),
    ],
)
def test_a_verb_takes_what_it_wrote_for_its_own(place, words):
    verb, *rest = (place / word if word in ("bag", "run/bag") else word for word in words)
    assert run(verb, *rest, "--out", place / "own") in (0, 1)
    assert (refused_by_diagnose if verb == "diagnose" else RESULTS.refusal)(place / "own") is None


# One set


def test_a_link_as_output_stays_one(place):
    (place / "disk").mkdir()
    (place / "latest").symlink_to("disk/run")
    (place / "latest.json").symlink_to("disk/result.json")
    for seed in (1, 2):
        words = ("simulate", *SHORT, "--seed", seed, "--out", place / "latest", "--json", place / "latest.json")
        assert run(*words) == 0
        assert json.loads((place / "disk" / "result.json").read_text())["seed"] == seed
    assert (place / "latest").is_symlink()
    assert (place / "latest.json").is_symlink()
    assert sorted(os.listdir(place / "disk")) == ["result.json", "run"]


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_the_second_of_two_writers_is_told_before_it_works(place, capsys, option):
    """As it was: a raw "Directory not empty" after the work."""
    target = place / ("new" if option == "--out" else "new.json")
    words = [place / "new", "--json", place / "new.json"]
    with Staging(target):
        assert run("import", place / "none.csv", *TABLE, "--out", *words) == 2
    line = capsys.readouterr().err
    assert f"{target} is in use by process {os.getpid()}" in line
    assert len(line.splitlines()) == 1


def test_hangup_is_ignored_where_the_caller_ignores_it():
    """`nohup` must keep its meaning."""
    code = (
        "import os, signal, sys; from friction_estimator.cli.terminal import guarded\n"
        "sys.exit(guarded('verb', lambda: os.kill(os.getpid(), signal.SIGHUP) or 7))"
    )
    for ignored, expected in ((True, 7), (False, 129)):
        done = subprocess.run(
            [sys.executable, "-c", code],
            check=False,
            preexec_fn=lambda ignored=ignored: signal.signal(
                signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL
            ),
        )
        assert done.returncode == expected


def test_the_document_goes_where_stdout_goes(place):
    words = ["simulate", *SHORT, "--out", str(place / "new"), "--json", "/dev/stdout"]
    with (place / "log").open("wb") as log:
        subprocess.run([sys.executable, "-m", "friction_estimator", *words], stdout=log, check=True)
    said, brace, rest = (place / "log").read_text().partition("{")
    assert "written" in said
    assert json.loads(brace + rest)["samples"] == 600


def test_an_export_never_replaces_what_it_reads(place, capsys):
    """Whether the model is given as a folder or by its config.yaml; as it was, the recording beside it was replaced."""
    for model in ("run", "run/config.yaml"):
        for name, says in (
            ("config.yaml", "is the input"),
            ("summary.json", "is the input"),
            ("bag/bag.mcap", "lies in the input"),
        ):
            words = ("export", place / model, "--format", "csv", "--out", place / "run" / name)
            assert says in refused(capsys, place, *words)


def test_an_export_never_replaces_the_theory_table_of_the_model(place, capsys):
    table, config = place / "table.csv", place / "table.yaml"
    rows = [f"{v},{p},{t},{5 * v}" for v in (-0.2, 0.0, 0.2) for p in (0, 1e6) for t in (300, 350)]
    table.write_text("\n".join(["velocity_m_s,pressure_Pa,temperature_K,friction_N", *rows]))
    config.write_text("/**: {ros__parameters: {theory: {kind: table, table: table.csv}}}\n")
    assert run("replay", place / "bag", "--config", config, "--out", place / "by_table") == 0
    assert "is the input" in refused(capsys, place, "export", place / "by_table", "--format", "csv", "--out", table)
