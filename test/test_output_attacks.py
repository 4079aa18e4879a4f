"""Short samples of test/hard/hard_outputs.py: kills at file operations, a reader beside writers."""

import subprocess
import sys
from pathlib import Path

import pytest
from hard.readers import attack
from hard.system_calls import AVAILABLE

HERE = Path(__file__).parent


@pytest.mark.skipif(not AVAILABLE, reason="ptrace is used as it is on x86-64 Linux")
@pytest.mark.parametrize("case", ["save", "import"])
def test_a_verb_killed_somewhere_leaves_the_former_or_the_new_set(case):
    done = subprocess.run(
        [sys.executable, "-m", "hard.kill_points", case, "--points", "8", "--seed", "1"],
        cwd=HERE, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "killed at 8 of" in done.stdout


def test_a_reader_beside_two_writers_misses_nothing_and_mixes_nothing(tmp_path):
    found = attack(500, tmp_path)
    assert (found.missing, found.mixtures) == (0, 0)
