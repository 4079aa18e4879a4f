"""`make demo`, whole: two processes over DDS, every sample predicted, results written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIMIT_S = 180


@pytest.mark.ros
def test_the_demonstration_predicts_every_sample_of_a_recording(tmp_path):
    out = tmp_path / "demo_out"
    ended = subprocess.run(
        [sys.executable, "-m", "friction_estimator.cli.demo", "--out", str(out), "--rate", "4"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert summary["predictions"] == summary["samples"]["used"] == 4400
    assert summary["live_equals_replay"]
    assert summary["nrmse_final"] < 0.10
    assert summary["duration_s"] > 20.0
    assert {p.name for p in out.iterdir()} >= {"bag", "figures", "report.html", "summary.json"}
