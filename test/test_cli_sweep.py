"""`sweep`: ranked where nothing was learned, the same on any number of processes, and gone on with where it ended."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pages
import pytest
from pyarrow import parquet

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.cli import many
from friction_estimator.cli.main import main
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config
from friction_estimator.sweep import judged, recall
from friction_estimator.sweep.job import Job, judge
from friction_estimator.tasks import identity
from friction_estimator.tasks.identity import File, changed_ns

pytestmark = pytest.mark.xdist_group("cli_sweep")

FILES = ["config.yaml", "report.html", "rows.jsonl", "rows.parquet", "summary.json", "table.parquet"]
SETS = ("--set", "law=nlms,rls", "--set", "fir.order=0,4")


def run(*words):
    try:
        return main(["sweep", *map(str, words)])
    except SystemExit as end:
        return end.code


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Recordings of the rig, a few seconds at 200 Hz each."""
    folder = tmp_path_factory.mktemp("bags")
    for number, (name, schedule) in enumerate({"sine": "1:50:8", "triangle": "1:50:8:triangle"}.items()):
        words = ["--out", folder / name, "--schedule", schedule, "--rate", 200, "--seed", number]
        assert main(["simulate", *map(str, words)]) == 0
    return folder


@pytest.fixture(scope="module")
def swept(bags, tmp_path_factory):
    """A sweep of four configurations over two recordings."""
    out = tmp_path_factory.mktemp("swept") / "out"
    assert run(bags / "sine", bags / "triangle", *SETS, "--workers", 1, "--out", out) == 0
    return out


def same(one, other, *names):
    for name in names or ("rows.jsonl", "rows.parquet", "table.parquet", "config.yaml"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_sweep_writes_the_order_with_its_noise_and_the_best(swept, bags):
    assert sorted(item.name for item in swept.iterdir()) == FILES
    summary = json.loads((swept / "summary.json").read_text())
    assert summary["schema"] == "friction_estimator/sweep/1"
    assert summary["varied"] == {"model.law": ["nlms", "rls"], "fir.order": [0, 4]}
    entries = summary["configurations"]
    figures = [entry["nrmse"] for entry in entries]
    assert figures == sorted(figures)
    assert all(entry["standard_error"] > 0.0 for entry in entries)
    assert entries[0]["ratio_to_best"]["value"] == 1.0
    assert entries[-1]["told_from_best"]
    assert entries[-1]["ratio_to_best"]["ci95"][0] > 1.0
    best = read_config(swept / "config.yaml")
    assert best.model.law == entries[0]["settings"]["model.law"]
    assert best.fir.order == entries[0]["settings"]["fir.order"]
    table = parquet.read_table(swept / "table.parquet").to_pydict()
    assert table["nrmse"] == figures
    assert table["model.law"] == [entry["settings"]["model.law"] for entry in entries]
    rows = parquet.read_table(swept / "rows.parquet").to_pydict()
    assert len(rows["nrmse"]) == 8
    own = [figure for figure, rank in zip(rows["nrmse"], rows["rank"], strict=True) if rank == 1]
    assert np.exp(np.mean(np.log(own))) == pytest.approx(figures[0])
    text = (swept / "report.html").read_text()
    assert "Configurations compared" in text
    assert not re.search(r"(src|href)=[\"']https?:", text)
    assert len(text) < 200_000


def test_a_figure_is_what_replay_says_of_the_same_part(swept, bags, capsys):
    """No sample that was learned is judged: `--freeze-after` says the same figure, from its own code."""
    rows = parquet.read_table(swept / "rows.parquet").to_pydict()
    for bag, figure, law, order in zip(rows["bag"], rows["nrmse"], rows["model.law"], rows["fir.order"], strict=True):
        config = swept.parent / "one.yaml"
        config.write_text(f"/**:\n  ros__parameters:\n    model.law: {law}\n    fir.order: {order}\n")
        capsys.readouterr()
        assert main(["replay", bag, "--config", str(config), "--freeze-after", "0.5", "--json", "-"]) == 0
        assert json.loads(capsys.readouterr().out)["nrmse_frozen"] == pytest.approx(figure, rel=1e-12)


def test_two_processes_say_the_same_to_the_bit(swept, bags, tmp_path):
    assert run(bags / "sine", bags / "triangle", *SETS, "--workers", 2, "--out", tmp_path / "out") == 0
    same(swept, tmp_path / "out")


def test_other_recordings_judge_and_none_judges_itself(bags, tmp_path, capsys):
    both = (bags / "sine", bags / "triangle")
    assert run(*both, "--test", *both, "--set", "fir.order=0,4", "--workers", 1, "--out", tmp_path / "out") == 0
    rows = [json.loads(line)["row"]["result"] for line in (tmp_path / "out" / "rows.jsonl").read_text().splitlines()]
    assert [len(row["judged"]) for row in rows] == [1] * 4
    samples = [len(to_samples(read_recording(bag), Config()).samples) for bag in both]
    assert [row["samples"] for row in rows] == [samples[0], samples[0], samples[1], samples[1]]
    assert all(row["judged"][0]["samples"] == samples[0] - judged.LONGEST_MEMORY for row in rows)
    contents = [row["judged"][0]["recording"] for row in rows]
    assert contents[0] == contents[1] != contents[2] == contents[3]
    capsys.readouterr()
    assert run(both[0], "--test", both[0], "--set", "fir.order=0,4", "--out", tmp_path / "alone") == 2
    assert "would be judged on itself" in capsys.readouterr().err


def test_a_recording_that_fails_is_a_row_with_its_reason(bags, tmp_path, capsys):
    broken, short = tmp_path / "broken.mcap", tmp_path / "short"
    broken.write_bytes(b"\x89MCAP0\r\n broken")
    assert main(["simulate", "--out", str(short), "--schedule", "0.1:50:0.1", "--rate", "200"]) == 0
    words = (bags / "sine", broken, short, "--set", "fir.order=0,4", "--workers", 1, "--out", tmp_path / "out")
    assert run(*words) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [one["recordings"] for one in summary["configurations"]] == [1, 1]
    problems = {Path(one["bag"]).name: one["problem"] for one in summary["failed"]}
    assert set(problems) == {"broken.mcap", "short"}
    assert "too short" in problems["short"]
    assert all(one["settings"] is None for one in summary["failed"])
    assert "broken.mcap" in capsys.readouterr().err
    assert run(broken, "--set", "fir.order=0", "--workers", 1, "--out", tmp_path / "none") == 1
    assert "no configuration could be judged on any recording" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "fir.ordr=4"], "unknown parameter fir.ordr; nearest: fir.order"),
        ([], "nothing is varied"),
        (["--set", "fir.order="], "write NAME=VALUE"),
        (["--set", "fir.order=0,4", "--set", "order=8"], "fir.order is set twice"),
        (["--set", "fir.order=0..8"], "give --random N"),
        (["--set", "fir.order=0,4", "--freeze-after", "1"], "give a fraction between 0 and 1"),
        (["--set", "fir.order=0,4", "--workers", "0"], "--workers 0: give 1 to"),
        (["--set", "fir.order=0..8", "--random", "2", "--seed", "-1"], "'-1' is no seed: give 0 or a positive integer"),
        (["--set", "fir.order=0,4", "--joint", "all"], "name one joint"),
        (["--set", "fir.order=0,4", "--workers", "2", "--scheduler", "tcp://h:1"], "give one of them"),
    ],
)
def test_wrong_use_is_one_line_before_anything_is_computed(bags, tmp_path, capsys, words, said):
    assert run(bags / "sine", *words, "--out", tmp_path / "out") == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert os.listdir(tmp_path) == []


