"""Several joints of one JointState in one node, and several nodes in one process."""

import time
from array import array

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

import ros_graph
from diagnostic_msgs.msg import DiagnosticArray
from documented import blocks
from geometry_msgs.msg import WrenchStamped
from joint_bags import joint_state, write_joint_bag
from rcl_interfaces.srv import ListParameters
from ros_graph import await_, force, motion
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.core.online.replay import replay
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import config_of, read_parameters

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"
JOINTS = ("arm/elbow", "wrist ä", "stuck", "blind", "absent")
PLAIN = ("arm_elbow", "wrist__", "stuck", "blind", "absent")
LINEAR = {"input.mode": "joint_state", "input.motion": "linear"}  # `force` reads wrench.force
SEVERAL = {**LINEAR, "input.joints": list(JOINTS)}


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def arm(count, rate_hz=500.0):
    """Return stamps and messages of four joints: two sound and unlike, one that stands still, one without an effort."""
    stamps, velocity, effort = motion(count, rate_hz)
    _, other, torque = motion(count, rate_hz, seed=1)
    names = ("other", "wrist ä", "arm/elbow", "stuck", "blind")
    rows = zip(velocity.tolist(), effort.tolist(), (0.3 * other).tolist(), (2.0 * torque).tolist(), strict=True)
    bad = (float("nan"), 1e300, float("inf"))
    return stamps.tolist(), [
        (names, [], [0.0, w, v, 0.0, v], [0.0, t, f, 1.0, bad[k % 3]]) for k, (v, f, w, t) in enumerate(rows)
    ]


def offline(folder, stamps, messages, joint, **values):
    """Return the stamps and predictions of `replay --joint` on a recording of the same messages."""
    bag = write_joint_bag(folder / "run", {"/joint_states": messages}, stamps=stamps)
    config = Config.from_mapping({**LINEAR, "input.joint": joint} | values)
    samples = to_samples(read_recording(bag, config.input), config).samples
    made = replay(samples, config)
    return made.samples.stamp_ns.tolist(), made.predicted_N


def status_of(graph, name, wanted):
    """Wait for a diagnostics status of this name whose values satisfy `wanted`; return values, level and message."""
    found = []

    def look(message):
        for status in message.status:
            if status.name == f"{NODE}: {name}":
                values = {pair.key: pair.value for pair in status.values}
                values |= {"level": int.from_bytes(status.level), "message": status.message}
                if wanted(values):
                    found.append(values)

    subscription = graph.probe.create_subscription(DiagnosticArray, "/diagnostics", look, 10)
    try:
        return await_(lambda: found, f"the status of {name}")[0]
    finally:
        graph.probe.destroy_subscription(subscription)


def publish(graph, stamps, messages):
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    for stamp, message in zip(stamps, messages, strict=True):
        publisher.publish(joint_state(stamp, *message))


def test_each_joint_is_what_replay_makes_of_it_alone(graph, tmp_path):
    process = graph.start_node(SEVERAL, units=False)
    stamps, messages = arm(3000)
    heard = {plain: graph.hear(WrenchStamped, f"{NODE}/{plain}/friction_predicted", raw=True) for plain in PLAIN}
    for plain in PLAIN:
        graph.heard_by(f"{NODE}/{plain}/friction_predicted")
    publish(graph, stamps, messages)
    for joint, plain in zip(JOINTS[:2], PLAIN, strict=False):
        expected_stamps, expected = offline(tmp_path / plain, stamps, messages, joint)
        await_(lambda p=plain, e=expected: len(heard[p]) >= e.size, f"all predictions of {joint}")
        found = [force(raw) for raw in heard[plain]]
        assert [stamp for stamp, _ in found] == expected_stamps
        np.testing.assert_array_equal([value for _, value in found], expected)
    assert not any(heard[plain] for plain in PLAIN[2:])
    blind = status_of(graph, "blind", lambda v: v.get("rejected: nan"))
    assert (blind["rejected: nan"], blind["rejected: infinite"]) == ("1000", "2000")
    missing = status_of(graph, "absent", lambda v: v.get("rejected: wrong_joint") == "3000")
    assert missing["predictions"] == "0"
    sound = status_of(graph, "arm/elbow", lambda v: v.get("predictions") == "3000")
    assert not any(key.startswith("rejected") for key in sound)
    assert "no joint 'absent'" in process.output()
    assert process.stop() == 0


def call(graph, kind, name, **fields):
    answer = graph.call(kind, f"{NODE}/{name}", **fields)
    return answer.success, answer.message


