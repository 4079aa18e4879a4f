"""`make bench` runs, and its page says what its figures are."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def bench(*words):
    command = [sys.executable, str(ROOT / "benchmarks/bench.py"), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_part_is_measured_and_the_others_stay(tmp_path):
    (tmp_path / "bench.json").write_text(json.dumps({"peers": former()}))
    done = bench("kernels", "--quick", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "bench.json").read_text())
    assert list(figures) == ["kernels", "peers"]
    assert figures["peers"] == former()
    page = (tmp_path / "README.md").read_text()
    assert "| one live sample less the batch's | " in page
    assert "Commit 1a2b3c4, `python benchmarks/bench.py peers`." in page
    assert "| here | 2.00 | 1.00 (1.00 to 1.00) |" in page
    assert "left out: padasip" in page
    assert "Not measured: `reading`" in page


def former():
    rows = {"here": {"law": "lms", "over": "here", "us": [1.0, 3.0]}}
    return {
        "source": "Commit 1a2b3c4, `python benchmarks/bench.py peers`.",
        "machine": "a machine",
        "load_before": 0.1,
        "took_s": 60.0,
        "figures": {"samples": 2, "missing": ["padasip"], "versions": {}, "rows": rows},
    }


def test_small_sizes_are_not_written_over_the_project_s_page():
    done = bench("kernels", "--quick")
    assert done.returncode == 2
    assert "--out" in done.stderr


def test_the_page_is_what_its_figures_say(tmp_path):
    folder = ROOT / "benchmarks"
    (tmp_path / "bench.json").write_bytes((folder / "bench.json").read_bytes())
    assert bench("--render", "--out", tmp_path).returncode == 0
    assert (tmp_path / "README.md").read_text() == (folder / "README.md").read_text()
