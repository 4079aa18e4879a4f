"""What a bar says of time is true: compilation stands beside it, and nothing that is no work counts as work."""

import os
import subprocess
import sys

from terminal import Terminal

COMPILES = """
import time
from friction_estimator.cli.progress import _open, compilation_told, progress
from friction_estimator.compiling import COMPILATION

with compilation_told(), progress("working", 100) as advance:
    advance(1)
    begun = time.time()
    from friction_estimator.compiled import njit

    @njit(cache=CACHE)
    def total(x):
        s = x
        for i in range(10):
            s += SEED * x[i] ** 2
        return s.sum() + (x @ x)

    import numpy as np
    begun = time.time()
    bars = list(_open)
    before = [bar.format_dict["elapsed"] for bar in bars]
    for kind in (np.float64, np.float32, np.complex128):
        total(np.ones(20, kind))
    advance(1)
    passed = time.time() - begun
    after = [bar.format_dict["elapsed"] for bar in bars]
for early, late in zip(before, after):
    print("counted", late - early, "passed", passed)
print("compiled", COMPILATION.seconds)
"""


def script(tmp_path, cache=True):
    path = tmp_path / "compiles.py"
    path.write_text(COMPILES.replace("CACHE", str(cache)).replace("SEED", "1.5"))
    return [sys.executable, str(path)]


def figure(screen, name):
    return float(screen.split(f"{name} ")[-1].split()[0])


def test_compilation_is_told_and_its_time_is_not_counted(tmp_path):
    with Terminal(script(tmp_path), dict(os.environ)) as terminal:
        assert terminal.ended() == 0
        screen = terminal.screen()
    assert "compiling once (about" in screen
    assert "kept for later runs" in screen
    compiled = figure(screen, "compiled")
    assert compiled > 0.3
    assert figure(screen, "counted") <= figure(screen, "passed") - 0.95 * compiled
    drawn = screen.replace("\x1b[2K", "").split("\r")
    assert not any("compiling" in line and "working" in line for line in drawn)  # apart from each other
    assert any("compiled" in line and "compiling" not in line for line in drawn)  # erased before the next line


def test_a_second_run_finds_what_was_kept_and_says_nothing(tmp_path):
    for _ in range(2):
        with Terminal(script(tmp_path), dict(os.environ)) as terminal:
            assert terminal.ended() == 0
            screen = terminal.screen()
    assert "compiling" not in screen
    assert figure(screen, "compiled") == 0.0


def test_what_is_not_kept_is_not_said_to_be_compiled_once(tmp_path):
    with Terminal(script(tmp_path, cache=False), dict(os.environ)) as terminal:
        assert terminal.ended() == 0
        assert "compiling:" in terminal.screen()
        assert "compiling once" not in terminal.screen()


def test_a_pipe_gets_neither(tmp_path):
    ended = subprocess.run(script(tmp_path), capture_output=True, text=True, check=True)
    assert ended.stderr == ""
    assert "compiled" in ended.stdout


UNEVEN = """
import time
from friction_estimator.cli.progress import _open, progress

with progress("reading") as advance:
    bar = next(iter(_open))
    time.sleep(0.6)  # opening the file: no part of the rate
    advance(0, total=1000)
    assert bar.format_dict["elapsed"] < 0.5, bar.format_dict
    advance(1, total=1000)
    print(str(bar))
    while "left" not in locals() or "<" not in left:
        advance(1)
        time.sleep(0.01)
        left = str(bar)
    print(left)
with progress("judging", 0) as advance:
    pass
"""


def test_the_time_left_is_told_when_a_rate_was_seen(tmp_path):
    """A first message of 1000 after half a second of opening was said to leave ten minutes."""
    path = tmp_path / "uneven.py"
    path.write_text(UNEVEN)
    with Terminal([sys.executable, str(path)], dict(os.environ)) as terminal:
        assert terminal.ended() == 0, terminal.screen()
        lines = [line.strip() for line in terminal.screen().replace("\r", "\n").splitlines() if line.strip()]
    assert "judging" not in "".join(lines)
    assert any(line.endswith("/1.00k samples") for line in lines)
    timed = [line for line in lines if "<" in line]
    assert timed
    minutes = [int(line.split("<")[1].split(":")[0]) for line in timed if "<?" not in line]
    assert minutes
    assert max(minutes) < 2


def test_reading_has_a_total_before_the_first_message():
    with Terminal([sys.executable, "-m", "friction_estimator", "info", "bags/demo"], dict(os.environ)) as terminal:
        terminal.await_(lambda screen: "| 0.00/13.6k messages" in screen, "the number of messages")
