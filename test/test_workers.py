"""Processes that compute for a verb: results in order, one thread each, and an end with the verb whatever they do."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SCRIPT = """
import os, pathlib, sys, time
from friction_estimator.cli.terminal import guarded
from friction_estimator.cli.workers import Task, run_tasks

def spin(folder):
    (pathlib.Path(folder) / str(os.getpid())).touch()
    while True:
        sum(range(1000))

def body():
    run_tasks([Task((k,), spin, (sys.argv[1],)) for k in range(4)], lambda done: None)
    return 0

if __name__ == "__main__":
    sys.exit(guarded("verb", body))
"""
LIMIT_S = 60


def until(condition, limit_s=LIMIT_S):
    limit = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


def is_running(pid):
    """Whether a process is there and has not ended (a zombie has)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def busy(tmp_path):
    """Return a process whose two workers compute without end, and the workers' ids."""
    script, marks = tmp_path / "script.py", tmp_path / "marks"
    script.write_text(SCRIPT)
    marks.mkdir()
    process = subprocess.Popen(
        [sys.executable, str(script), str(marks)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        expected = min(2, os.cpu_count())
        until(lambda: len(list(marks.iterdir())) == expected)
        yield process, [int(mark.name) for mark in marks.iterdir()]
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("number", "group", "code", "said"),
    [
        (signal.SIGINT, True, 130, "verb: interrupted\n"),  # Ctrl-C reaches the whole group
        (signal.SIGINT, False, 130, "verb: interrupted\n"),
        (signal.SIGTERM, False, 143, ""),
        (signal.SIGHUP, False, 129, ""),
        (signal.SIGTERM, True, 143, ""),
        (signal.SIGHUP, True, 129, ""),  # a closed terminal; the tracker of multiprocessing died of it, with a trace
    ],
)
def test_a_signal_ends_the_verb_and_its_workers_while_they_compute(busy, number, group, code, said):
    process, workers = busy
    (os.killpg if group else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, out, err) == (code, "", said)
    until(lambda: not any(map(is_running, workers)))


def test_workers_end_when_the_verb_is_killed(busy):
    process, workers = busy
    process.kill()
    process.communicate(timeout=LIMIT_S)
    until(lambda: not any(map(is_running, workers)))


def test_a_worker_that_is_killed_ends_the_verb_in_one_line(busy):
    process, workers = busy
    os.kill(workers[0], signal.SIGKILL)
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2
    assert err == "verb: a worker process was killed, for want of memory perhaps; run it again\n"
    until(lambda: not any(map(is_running, workers)))