def test_what_each_joint_learns_is_its_own(graph, tmp_path):
    """Services, parameters and state files by joint; what is done to one leaves the other to the bit."""
    two = {**LINEAR, "input.joints": list(JOINTS[:2]), "state.file": str(tmp_path / "state.json")}
    process = graph.start_node(two, units=False)
    stamps, messages = arm(3000)
    elbow, wrist = (graph.hear(WrenchStamped, f"{NODE}/{plain}/friction_predicted", raw=True) for plain in PLAIN[:2])
    for plain in PLAIN[:2]:
        graph.heard_by(f"{NODE}/{plain}/friction_predicted")
    publish(graph, stamps[:1500], messages[:1500])
    await_(lambda: len(elbow) == len(wrist) == 1500, "the first half")
    assert call(graph, SetBool, "arm_elbow/adapt", data=False)[0]
    frozen = graph.call_get(NODE, "arm_elbow.learned.wavelet_weights")
    publish(graph, stamps[1500:2000], messages[1500:2000])
    await_(lambda: len(elbow) == len(wrist) == 2000, "what is predicted without learning")
    assert call(graph, SetBool, "arm_elbow/enable", data=False) == (True, "disabled: its samples are passed over")
    publish(graph, stamps[2000:], messages[2000:])
    expected_stamps, expected = offline(tmp_path / "wrist", stamps, messages, JOINTS[1])
    await_(lambda: len(wrist) == 3000, "all of the other joint")
    assert [force(raw) for raw in wrist] == list(zip(expected_stamps, expected, strict=True))
    assert len(elbow) == 2000
    # Parameters: what is shared once, what is learned by joint; nothing is in between.
    assert graph.call_get(NODE, "arm_elbow.learned.wavelet_weights") == frozen
    assert graph.call_get(NODE, "wrist__.learned.force_unit") > 0.0
    assert graph.call_get(NODE, "fir.order") == 8
    for name, says in (
        ("learned__force_unit", "name it JOINT.learned.force_unit"),
        ("arm_elbow__fir__order", "at the start only"),
    ):
        answer = graph.call_set(NODE, **{name: 4})
        assert (answer.successful, says in answer.reason) == (False, True), answer.reason
    # State files: one a joint.
    success, message = call(graph, Trigger, "save")
    assert (success, message.count("saved ")) == (True, 2)
    assert call(graph, Trigger, "wrist__/reset") == (True, "started cold with the present parameters; first contact")
    success, message = call(graph, Trigger, "save")
    assert not success
    assert "wrist__: first contact: nothing is learned yet" in message
    assert process.stop() == 0
    assert sorted(path.name for path in tmp_path.glob("state.json*")) == ["state.json.arm_elbow", "state.json.wrist__"]
    again = graph.start_node(two, units=False)
    assert again.output().count("samples learned from") == 2
    assert graph.call_get(NODE, "arm_elbow.learned.wavelet_weights") == frozen
    assert again.stop() == 0


def test_a_dump_of_several_joints_starts_the_next_node_warm(graph, tmp_path):
    own = {"arm_elbow.fir.order": 4, "wrist__.rls.forgetting_factor": 1, "gripper.fir.order": 4}
    first = graph.start_node({**SEVERAL, **own}, units=False)
    assert "unknown parameter gripper.fir.order" in first.output()
    stamps, messages = arm(2000)
    heard = graph.hear(WrenchStamped, f"{NODE}/arm_elbow/friction_predicted", raw=True)
    graph.heard_by(f"{NODE}/arm_elbow/friction_predicted")
    publish(graph, stamps, messages)
    await_(lambda: len(heard) == 2000, "all predictions")
    names = graph.call(ListParameters, f"{NODE}/list_parameters").result.names
    assert {"arm_elbow.fir.order", "stuck.learned.fir_taps", "wrist__.learned.wavelet_weights"} <= set(names)
    assert not {"learned.fir_taps", "gripper.fir.order"} & set(names)
    dump = {name: graph.call_get(NODE, name) for name in names if not name.startswith("qos_overrides")}
    dump = {name: list(value) if isinstance(value, array) else value for name, value in dump.items()}
    assert len(dump["arm_elbow.learned.fir_taps"]) == 5
    assert first.stop() == 0
    given = {name: value for name, value in dump.items() if value != []}
    second = graph.start_node(given, units=False)
    assert "refused" not in second.output()
    for name in ("arm_elbow.learned.wavelet_weights", "arm_elbow.fir.order", "wrist__.learned.velocity_range"):
        value = graph.call_get(NODE, name)
        assert (list(value) if isinstance(value, array) else value) == dump[name], name
    # Every verb reads the same file.
    file = tmp_path / "dump.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": given}}))
    config = config_of(read_parameters(file), file, "arm/elbow")
    assert (config.fir.order, config.input.joint) == (4, "arm/elbow")
    assert list(config.learned.fir_taps) == dump["arm_elbow.learned.fir_taps"]
    assert second.stop() == 0


def example():
    """Return the program of docs/joints.md."""
    (program,) = (block.text for block in blocks("docs/joints.md") if block.language == "python")
    return program