def test_the_same_recording_twice_and_one_that_is_not_there_are_refused(bags, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(bags / "sine", copy)
    assert run(bags / "sine", copy, "--set", "fir.order=0,4", "--out", tmp_path / "out") == 2
    assert "copy is the same recording as" in capsys.readouterr().err
    (inside,) = [item for item in copy.iterdir() if item.suffix in (".mcap", ".db3")]
    assert run(copy, inside, "--set", "fir.order=0,4", "--out", tmp_path / "out") == 2
    assert f"{inside.name} is a file of {copy}: each would count twice" in capsys.readouterr().err
    assert run(tmp_path / "nowhere", "--set", "fir.order=0,4", "--out", tmp_path / "out") == 2
    assert "nowhere: no such recording" in capsys.readouterr().err


def test_a_folder_of_somebody_else_is_not_replaced(bags, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("x")
    assert run(bags / "sine", *SETS, "--out", mine) == 2
    assert "does not hold such results" in capsys.readouterr().err
    assert os.listdir(mine) == ["thesis.tex"]


# Going on


def test_a_larger_grid_takes_over_what_is_there(swept, bags, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    words = (bags / "sine", bags / "triangle", "--set", "law=nlms,rls", "--set", "fir.order=0,2,4")
    assert run(*words, "--workers", 1, "--out", out) == 0
    assert "taken over  8 of 12 rows" in capsys.readouterr().out
    assert set((swept / "rows.jsonl").read_text().splitlines()) < set((out / "rows.jsonl").read_text().splitlines())


def test_a_recording_that_was_moved_is_known_and_one_that_changed_is_computed_anew(swept, bags, tmp_path, capsys):
    out, copy = tmp_path / "out", tmp_path / "sine"
    shutil.copytree(swept, out)
    shutil.copytree(bags / "sine", copy)
    assert run(copy, *SETS, "--out", out) == 0
    assert "taken over  4 of 4 rows" in capsys.readouterr().out
    (copy / "note.txt").write_text("a file more")
    assert run(copy, "--set", "law=rls", "--workers", 1, "--out", out) == 0
    assert "taken over" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "words", [["--freeze-after", "0.6"], ["--topic", "velocity=/velocity"], ["--config", "c.yaml"], ["--test", "other"]]
)
def test_whatever_changes_a_row_changes_what_it_is_known_by(bags, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text("/**:\n  ros__parameters:\n    rls.forgetting_factor: 0.99\n")
    (tmp_path / "other").symlink_to(bags / "triangle")
    known = []

    def kept(pieces, *_):
        known.append([identity.digest(piece.facts) for piece in pieces])
        raise UnanswerableError

    monkeypatch.setattr(many, "computed", kept)
    for more in ([], words):
        assert run(bags / "sine", *SETS, *more, "--out", "out") == 1
    assert len(known[0]) == len(known[1]) == 4
    assert not set(known[0]) & set(known[1])


KILLED = """
import os, signal, sys
from friction_estimator.cli import many
from friction_estimator.cli.main import main
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.output.journal import Journal
add, rows = Journal.add, []
def last(self, key, row):
    add(self, key, row)
    rows.append(key)
    if len(rows) == 3:
        os.kill(os.getpid(), signal.SIGKILL)
Journal.add = last
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""


def test_a_sweep_that_is_killed_goes_on_and_repeats_nothing(swept, bags, tmp_path, capsys):
    script, out = tmp_path / "killed.py", tmp_path / "here" / "out"
    script.write_text(KILLED)
    words = [bags / "sine", bags / "triangle", *SETS, "--workers", 1, "--out", out]
    done = subprocess.run([sys.executable, str(script), "sweep", *map(str, words)], check=False, capture_output=True)
    assert done.returncode == -signal.SIGKILL
    assert os.listdir(out.parent) == [".out.friction_estimator"]
    kept = (out.parent / ".out.friction_estimator" / "rows").read_text().splitlines()
    assert len(kept) == 3
    assert run(*words) == 0
    assert "taken over  3 of 8 rows" in capsys.readouterr().out
    same(swept, out)
    assert set(kept) < set((out / "rows.jsonl").read_text().splitlines())
    assert os.listdir(out.parent) == ["out"]


# Workers


def test_a_worker_loads_nothing_that_draws_and_who_asks_no_estimator():
    code = (
        "import sys\nfrom friction_estimator.cli import each, swept\n"
        "print([name for name in ('numba', 'scipy.optimize', 'pyarrow', 'rosbags') if name in sys.modules])\n"
        "from friction_estimator.tasks import local\nfrom friction_estimator.sweep import judged\n"
        "from friction_estimator.fleet import diagnosed\n"
        "heavy = ('matplotlib', 'bokeh', 'rclpy', 'pandas', 'jinja2', 'pyarrow', 'scipy.stats')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n[]\n"


def test_a_recording_is_read_once_for_many_configurations_within_bounds(bags, monkeypatch):
    read = []
    monkeypatch.setattr(recall, "_kept", type(recall._kept)())
    monkeypatch.setattr(recall, "read_recording", lambda *words: read.append(words[0]) or read_recording(*words))
    files = [File(str(bags / name), name, changed_ns(bags / name)) for name in ("sine", "triangle")]
    for order in (0, 4):
        recall.recalled(files[0], Config.from_mapping({"fir.order": order}), {})
    assert len(read) == 1
    recall.recalled(files[0], Config.from_mapping({"input.friction_sign": -1}), {})
    assert len(read) == 2
    size = recall.recalled(files[1], Config(), {}).size
    monkeypatch.setattr(recall, "MOST_BYTES", size)
    recall.recalled(files[0], Config.from_mapping({"sync.slop": 0.001}), {})
    assert sum(item.size for item in recall._kept.values()) <= size


def test_what_was_learned_from_before_is_forgotten(bags, monkeypatch):
    """Jobs come recording by recording: kept, two thousand small ones would fill the memory by and by."""
    monkeypatch.setattr(recall, "_kept", type(recall._kept)())
    first, second, test = (File(str(bags / "sine"), name, changed_ns(bags / "sine")) for name in "abc")
    for learned, kept in ((first, "ac"), (first, "ac"), (second, "bc")):
        judge(Job(learned, (test,), {"model.law": "nlms"}, {}, 0.0))
        assert sorted(key[0] for key in recall._kept) == list(kept)


def test_a_recording_that_changes_meanwhile_is_told(bags):
    path = bags / "sine"
    with pytest.raises(Exception, match="was changed while the run went on"):
        recall.recalled(File(str(path), "another", changed_ns(path) + 1), Config(), {})


def test_the_page_can_be_read_without_bokeh(swept, bags, tmp_path, monkeypatch):
    monkeypatch.setattr("friction_estimator.report.page.write.is_interactive", lambda: False)
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    assert run(bags / "sine", bags / "triangle", *SETS, "--out", out) == 0
    text = pages.words((out / "report.html").read_text())
    assert "model.law=rls fir.order=4" in text
