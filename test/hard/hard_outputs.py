"""Outputs under attack: verbs killed at every file operation and at random moments, readers beside writers, Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hard.kill_points import CASES
from hard.system_calls import AVAILABLE
from test_workers import is_running, until

HERE = Path(__file__).parents[1]
RANDOM_KILLS = 40
READS = 50_000
COMPUTING_S = 6.0  # of processor time: imports take less
FASTEST = "/dev/shm"  # where a flush costs nothing: hundreds of exchanges a second


def module(name, *words, limit):
    """Run a module of this folder in a process of its own; return what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", name, *map(str, words)],
        cwd=HERE,
        capture_output=True,
        text=True,
        timeout=limit,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    print(done.stdout, end="")
    return done.stdout


@pytest.mark.skipif(not AVAILABLE, reason="ptrace is used as it is on x86-64 Linux")
@pytest.mark.parametrize("case", CASES)
def test_a_verb_killed_anywhere_leaves_the_former_or_the_new_set(case):
    module("hard.kill_points", case, "--random", RANDOM_KILLS, limit=7200)


@pytest.mark.skipif(not AVAILABLE, reason="ptrace is used as it is on x86-64 Linux")
def test_without_exchange_the_next_run_restores_what_two_renames_lose():
    """The stated limit, and that the attack sees it: at one point nothing stands under the name until the next run."""
    done = subprocess.run(
        [sys.executable, "-m", "hard.kill_points", "import", "--two-renames"],
        cwd=HERE, capture_output=True, text=True, timeout=3600, check=False,
    )  # fmt: skip
    wrong = done.stdout.splitlines()[1:]
    assert len(wrong) == 1, done.stdout + done.stderr
    assert "run is neither the former nor the new one: missing" in wrong[0]


@pytest.mark.parametrize("folder", [None, FASTEST])
def test_a_reader_beside_two_writers_misses_nothing_and_mixes_nothing(folder):
    module("hard.readers", READS, *(() if folder is None else ("--folder", folder)), limit=3600)


def children(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def computing_s(pid):
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_reproduce_ends_while_its_workers_compute(tmp_path, number, code):
    process = subprocess.Popen(
        [sys.executable, "-m", "friction_estimator", "reproduce", "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        busy = min(2, os.cpu_count())
        until(lambda: sum(computing_s(child) > COMPUTING_S for child in children(process.pid)) >= busy, 1800)
        workers = children(process.pid)
        os.killpg(process.pid, number)
        begin = time.monotonic()
        _, said = process.communicate(timeout=60)
        took = time.monotonic() - begin
    finally:
        process.kill()
    assert process.returncode == code
    assert said == ("friction_estimator reproduce: interrupted\n" if number == signal.SIGINT else "")
    until(lambda: not any(map(is_running, workers)))
    assert os.listdir(tmp_path) == []
    print(f"{signal.Signals(number).name}: ended after {took:.2f} s")
