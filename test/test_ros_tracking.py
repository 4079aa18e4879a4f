"""The node beside a drive that measures its position only: the predictions are those of replay, bit for bit."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import WrenchStamped
from joint_bags import joint_state
from ros_graph import Feeder, await_, force, motion
from sensor_msgs.msg import JointState
from test_ros_node import PREDICTED, diagnostics

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION
from friction_estimator.core.intake.tracking import WARM_UP
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.settings.config import Config

pytestmark = pytest.mark.ros
COUNT = 1e-5


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def drive(count, rate_hz=500.0):
    """Return stamps, the positions that an encoder shows, and friction."""
    stamps, velocity, friction = motion(count, rate_hz)
    return stamps, COUNT * np.floor(np.cumsum(velocity) / rate_hz / COUNT), friction


def paced(*arrays, rate_hz=1000.0):
    """Yield rows no faster than they are taken."""
    start = time.perf_counter()
    for k, row in enumerate(zip(*(array.tolist() for array in arrays), strict=True)):
        while (wait := start + k / rate_hz - time.perf_counter()) > 0:
            time.sleep(wait)
        yield row


def replayed(stamps, shown, friction, mode):
    config = Config.from_mapping({"input.mode": mode})
    events = np.stack([shown, friction], 1).ravel()
    samples = Intake(config).push(np.tile([POSITION, FRICTION], stamps.size), np.repeat(stamps, 2), events)
    estimator = Estimator(meet(config, samples).config)
    return samples.stamp_ns.tolist(), estimator.run(samples, True).tolist()


def test_a_joint_state_without_velocity(graph):
    graph.start_node({"input.mode": "joint_state", "input.motion": "linear"}, units=False)
    publisher = graph.publisher(JointState, "/joint_states")
    heard = graph.hear(WrenchStamped, PREDICTED, raw=True)
    graph.matched("/joint_states")
    graph.heard_by(PREDICTED)
    stamps, shown, friction = drive(3000)
    for stamp, x, f in paced(stamps, shown, friction):
        publisher.publish(joint_state(stamp, ["hip"], [x], [], [f]))
    expected = replayed(stamps, shown, friction, "joint_state")
    await_(lambda: len(heard) >= stamps.size - WARM_UP + 1, "all predictions")
    assert [force(raw) for raw in heard] == list(zip(*expected, strict=True))
    values = diagnostics(graph, lambda v: "velocity" in v)
    assert "from the position: tracking filter, counts of 1e-05" in values["velocity"]


def test_a_position_topic_in_place_of_a_velocity_topic(graph):
    graph.start_node(units=False)
    feeder = Feeder(graph)
    positions = graph.publisher(JointState, "/position")
    heard = graph.hear(WrenchStamped, PREDICTED, raw=True)
    feeder.matched()
    graph.matched("/position")
    graph.heard_by(PREDICTED)
    stamps, shown, friction = drive(3000)
    for stamp, x, f in paced(stamps, shown, friction):
        positions.publish(joint_state(stamp, ["shaft"], [x], [], []))
        feeder.friction(stamp, f)
    # Two topics arrive in any order among each other; what is joined by stamp is the same.
    expected = dict(zip(*replayed(stamps, shown, friction, "stamped"), strict=True))
    await_(lambda: len(heard) >= len(expected), "all predictions")
    assert dict(force(raw) for raw in heard) == expected
    values = diagnostics(graph, lambda v: "velocity" in v)
    assert not any("velocity" in text for key, text in values.items() if key.startswith("finding"))
