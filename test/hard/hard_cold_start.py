"""Starts without compiled code: a hundred signals spread over one, a damaged cache, an installation that is read-only.

Run it alone: three seconds are promised on a machine that is not overloaded.
"""

import os
import shutil
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_cold_start import NOBODY, end_while_starting, moments, read_only_installation
from ros_graph import Process

from friction_estimator.compiled import subfolder

pytestmark = pytest.mark.ros

COUNT = 100
LONGEST_END_S = 3.0
LONGEST_START_S = 300.0
NODE = [sys.executable, "-m", "friction_estimator.ros.node"]


def start_and_stop(command, environment, log):
    """Return how long a node took until it listened, s."""
    begin = time.monotonic()
    process = Process(command, environment, log, cwd="/")
    try:
        process.says("listening", LONGEST_START_S)
        took = time.monotonic() - begin
        assert process.stop() == 0
    finally:
        process.popen.kill()
        process.popen.wait()
    assert "Traceback" not in process.output()
    return took


@pytest.fixture
def cold(tmp_path):
    """The environment of a node that has a cache of its own, empty so far."""
    with ros_graph.reserved_domain() as domain:
        given = {"ROS_DOMAIN_ID": str(domain), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        given |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(tmp_path / "log")}
        yield os.environ | given | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": str(ros_graph.ROOT)}


def test_a_hundred_signals_in_a_cold_start(tmp_path, cold):
    whole_s = start_and_stop(NODE, cold, tmp_path / "first")
    endings = [
        (number, end_while_starting(tmp_path, int(cold["ROS_DOMAIN_ID"]), number, after_s))
        for number, after_s in moments(COUNT, 0.1, whole_s, seed=100)
    ]
    faults = [fault for number, ending in endings if (fault := ending.faults(number, LONGEST_END_S))]
    codes = sorted({ending.code for _, ending in endings})
    slowest = max(ending.took_s for _, ending in endings)
    print(f"{COUNT} signals over {whole_s:.0f} s: {len(faults)} faults, codes {codes}, slowest end {slowest:.2f} s")
    assert not faults, "\n".join(faults)


def test_every_file_of_the_cache_cut_short(tmp_path, cold):
    start_and_stop(NODE, cold, tmp_path / "first")
    whole = {path: path.stat().st_size for path in (tmp_path / "cache").rglob("*.nbc")}
    assert whole
    for path, size in whole.items():
        os.truncate(path, size // 2)
    start_and_stop(NODE, cold, tmp_path / "second")
    assert all(path.stat().st_size > size // 2 for path, size in whole.items())


def test_a_read_only_installation_without_a_home(tmp_path):
    """As in containers and under systemd's DynamicUser: another user, no home, a package that cannot be written to."""
    with ros_graph.reserved_domain() as domain, read_only_installation(domain) as made:
        node = [*made.user, *NODE]
        start_and_stop(node, made.environment, tmp_path / "first")
        own = made.temporary / f"friction_estimator-{NOBODY}"
        assert list(own.glob("*/*.nbc"))
        assert not list(made.package.rglob("__pycache__"))
        # What was compiled while the installation was made, an image for instance, is read where it lies.
        for folder in (made.package, *filter(Path.is_dir, made.package.rglob("*"))):
            if (own / subfolder(folder)).is_dir():
                shutil.move(own / subfolder(folder), folder / "__pycache__")
        start_and_stop(node, made.environment, tmp_path / "second")
        assert not list(own.glob("*/*.nbc"))
