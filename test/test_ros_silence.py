"""Every way of hearing nothing is explained: topic, expected, seen; once in the log, and in the diagnostics."""

import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
from ros_graph import NS, Feeder, await_
from sensor_msgs.msg import JointState
from test_ros_node import diagnostics

pytestmark = pytest.mark.ros


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def explained(graph, process, *words, feed=lambda: None):
    """Wait until the first finding of the diagnostics holds `words`, and the log too; feed meanwhile."""

    def present(values):
        feed()
        return any(all(word in str(text) for word in words) for text in values.values()) and values["inputs level"] == 1

    diagnostics(graph, present)
    lines = [line for line in process.output().splitlines() if all(word in line for word in words)]
    assert len([line for line in lines if "no longer so" not in line]) == 1, process.output()


def test_no_publisher_wrong_type_and_incompatible_service(graph):
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    graph.publisher(TwistStamped, "/rig/velocity")
    process = graph.start_node({"qos_overrides./velocity.subscription.durability": "transient_local"})
    explained(graph, process, "/velocity", "expected a publisher of geometry_msgs/msg/TwistStamped", "/rig/velocity")
    explained(graph, process, "/friction", "expected a publisher of geometry_msgs/msg/WrenchStamped", "seen none")
    other = ros_graph.Graph(graph.domain, graph.folder)  # one process cannot have two types on a topic
    other.probe.create_publisher(Twist, "/friction", 10)
    explained(graph, process, "/friction", "expected geometry_msgs/msg/WrenchStamped", "seen geometry_msgs/msg/Twist")
    other.close()
    weak = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
    graph.probe.create_publisher(WrenchStamped, "/friction", weak)
    explained(graph, process, "/friction", "RELIABLE", "BEST_EFFORT", "incompatible QoS")
    assert process.stop() == 0


def test_one_input_stamps_that_never_match_zero_stamps_and_frames(graph):
    process = graph.start_node()
    feeder = Feeder(graph)
    feeder.matched()
    tick = iter(range(1, 10**6))

    def only_friction():
        feeder.friction(next(tick) * NS, 1.0)

    explained(graph, process, "/velocity: expected messages from /probe", "only friction arrives", feed=only_friction)

    def apart():
        for _ in range(5):
            k = next(tick)
            feeder.velocity(k * NS, 0.1)
            feeder.friction(k * NS + 3_000_000, 1.0)

    explained(
        graph, process, "/velocity and /friction: expected equal stamps", "+0.003000 s", "sync.slop above", feed=apart
    )
    answer = graph.call_set("/friction_estimator", sync__slop=0.004)
    assert answer.successful
    assert not answer.reason
    values = diagnostics(graph, lambda v: apart() or v["inputs level"] == 0)
    assert abs(float(values["stamp offset of friction from velocity (s)"]) - 0.003) < 1e-6

    def unstamped():
        for _ in range(5):
            feeder.pair(0, 0.1, 1.0)

    explained(graph, process, "expected header stamps, all are zero", feed=unstamped)
    other = Feeder(graph, frame="other")

    def moved():
        for _ in range(5):
            other.pair(next(tick) * NS, 0.1, 1.0)

    explained(graph, process, "expected frame 'shaft'", "seen 'other'", "/friction", feed=moved)
    assert process.stop() == 0


def test_wrong_joint_empty_arrays_and_nan(graph):
    process = graph.start_node({"input.mode": "joint_state", "input.joint": "shaft"})
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    tick = iter(range(1, 10**6))

    def send(names, velocity, effort):
        message = JointState(name=names, velocity=velocity, effort=effort)
        message.header.stamp.sec = next(tick)
        publisher.publish(message)

    explained(
        graph, process, "expected joint 'shaft'", "elbow, wrist", feed=lambda: send(["elbow", "wrist"], [1.0, 2.0], [])
    )
    explained(
        graph, process, "expected velocity and effort", "effort is empty", feed=lambda: send(["shaft"], [1.0], [])
    )
    explained(graph, process, "every one was refused", "nan", feed=lambda: send(["shaft"], [1.0], [float("nan")]))
    values = diagnostics(graph, lambda v: int(v.get("rejected: wrong_joint", 0)) > 0)
    assert int(values["rejected: empty"]) > 0
    assert int(values["rejected: nan"]) > 0
    await_(lambda: graph.call_set("/friction_estimator", input__joint="elbow").successful, "another joint")
    diagnostics(graph, lambda v: send(["elbow", "wrist"], [0.1, 2.0], [3.0, 4.0]) or v["inputs level"] == 0)
    assert process.stop() == 0
