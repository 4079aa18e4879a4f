"""What is freed is kept for what is wanted next where it is to be."""

import os
import platform
import subprocess
import sys

import pytest

MEASURE = """
import resource, sys
from contextlib import nullcontext
from threading import Thread
import numpy as np
from friction_estimator.core.memory import kept

def faults(block):
    def work():
        with block:
            for _ in range(300):
                np.ones(1 << 17)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    thread = Thread(target=work)  # as in a worker of Dask
    thread.start()
    thread.join()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(faults(nullcontext()), faults(kept()), faults(nullcontext()))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_freed_arrays_are_kept_within_the_block_alone():
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    run = subprocess.run([sys.executable, "-c", MEASURE], env=environment, check=True, capture_output=True, text=True)
    before, within, after = map(int, run.stdout.split())
    assert before > 300 * 200  # 256 pages an array
    assert within < 0.1 * before
    assert after > 0.9 * before