def test_the_nodes_of_the_example_estimate_in_one_process(graph, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(example())
    process = graph.start(str(program))
    process.says("listening: /joint_states for elbow, wrist")
    process.says("listening: /slide/velocity, /slide/friction")
    topics = ["/arm_friction/elbow", "/arm_friction/wrist", "/slide/friction"]
    heard = [graph.hear(WrenchStamped, f"{topic}/friction_predicted", raw=True) for topic in topics]
    for topic in topics:
        graph.heard_by(f"{topic}/friction_predicted")
    feeder = ros_graph.Feeder(graph, "/slide")
    feeder.matched()
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    stamps, velocity, friction = motion(30_000, 500.0)
    start = time.perf_counter()
    # Best effort, as the nodes are by default, so at the pace of a drive and until enough has come through.
    for k, (stamp, v, f) in enumerate(zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True)):
        if all(len(box) > 500 for box in heard):
            break
        while (wait := start + k / 500.0 - time.perf_counter()) > 0:
            time.sleep(wait)
        publisher.publish(joint_state(stamp, ["wrist", "elbow"], [], [v, 2.0 * v], [f, 0.5 * f]))
        feeder.pair(stamp, v, f)
    assert all(len(box) > 500 for box in heard), [len(box) for box in heard]
    assert graph.call_get("/slide/friction", "model.law") == "nlms"
    assert graph.call_get("/arm_friction", "input.joints") == ["elbow", "wrist"]
    assert process.stop() == 0, process.output()
    assert "Traceback" not in process.output()


def test_parameters_of_a_program_are_checked_like_those_of_a_file(graph):
    """What cannot be used is refused by name; the node lives, and what was good is in force, whatever the order."""
    from rclpy.parameter import Parameter

    from friction_estimator.ros.estimator_node import EstimatorNode

    given = {"fir.oder": 3, "input.joints": ["a", "b"], "fir.order": 4, "input.mode": "joint_state", "b.fir.order": 2}
    node = EstimatorNode(
        "built",
        context=graph.context,
        parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
    )
    try:
        (line,) = node.refused
        assert "unknown parameter fir.oder" in line
        assert [node.settings.of(plain).fir.order for plain in node.joints] == [4, 2]
        changes = (Parameter("b.model.adapt", value=False), Parameter("fir.order", value=6))
        answers = [node.set_parameters_atomically([change]) for change in changes]
        assert [answer.successful for answer in answers] == [False, True]
        assert [joint.config.fir.order for joint in node.joints.values()] == [6, 2]
    finally:
        node.destroy_node()


def test_learned_values_that_are_asked_for_again_and_again_are_new_ones(graph, monkeypatch):
    from rclpy.parameter import Parameter

    from friction_estimator.ros import estimated_joint
    from friction_estimator.ros.estimator_node import EstimatorNode

    overrides = [Parameter(name, value=value) for name, value in ros_graph.UNITS.items()]
    node = EstimatorNode("built", context=graph.context, parameter_overrides=overrides)
    try:
        joint, now = node.joints[""], time.monotonic()
        times = iter(now + 0.1 * k for k in range(100))
        monkeypatch.setattr(estimated_joint.time, "monotonic", lambda: next(times))
        moments = [joint.learned() for _ in range(60)]
        assert all(moment is moments[0] for moment in moments[:50])
        assert moments[-1] is not moments[0]
    finally:
        monkeypatch.undo()
        node.destroy_node()


def test_what_a_second_brings_begins_one_after_another(graph, monkeypatch):
    """Threads that draw and save while diagnostics are made hold the interpreter's lock, and samples wait."""
    from rclpy.parameter import Parameter

    from friction_estimator.ros.estimator_node import BREATHS, EstimatorNode

    given = {"input.mode": "joint_state", "input.joints": [f"joint_{k}" for k in range(BREATHS)]}
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    node = EstimatorNode("built", context=graph.context, parameter_overrides=overrides)
    try:
        begun = []
        for plain, joint in node.joints.items():
            monkeypatch.setattr(joint, "begin_drawing", lambda plain=plain: begun.append(f"draw {plain}"))
            monkeypatch.setattr(joint, "begin_saving", lambda plain=plain: begun.append(f"save {plain}"))
        node._look()
        assert begun == []
        node._begin_pieces()
        assert begun == ["draw joint_0", "save joint_0"]
        for _ in range(1, BREATHS):
            node._begin_pieces()
        assert len(begun) == len(set(begun)) == 2 * BREATHS
        node._begin_pieces()
        assert len(begun) == 2 * BREATHS
    finally:
        node.destroy_node()


@pytest.mark.parametrize(
    ("joints", "says"), [(["a b", "a/b"], "both become a_b"), (["a", "a"], "twice"), (["a", ""], "no name")]
)
def test_joints_that_cannot_be_told_apart_are_refused_and_the_node_lives(graph, joints, says):
    from rclpy.parameter import Parameter

    from friction_estimator.ros.estimator_node import EstimatorNode

    overrides = [Parameter("input.mode", value="joint_state"), Parameter("input.joints", value=joints)]
    node = EstimatorNode("built", context=graph.context, parameter_overrides=overrides)
    try:
        assert says in "".join(node.refused)
        assert list(node.joints) == [""]
    finally:
        node.destroy_node()
