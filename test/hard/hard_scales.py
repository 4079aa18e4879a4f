"""The node without configuration at three scales, over DDS: as good as a configured one, bit-equal to replay."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import WrenchStamped
from ros_graph import Feeder, await_, force
from test_ros_node import feed
from test_theory_choice import PERIOD_S, RATE, SCALES, drive

from friction_estimator.core.metrics import nrmse
from friction_estimator.core.online.replay import replay
from friction_estimator.core.settings.config import Config

pytestmark = pytest.mark.ros
FED_HZ = 1000.0


def predicted_live(graph, samples, values, name):
    """Return what a node of this name and these parameters predicts of samples, (n,)."""
    graph.start_node(values, units=False, namespace=f"/{name}")
    rotary = values.get("input.motion") == "rotary"
    feeder = Feeder(graph, f"/{name}", rotary=rotary)
    heard = graph.hear(WrenchStamped, f"/{name}/friction_estimator/friction_predicted", raw=True)
    feeder.matched()
    graph.reached_by(f"/{name}/friction_estimator")
    feed(feeder, samples.stamp_ns, samples.velocity_m_s, samples.friction_N, FED_HZ)
    await_(lambda: len(heard) >= len(samples), f"{len(samples)} predictions")
    found = [force(raw, 3 if rotary else 0) for raw in heard]
    assert [stamp for stamp, _ in found] == samples.stamp_ns.tolist()
    return np.array([value for _, value in found])


@pytest.mark.parametrize("scale", SCALES)
def test_a_node_without_configuration(tmp_path, scale):
    speed, size, motion = SCALES[scale]
    samples = drive(speed, size, seed=7)
    free = {"input.motion": motion}
    told = free | {"basis.velocity_range": [-1.3 * speed, 1.3 * speed], "force_unit": size, "theory.kind": "stribeck"}
    with ros_graph.graph(tmp_path) as graph:
        ours, theirs = (
            predicted_live(graph, samples, values, name) for values, name in ((free, "free"), (told, "told"))
        )
    np.testing.assert_array_equal(ours, replay(samples, Config.from_mapping(free)).predicted_N)
    late = slice(round(2 * PERIOD_S * RATE), None)
    errors = [nrmse(samples.friction_N[late], found[late]) for found in (ours, theirs)]
    print(f"{scale}: nrmse after two cycles {errors[0]:.5f}, of the configured node {errors[1]:.5f}")
    assert errors[0] <= 1.1 * errors[1]
