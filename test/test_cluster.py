"""`--scheduler`: the same results to the bit on a Dask cluster, and one line of trouble."""

import os
import socket
import subprocess
import sys

import pytest
from dask_cluster import ROOT, cluster
from test_cli_sweep import SETS, bags, same, swept  # noqa: F401 - fixtures

pytestmark = pytest.mark.xdist_group("cluster")


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("dask")) as (address, workers):
        yield address, workers


def run(*words):
    command = [sys.executable, "-m", "friction_estimator", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def test_a_cluster_says_the_same_to_the_bit(dask, swept, bags, tmp_path):  # noqa: F811
    words = (bags / "sine", bags / "triangle", *SETS, "--out", tmp_path / "out")
    done = run("sweep", *words, "--scheduler", dask[0])
    assert (done.returncode, done.stderr) == (0, "")
    same(swept, tmp_path / "out")


def test_a_port_without_a_scheduler_is_one_line(tmp_path, bags):  # noqa: F811
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        done = run("sweep", bags / "sine", *SETS, "--out", tmp_path / "out", "--scheduler", address)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"--scheduler {address}: no Dask scheduler answers there" in done.stderr
    assert os.listdir(tmp_path) == []


def test_without_dask_the_extra_is_named(tmp_path, bags):  # noqa: F811
    (tmp_path / "distributed.py").write_text("raise ModuleNotFoundError('none', name='distributed')")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    words = ["sweep", bags / "sine", *SETS, "--out", tmp_path / "out", "--scheduler", "tcp://h:1"]
    command = [sys.executable, "-m", "friction_estimator", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=ROOT)
    assert done.returncode == 2
    assert "pip install 'friction_estimator[cluster]'" in done.stderr
    assert done.stderr.count("\n") == 1
