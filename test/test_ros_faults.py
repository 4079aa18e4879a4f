"""Whatever a hostile publisher sends: finite predictions, the former accuracy within 2 s, every reject counted."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import WrenchStamped
from ros_faults import FAULTS, Hostile
from ros_graph import Feeder, await_, force
from test_ros_node import diagnostics

pytestmark = pytest.mark.ros


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


@pytest.mark.parametrize("units", [True, False])
def test_the_node_recovers_from_every_fault(graph, units):
    """Whether range and units are configured, or chosen at the first contact: then the range grows with what comes."""
    process = graph.start_node(units=units)
    heard = graph.hear(WrenchStamped, "/friction_estimator/friction_predicted", raw=True)
    feeder = Feeder(graph)
    feeder.matched()
    graph.reached_by()
    hostile = Hostile(feeder, heard)
    before = hostile.normal(10.0)
    wanted = {}
    for name, (commit, counter) in FAULTS.items():
        growth = commit(hostile)
        after = hostile.normal(2.0)
        assert after < 1.3 * before + 0.01, f"{name}: error {after:.4f} N after, {before:.4f} N before"
        if counter == "outside velocity range" and not units:
            wanted["velocity range grown (times)"] = 1
        elif counter:
            wanted[counter] = wanted.get(counter, 0) + growth
    assert np.isfinite([force(raw)[1] for raw in heard]).all()

    def counted(values):
        return all(int(values.get(counter, 0)) >= least for counter, least in wanted.items())

    found = {}
    await_(
        lambda: counted(diagnostics(graph, lambda v: found.update(v) or True)),
        f"counters {wanted} in the diagnostics; found {found}",
        10.0,
    )
    assert process.popen.poll() is None
    assert found["exceptions"] == "0"
    assert "Traceback" not in process.output()
