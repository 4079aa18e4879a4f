"""`make demo`, whole: two processes over DDS, every sample predicted, results written, the curve that of the plant."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.rig.plant import PLANTS
from friction_estimator.threads import VARIABLES

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
    assert summary["nrmse_final"] < 0.05
    assert summary["duration_s"] > 20.0
    assert {p.name for p in out.iterdir()} >= {"bag", "figures", "report.html", "summary.json"}

    curve = {name: np.array(summary["curve"][name]) for name in ("velocity_m_s", "friction_N", "low_N", "high_N")}
    own = steady_state(curve["velocity_m_s"], summary["curve"]["pressure_Pa"], summary["curve"]["temperature_degC"])
    error = curve["friction_N"] - own
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.std(own)
    assert np.mean((curve["low_N"] <= own) & (own <= curve["high_N"])) > 0.95


def steady_state(velocity, pressure_Pa, temperature_degC):
    """Return the friction of the rig's own plant at constant velocity, N."""
    plant = PLANTS["rig"](SealConfig(), 1000.0)
    return plant.curve.evaluate(velocity, *(np.full(velocity.size, value) for value in (pressure_Pa, temperature_degC)))


def test_every_program_of_the_command_line_has_one_thread_for_linear_algebra():
    """More move last bits: the demonstration would differ from the node, whose environment says one."""
    code = "import friction_estimator.cli.demo, os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "1"
