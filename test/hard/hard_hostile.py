"""Files that broke something once, each verb in a process of its own: 2 GB of address space, 10 s of processor time.

Processor time, since a busy machine is no fault of the program. Compiled code must be in the cache: run the suite once.
"""

import os
import resource
import subprocess
import sys

import pytest
from hostile_files import CASES
from ros_graph import ROOT

ADDRESS_SPACE = 2 << 30
PROCESSOR_S = 10
LIMIT_S = 300.0


def bounded():
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S + 1))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.id)
def test_it_ends_as_promised_within_bounds(shared_hostile, tmp_path, case):
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-m", "friction_estimator", *case.words(shared_hostile, out)],
        check=False,
        capture_output=True,
        timeout=LIMIT_S,
        preexec_fn=bounded,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    # Decoding is part of the question: what is shown is text.
    assert case.faults(done.returncode, done.stdout.decode(), done.stderr.decode(), out.exists()) == []
