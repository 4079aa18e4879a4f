"""The node beside rotary drives: what moves is found as in a recording, and all that is said has the units of it."""

import re

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import DescribeParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import NS, Feeder, await_, force, motion
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from test_ros_node import feed

from friction_estimator.core.intake import pairing
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import PARAMETERS, Config

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"
PREDICTED = f"{NODE}/friction_predicted"
TORQUE = 3
ROTARY_UNITS = {
    "theory.kind": "stribeck",
    "stribeck.coulomb": [0.15, 0.15],
    "basis.velocity_range": [-60.0, 60.0],
    "force_unit": 0.2,
}
LINEAR_WORDS = re.compile(r"m/s\b|N s/m|\bkg\b|\bseal\b|\(N\)|\d N\b(?! m)")
ROTARY_WORDS = re.compile(r"\brad\b|N m\b|torque")


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def turning(count):
    """Return stamps, velocity (rad/s) and friction (N m) of a joint that rests for a moment before it turns."""
    stamps, velocity, friction = motion(count, 1000.0)
    velocity, friction = 400.0 * velocity, 0.02 * friction
    velocity[:50] = friction[:50] = 0.0
    return stamps, velocity, friction


def offline(stamps, velocity, friction, values):
    """Return what replay predicts."""
    config = Config.from_mapping(values)
    events = np.stack([velocity, friction], 1).ravel()
    samples = Intake(config).push(
        np.tile([pairing.VELOCITY, pairing.FRICTION], stamps.size), np.repeat(stamps, 2), events
    )
    return Estimator(config).run(samples)


def statuses(graph, ready):
    """Return the words of /diagnostics, by status, once its values fulfil `ready`."""
    heard = graph.hear(DiagnosticArray, "/diagnostics")

    def found():
        for message in heard[-1:]:
            values = {item.key: item.value for status in message.status for item in status.values}
            if ready(values):
                return [status.message for status in message.status], values
        return None

    return await_(found, "diagnostics")


def described(graph):
    """Return the descriptors of the settings that have the drive's units, as text."""
    names = [item.name for item in PARAMETERS.values() if item.of_drive]
    answer = graph.call(DescribeParameters, f"{NODE}/describe_parameters", names=names)
    return "; ".join(item.additional_constraints for item in answer.descriptors)


def test_a_rotary_drive_needs_no_configuration(graph):
    process = graph.start_node(ROTARY_UNITS, units=False)
    assert "m/s or rad/s" in described(graph)
    feeder = Feeder(graph, rotary=True)
    heard = graph.hear(WrenchStamped, PREDICTED, raw=True)
    feeder.matched()
    graph.heard_by(PREDICTED)
    statuses(graph, lambda v: v.get("motion", "").startswith("not known"))
    stamps, velocity, friction = turning(1500)
    feed(feeder, stamps, velocity, friction)
    await_(lambda: len(heard) == stamps.size, "a prediction for every sample")
    assert [force(raw)[0] for raw in heard] == stamps.tolist()
    np.testing.assert_array_equal(
        [force(raw, TORQUE)[1] for raw in heard], offline(stamps, velocity, friction, ROTARY_UNITS)
    )
    assert not any(force(raw)[1] for raw in heard)
    words, values = statuses(graph, lambda v: v.get("predictions") == str(stamps.size))
    assert values["motion"].startswith("rotary: twist.angular.x")
    assert values["velocity range (rad/s)"] == "[-60.0, 60.0]"
    assert "running error rms (N m)" in values
    told = "\n".join([*words, *(f"{key}: {value}" for key, value in values.items()), described(graph)])
    assert not LINEAR_WORDS.findall(told + process.output())
    assert "unit: rad/s" in told
    assert "unit: N m" in told
    assert process.stop() == 0


def test_a_linear_drive_says_nothing_of_angles(graph):
    process = graph.start_node()
    feeder = Feeder(graph)
    heard = graph.hear(WrenchStamped, PREDICTED, raw=True)
    feeder.matched()
    graph.heard_by(PREDICTED)
    statuses(graph, lambda v: v.get("motion", "").startswith("not known"))
    stamps, velocity, friction = motion(300, 1000.0)
    feed(feeder, stamps, velocity, friction)
    await_(lambda: len(heard) == stamps.size, "a prediction for every sample")
    words, values = statuses(graph, lambda v: v.get("predictions") == str(stamps.size))
    assert values["motion"].startswith("linear: twist.linear.x")
    told = "\n".join([*words, *(f"{key}: {value}" for key, value in values.items()), described(graph)])
    assert not ROTARY_WORDS.findall(told + process.output())


def joint_state(stamp_ns, velocity, effort):
    """Return a message of the joint "lift"."""
    message = JointState(name=["lift"], velocity=[velocity], effort=[effort])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    return message


def test_a_robot_description_decides_for_a_joint(graph):
    """Rotary until the description comes, which has the joint as prismatic; a value set by hand wins over both."""
    process = graph.start_node({"input.mode": "joint_state"})
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    heard = graph.hear(WrenchStamped, PREDICTED)
    graph.heard_by(PREDICTED)
    statuses(graph, lambda v: v.get("motion", "").startswith("rotary"))
    publisher.publish(joint_state(NS, 0.1, 5.0))
    publisher.publish(joint_state(NS + NS // 100, 0.1, 5.0))
    await_(lambda: len(heard) == 2, "predictions")
    assert heard[-1].wrench.torque.x != 0.0
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    description = graph.probe.create_publisher(String, "/robot_description", kept)
    description.publish(String(data='<robot><joint name="lift" type="prismatic"/></robot>'))
    process.says("the drive is linear: robot_description has joint lift so")
    publisher.publish(joint_state(NS + NS // 50, 0.1, 5.0))
    await_(lambda: len(heard) == 3, "another prediction")
    assert (heard[-1].wrench.force.x != 0.0, heard[-1].wrench.torque.x) == (True, 0.0)
    assert "unit: N;" in described(graph)
    assert graph.call_set(NODE, input__motion="rotary").successful
    publisher.publish(joint_state(NS + 3 * NS // 100, 0.1, 5.0))
    await_(lambda: len(heard) == 4, "another prediction")
    assert (heard[-1].wrench.force.x, heard[-1].wrench.torque.x != 0.0) == (0.0, True)
    assert "unit: N m;" in described(graph)


def test_the_wrong_motion_is_told(graph):
    """A drive that was said to be linear, and turns."""
    graph.start_node({"input.motion": "linear"})
    feeder = Feeder(graph, rotary=True)
    feeder.matched()
    sent = iter(range(1, 10**9))

    def send(values):
        k = next(sent)
        feeder.pair(NS + k * NS // 100, 30.0, 0.2)
        return "set input.motion to rotary" in " ".join(values.values())

    statuses(graph, send)
