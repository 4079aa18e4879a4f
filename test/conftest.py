"""Fixtures that several rooms share."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from friction_estimator.threads import one_thread

one_thread()  # before a test brings in numpy

# A shell that starts the suite in the background has it ignore SIGINT, and every child inherits that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # nohup does the same with SIGHUP
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

SHARED = Path(__file__).parents[1].parent / "shared" / "data"
HOSTILE = SHARED.with_name("hostile")

KEPT_OUTSIDE = {"shared_data": SHARED, "shared_hostile": HOSTILE}
"""Fixture -> folder beside the project."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements that do not belong to the project; absent on a user's machine.

    The only way to them: a test that asks for this is marked `shared`, and skipped where they are absent.
    """
    return SHARED


@pytest.fixture(scope="session")
def shared_hostile() -> Path:
    """Files that broke something once, which do not belong to the project either; used as `shared_data` is."""
    return HOSTILE


@pytest.fixture
def blank_drawings() -> Iterator[None]:
    """What a test writes has empty figures and charts."""
    from blank_drawings import blank_drawings as drawn_blank  # what draws is loaded for these tests alone

    with drawn_blank():
        yield


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what needs the measured data, and skip it where there are none; let one worker have all of ROS.

    Two ROS tests at once would not meet, since each has a domain of its own (`ros_graph.reserved_domain`), but their
    processes would be five or six on two cores.
    """
    for item in items:
        for fixture, folder in KEPT_OUTSIDE.items():
            if fixture not in getattr(item, "fixturenames", ()):
                continue
            item.add_marker("shared")
            if not folder.is_dir():
                item.add_marker(pytest.mark.skip(reason=f"kept outside the project, and not here: {folder}"))
        if item.get_closest_marker("ros"):
            item.add_marker(pytest.mark.xdist_group("ros"))
