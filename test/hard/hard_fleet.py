"""Many recordings under attack: workers and client killed at random, 2000 recordings in bounded memory, lost nodes."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dask_cluster import ROOT, cluster
from hard.hard_outputs import children
from test_workers import until

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.write import write_samples
from friction_estimator.cli.main import main
from friction_estimator.core.settings.config import Config

KILLS = 12
RECORDINGS = 2000
GROWTH_MB = 40
"""Resident memory that processes may gain from the 400th recording to the last."""

SETS = ("--set", "law=nlms,rls", "--set", "fir.order=0,2,4,6")
SAME = ("rows.jsonl", "rows.parquet", "table.parquet", "config.yaml")

SCRIPT = """
import json, pathlib, sys
from marked_tasks import twice
from friction_estimator.tasks.cluster import Cluster
from friction_estimator.tasks.task import Task
folder = pathlib.Path(sys.argv[2])
with Cluster(sys.argv[1]) as workers:
    done = {one.task.key: one for one in workers.run(Task(k, twice, (k, folder)) for k in range(15))}
print(json.dumps({key: [one.result, one.failure and one.failure.problem] for key, one in done.items()}))
"""


def command(verb, *words):
    return [sys.executable, "-m", "friction_estimator", verb, *map(str, words)]


def run(verb, *words):
    return subprocess.run(command(verb, *words), capture_output=True, text=True, check=True, cwd=ROOT)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Three recordings of 8 s at 500 Hz."""
    folder = tmp_path_factory.mktemp("bags")
    for seed in range(3):
        words = ["--schedule", "1:50:8", "--rate", 500, "--seed", seed, "--out", folder / str(seed)]
        assert main(["simulate", *map(str, words)]) == 0
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def undisturbed(bags, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    run("sweep", *bags, *SETS, "--workers", 1, "--out", out)
    return out


def is_same(one, other):
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in SAME)


