"""Processes that compute tasks: one thread each, each loss is one task's, and an end with the verb whatever they do."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from marked_tasks import loaded, not_loaded, process_after, twice, was_loaded

from friction_estimator.tasks import local
from friction_estimator.tasks.local import LocalWorkers
from friction_estimator.tasks.task import LOST, Task, TaskError

SCRIPT = """
import os, pathlib, sys, time
from friction_estimator.cli.terminal import guarded
from friction_estimator.tasks.local import LocalWorkers
from friction_estimator.tasks.task import Task

def spin(folder):
    (pathlib.Path(folder) / str(os.getpid())).touch()
    while True:
        sum(range(1000))

def body():
    with LocalWorkers(2) as workers:
        for done in workers.run([Task(k, spin, (sys.argv[1],)) for k in range(4)]):
            pass
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
    """Return a process whose two workers compute without end, and the folder with the workers' ids."""
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
        until(lambda: len(list(marks.iterdir())) == 2)
        yield process, marks
    finally:
        process.kill()
        process.communicate()


def ids(marks):
    return [int(mark.name) for mark in marks.iterdir()]


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
    process, marks = busy
    (os.killpg if group else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, out, err) == (code, "", said)
    until(lambda: not any(map(is_running, ids(marks))))


def test_every_worker_is_deaf_to_what_reaches_the_group(busy):
    """The first one was not: it could print a trace before it was ended."""
    _, marks = busy
    for pid in ids(marks):
        status = Path(f"/proc/{pid}/status").read_text()
        blocked = int(re.search(r"SigBlk:\s*([0-9a-f]+)", status)[1], 16)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            assert blocked >> number - 1 & 1


def test_workers_end_when_the_verb_is_killed(busy):
    process, marks = busy
    process.kill()
    process.communicate(timeout=LIMIT_S)
    until(lambda: not any(map(is_running, ids(marks))))


def test_a_worker_that_is_killed_is_replaced_and_the_other_computes_on(busy):
    process, marks = busy
    killed, other = ids(marks)
    os.kill(killed, signal.SIGKILL)
    until(lambda: len(ids(marks)) == 3)
    assert process.poll() is None
    assert is_running(other)


def test_a_lost_worker_costs_its_task_only_and_a_task_that_loses_two_has_failed(tmp_path):
    with LocalWorkers(2) as workers:
        done = {one.task.key: one for one in workers.run(Task(k, twice, (k, tmp_path)) for k in range(15))}
    assert sorted(done) == list(range(15))
    for key, one in done.items():
        if key not in (5, 6, 13):
            assert (one.result, one.failure) == (2 * key, None)
    assert (done[5].failure.problem, done[5].failure.code) == ("here: five; take six", 2)
    assert done[6].failure.code == 70
    assert "ZeroDivisionError" in done[6].failure.problem
    assert "1 / 0" in done[6].failure.trace
    assert done[13].failure.problem == LOST
    marks = [path.stem for path in tmp_path.iterdir()]
    assert sorted(marks) == sorted([*map(str, range(15)), "7", "13"])  # nothing else was computed twice
    assert {path.read_text().split()[0] for path in tmp_path.iterdir()} == {"1"}


def test_a_process_that_holds_much_memory_is_replaced(tmp_path, monkeypatch):
    def processes(limit):
        folder = tmp_path / str(limit)
        folder.mkdir()
        monkeypatch.setattr(local, "LARGEST_IDLE", limit)
        with LocalWorkers(1) as workers:
            assert [one.result for one in workers.run(Task(k, twice, (k, folder)) for k in range(3))] == [0, 2, 4]
        return len({path.read_text().split()[1] for path in folder.iterdir()})

    assert processes(1) == 3
    assert processes(1 << 40) == 1


def test_processes_share_no_recording_while_there_is_another():
    """They came recording by recording, and each process read every one of them."""
    tasks = [Task((kin, k), process_after, (0.2,), kin) for kin in "ab" for k in range(6)]
    with LocalWorkers(2) as workers:
        looked_at = {(done.task.kin, done.result) for done in workers.run(tasks)}
    assert len(looked_at) <= 3  # at the end one may help the other


def test_a_task_that_was_handed_out_in_vain_is_handed_out_next():
    tasks = [Task(key, process_after, (0.0,), key[0]) for key in ("a1", "b1")]
    waiting = local.Waiting(tasks)
    taken = waiting.take(None)
    waiting.give_back(taken)
    assert [waiting.take(taken), waiting.take(taken)] == tasks
    assert not waiting


def test_a_failure_where_all_are_needed_keeps_its_code_and_its_trace(tmp_path):
    with LocalWorkers(1) as workers:
        (done,) = workers.run([Task(6, twice, (6, tmp_path))])
    error = TaskError(done.failure)
    assert error.exit_code == 70
    assert "1 / 0" in str(error.__cause__)


@pytest.mark.parametrize(("ready", "seen"), [(loaded, "loaded"), (not_loaded, None), (None, None)])
def test_processes_load_what_tasks_need_before_there_is_one(ready, seen):
    with LocalWorkers(2, ready) as workers:
        started = set(multiprocessing.active_children())
        assert len(started) == (2 if ready else 0)
        assert [done.result for done in workers.run(Task(k, was_loaded, ()) for k in range(4))] == [seen] * 4
        if ready:
            assert set(multiprocessing.active_children()) == started
    assert not multiprocessing.active_children()
