"""Fixtures that several rooms share."""

import signal
from pathlib import Path

import pytest

from friction_estimator.threads import one_thread

one_thread()  # before a test brings in numpy

# A shell that starts the suite in the background has it ignore SIGINT, and every child inherits that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements that do not belong to the project; absent on a user's machine."""
    if not SHARED.is_dir():
        pytest.skip("real measurements (../shared/data) are not at hand: this test needs them")
    return SHARED