def test_a_sweep_whose_client_and_workers_are_killed_at_random_ends_with_the_same_bits(bags, undisturbed, tmp_path):
    """Every round goes on with what the one before has left; no finished row is computed twice."""
    generator, out = random.Random(0), tmp_path / "out"
    journal, words = tmp_path / ".out.friction_estimator" / "rows", [*bags, *SETS, "--workers", 2, "--out", out]
    known: list[str] = []
    for kill in range(KILLS):
        process = subprocess.Popen(command("sweep", *words), cwd=ROOT, stdout=subprocess.DEVNULL)
        rows = len(known) + generator.randint(0, 2)

        def enough(process=process, rows=rows):
            return process.poll() is not None or (journal.exists() and journal.read_text().count("\n") >= rows)

        until(enough, 600)
        time.sleep(generator.random() * 0.2)  # at any moment of a row, not at its end
        if process.poll() is None:
            if kill % 2:
                for worker in children(process.pid)[-1:]:
                    os.kill(worker, signal.SIGKILL)
                time.sleep(0.5 * generator.random())
            process.send_signal(generator.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
        process.wait()
        if out.exists():
            break
        found = journal.read_text().splitlines() if journal.exists() else []
        whole = [line for line in found if line.endswith("}")]
        assert whole[: len(known)] == known
        keys = [json.loads(line)["key"] for line in whole if line.startswith("{")]
        assert len(keys) == len(set(keys)), "a finished row was computed again"
        known = whole
    run("sweep", *words)
    assert is_same(undisturbed, out)
    assert os.listdir(tmp_path) == ["out"]


def resident_mb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.parametrize("verb", ["sweep", "diagnose"])
def test_2000_recordings_in_memory_that_does_not_grow(tmp_path, verb):
    made = tmp_path / "made"
    assert main(["simulate", "--out", str(made), "--schedule", "1:50:13", "--rate", "50"]) == 0
    samples = to_samples(read_recording(made), Config()).samples
    generator = np.random.default_rng(0)
    (tmp_path / "rig").mkdir()
    for k in range(RECORDINGS):
        noise = 0.02 * generator.normal(size=len(samples))
        write_samples(tmp_path / "rig" / f"{k:04d}.mcap", replace(samples, friction_N=samples.friction_N + noise))
    shutil.rmtree(made)
    options = ["--set", "law=nlms"] if verb == "sweep" else ["--each"]
    words = [*sorted((tmp_path / "rig").iterdir()), *options, "--workers", 2, "--out", tmp_path / "out"]
    journal = tmp_path / ".out.friction_estimator" / "rows"
    process = subprocess.Popen(command(verb, *words), cwd=ROOT, stdout=subprocess.DEVNULL)
    early, late = {}, {}
    try:
        while process.poll() is None:
            rows = journal.read_bytes().count(b"\n") if journal.exists() else 0
            for pid in (process.pid, *children(process.pid)):
                try:
                    memory = resident_mb(pid)
                except (OSError, IndexError):
                    continue
                if 200 <= rows < 400:
                    early[pid] = max(memory, early.get(pid, 0.0))
                elif 1600 <= rows < RECORDINGS:
                    late[pid] = max(memory, late.get(pid, 0.0))
            time.sleep(0.2)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == (0 if verb == "sweep" else 1)  # 13 s at 50 Hz: no diagnosis is decided
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    failed = summary["failed"] if verb == "sweep" else [one for one in summary["recordings"] if one["problem"]]
    assert len(summary["recordings"]) == RECORDINGS
    assert not failed
    print({"client": (early[process.pid], late[process.pid]), "all": (early, late)})
    assert late[process.pid] - early[process.pid] < GROWTH_MB
    assert max(late.values()) - max(early.values()) < GROWTH_MB


@pytest.fixture
def dask(tmp_path):
    (tmp_path / "dask").mkdir()
    with cluster(tmp_path / "dask") as (address, workers):
        yield address, workers


def test_a_task_that_ends_its_workers_costs_no_other(dask, tmp_path):
    (tmp_path / "marks").mkdir()
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'test'}"}
    command = [sys.executable, "-c", SCRIPT, dask[0], str(tmp_path / "marks")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    found = {int(key): value for key, value in json.loads(done.stdout.splitlines()[-1]).items()}
    assert sorted(found) == list(range(15))
    assert found[5] == [None, "here: five; take six"]
    assert "ended twice" in found[13][1]
    assert all(found[key] == [2 * key, None] for key in found if key not in (5, 6, 13))


def test_a_sweep_on_a_cluster_that_loses_a_worker_ends_with_the_same_bits(dask, bags, undisturbed, tmp_path):
    address, nannies = dask
    out = tmp_path / "out"
    journal = tmp_path / ".out.friction_estimator" / "rows"
    words = [*bags, *SETS, "--scheduler", address, "--out", out]
    process = subprocess.Popen(command("sweep", *words), cwd=ROOT, stdout=subprocess.DEVNULL)
    until(lambda: journal.exists() and journal.read_text().count("\n") >= 2, 600)
    workers = [pid for pid in children(nannies.pid) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[0], signal.SIGKILL)
    assert process.wait(600) == 0
    assert is_same(undisturbed, out)


def test_a_client_of_a_cluster_that_is_killed_goes_on(dask, bags, undisturbed, tmp_path):
    out = tmp_path / "out"
    journal = tmp_path / ".out.friction_estimator" / "rows"
    words = [*bags, *SETS, "--scheduler", dask[0], "--out", out]
    process = subprocess.Popen(command("sweep", *words), cwd=ROOT, stdout=subprocess.DEVNULL)
    until(lambda: journal.exists() and journal.read_text().count("\n") >= 2, 600)
    process.kill()
    process.wait()
    kept = journal.read_text().count("\n")
    assert f"taken over  {kept} of 24 rows" in run("sweep", *words).stdout
    assert is_same(undisturbed, out)
