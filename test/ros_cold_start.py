"""Nodes that start without any compiled code: stopped on the way, or without a place to write to."""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from ros_graph import ROOT, Process

NOBODY = 65534


@dataclass
class Ending:
    """How one start was ended: when the signal came (s after the start), how long the end took, code and output."""

    sent_at_s: float
    took_s: float
    code: int
    output: str

    def faults(self, number: int, longest_s: float) -> str:
        """Return what is wrong with it, empty where nothing is."""
        wrong = []
        if self.code not in (0, -number):
            wrong.append(f"code {self.code}")
        if self.took_s > longest_s:
            wrong.append(f"took {self.took_s:.1f} s")
        if "Traceback" in self.output or "Error" in self.output or "Exception" in self.output:
            wrong.append("traceback")
        return f"signal {number} after {self.sent_at_s:.2f} s: {', '.join(wrong)}\n{self.output}" if wrong else ""


def end_while_starting(folder: Path, domain: int, number: int, after_s: float) -> Ending:
    """Start a node with an empty cache, send it a signal after this time."""
    cache = folder / "cache"
    shutil.rmtree(cache, ignore_errors=True)
    given = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(folder / "log"), "NUMBA_CACHE_DIR": str(cache)}
    environment = os.environ | given | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}
    begin = time.monotonic()
    process = Process([sys.executable, "-m", "friction_estimator.ros.node"], environment, folder / "output")
    while time.monotonic() - begin < after_s:
        time.sleep(min(0.01, after_s))
    process.popen.send_signal(number)
    sent = time.monotonic()
    try:
        code = process.popen.wait(60.0)
    except subprocess.TimeoutExpired:
        process.popen.kill()
        code = process.popen.wait()
    return Ending(sent - begin, time.monotonic() - sent, code, process.output())


def moments(count: int, first_s: float, last_s: float, seed: int) -> Iterator[tuple[int, float]]:
    """Yield signals and moments, one at random in each of `count` equal parts of the time."""
    rng = random.Random(seed)
    part = (last_s - first_s) / count
    for k in range(count):
        yield rng.choice((signal.SIGINT, signal.SIGTERM)), first_s + part * (k + rng.random())


@dataclass
class Installation:
    """A copy of the package where nobody may write, without compiled code, and another user who runs it.

    Attributes
    ----------
    package : folder of the package.
    temporary : where everybody may write, as /tmp.
    environment : of the user, who has no home.
    user : words before a command that let the other user run it.
    """

    package: Path
    temporary: Path
    environment: dict[str, str]
    user: list[str]


@contextmanager
def read_only_installation(domain: int) -> Iterator[Installation]:
    """Make one; skips, aloud, where this process cannot become another user.

    The interpreter itself may lie where others cannot look, such as root's home: the user may read everything, which
    changes nothing of where he may write.
    """
    words = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    words += ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search", "--"]
    if os.getuid() != 0 or shutil.which("setpriv") is None or subprocess.run([*words, "true"], check=False).returncode:
        pytest.skip("this process cannot become another user: a start as nobody is not tried")
    root = Path(tempfile.mkdtemp(prefix="read-only-"))
    temporary, installed = root / "tmp", root / "installed"
    package = installed / "friction_estimator"
    shutil.copytree(ROOT / "friction_estimator", package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in (root, installed, *installed.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    temporary.mkdir()
    temporary.chmod(0o1777)
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(installed),
        "PYTHONUNBUFFERED": "1",
        "TMPDIR": str(temporary),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(temporary / "log"),
    }
    try:
        yield Installation(package, temporary, environment, words)
    finally:
        shutil.rmtree(root)
