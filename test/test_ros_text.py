"""Text from the graph and from parameters reaches log, diagnostics and answers as safe, bounded lines."""

import pytest

pytest.importorskip("rclpy")

import ros_graph
from diagnostic_msgs.msg import DiagnosticArray
from ros_graph import NS, await_
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros

FORGED = "shaft\n[FATAL] [1.0] [other_node]: forged\x1b[2J\x07\x9b31m\u202e\x7f"
LONG = "f" * 1_000_000


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def texts_of(array):
    for status in array.status:
        yield from (status.name, status.message, status.hardware_id)
        yield from (text for value in status.values for text in (value.key, value.value))


def joint_state(stamp_ns, frame, names, count):
    message = JointState(name=names, position=[0.0] * count, velocity=[0.1] * count, effort=[1.0] * count)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    message.header.frame_id = frame
    return message


def log_of(process):
    """Return the lines of the log, having looked for what may not be in it."""
    text = process.log.read_bytes().decode("utf-8")
    assert all(character.isprintable() for character in text.replace("\n", "")), ascii(text)
    assert not [line for line in text.splitlines() if line.startswith("[FATAL]")]
    return text


def test_joint_states_with_escapes_and_line_ends(graph):
    """The names come as those of a stranger's joints, and as frames that change."""
    process = graph.start_node({"input.mode": "joint_state", "input.joint": f"my{FORGED}"})
    heard = graph.hear(DiagnosticArray, "/diagnostics")
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    stamps = iter(range(1, 10**6))

    def told(names, frames, words):
        def found():
            for frame in frames:
                publisher.publish(joint_state(next(stamps) * NS // 100, frame, names, len(names)))
            return any(words in text for array in heard for text in texts_of(array)) and words in process.output()

        await_(found, words)

    told([FORGED, f"other{FORGED}"], [""], r"seen: no joint")
    told([f"my{FORGED}"], [f"a{FORGED}", f"b{FORGED}"], r"seen 'bshaft\n[FATAL]")
    for array in heard:
        for text in texts_of(array):
            assert text.isprintable(), ascii(text)
    assert r"my\x" not in log_of(process)
    assert r"shaft\n[FATAL] [1.0] [other_node]: forged\x1b[2J\x07\x9b31m\u202e\x7f" in log_of(process)
    assert process.stop() == 0
    log_of(process)


def test_a_frame_of_a_megabyte_is_a_line_of_bounded_length(graph):
    process = graph.start_node({"input.mode": "joint_state"})
    heard = graph.hear(DiagnosticArray, "/diagnostics")
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    stamps = iter(range(1, 10**6))

    def found():
        for frame in (f"a{LONG}", f"b{LONG}"):
            publisher.publish(joint_state(next(stamps) * NS // 100, frame, ["hip"], 1))
        return any("expected frame" in text for array in heard for text in texts_of(array))

    await_(found, "the finding about frames")
    process.says("expected frame")
    assert len(process.log.read_bytes()) < 20_000
    assert max(len(text) for array in heard for text in texts_of(array)) <= 2000
    assert process.stop() == 0


def test_answers_to_parameters_and_services(graph, tmp_path):
    process = graph.start_node()
    node = "/friction_estimator"
    answers = [
        graph.call_set(node, model__law=FORGED),
        graph.call_set(node, input__axis=FORGED),
        graph.call_set(node, **{FORGED: 1.0}),
        graph.call_set(node, rls__forgetting_factor=FORGED),
    ]
    assert not any(answer.successful for answer in answers)
    reasons = [answer.reason for answer in answers]
    graph.call_set(node, model__law="rls", theory__table=str(tmp_path / FORGED), theory__kind="table")
    answer = graph.call(Trigger, f"{node}/reset")
    for text in (*reasons, answer.message):
        assert text.isprintable(), ascii(text)
        assert len(text) <= 2000
    assert process.stop() == 0
    log_of(process)
