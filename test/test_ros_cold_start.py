"""Where nothing is compiled yet: signals are obeyed at once, and no place to write to is needed."""

import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_cold_start import NOBODY, end_while_starting, moments, read_only_installation
from ros_graph import ROOT

pytestmark = pytest.mark.ros

LONGEST_END_S = 20.0
"""Far above the promised 3 s, which test/hard asks for: this machine may be busy."""


def test_a_signal_ends_a_cold_start(tmp_path):
    """At three moments of the first 9 s, in which modules are imported and the first loops compiled."""
    with ros_graph.reserved_domain() as domain:
        for number, after_s in moments(3, 0.5, 9.0, seed=4):
            ending = end_while_starting(tmp_path, domain, number, after_s)
            assert not ending.faults(number, LONGEST_END_S)
    assert not list(tmp_path.glob("cache/**/*.part"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_start_that_is_cut_short_leaves_no_scratch(tmp_path, number):
    code = (
        "import os, signal, sys\n"
        "from friction_estimator.ros.stop_signals import StopSignals\n"
        "signals = StopSignals()\n"
        "signals.scratch = sys.argv[1]\n"
        "os.mkdir(signals.scratch)\n"
        f"os.kill(os.getpid(), {number:d})\n"
        "signal.pause()\n"
    )
    scratch = tmp_path / "scratch"
    ended = subprocess.run([sys.executable, "-c", code, scratch], timeout=ros_graph.LIMIT_S, check=False)
    assert ended.returncode == 0
    assert not scratch.exists()


def test_the_command_line_runs_from_a_read_only_installation_without_a_home():
    """As another user, in a package that cannot be written to; the node does in test/hard."""
    with ros_graph.reserved_domain() as domain, read_only_installation(domain) as made:
        command = [*made.user, sys.executable, "-m", "friction_estimator", "info", ROOT / "bags" / "demo"]
        ended = subprocess.run(command, env=made.environment, cwd="/", capture_output=True, text=True, check=False)
        assert (ended.returncode, ended.stderr) == (0, "")
        own = made.temporary / f"friction_estimator-{NOBODY}"
        assert list(own.glob("*/*.nbc"))
        assert own.stat().st_uid == NOBODY
        assert not list(made.package.rglob("__pycache__"))
