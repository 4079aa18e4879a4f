"""Fixtures that several rooms share."""

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements that do not belong to the project; absent on a user's machine."""
    if not SHARED.is_dir():
        pytest.skip("real measurements (../shared/data) are not at hand: this test needs them")
    return SHARED
