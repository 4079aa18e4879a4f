"""Fixtures that several rooms share."""

import os
from pathlib import Path

import pytest

# Before a test brings in numpy: on matrices of a hundred columns the threads of linear algebra spin, and slow all down.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

SHARED = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements that do not belong to the project; absent on a user's machine."""
    if not SHARED.is_dir():
        pytest.skip("real measurements (../shared/data) are not at hand: this test needs them")
    return SHARED
