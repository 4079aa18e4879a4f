"""What a client, a remapping or an overload can do to the node: told in one place, and no sample of others is lost."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import TwistStamped
from ros_graph import UNITS, await_, force, motion
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from test_ros_node import connected, diagnostics, feed, offline

from friction_estimator.core.settings.config import Config
from friction_estimator.ros.build import build
from friction_estimator.ros.stream import SLOWEST_BREATH_S, SampleStream

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def test_files_are_not_for_the_graph_unless_the_start_said_so(graph):
    """A client can neither have the first line of a file told nor a file written."""
    secret, target = graph.folder / "secret.csv", graph.folder / "written"
    secret.write_text("a line that is nobody's business\n")
    process = graph.start_node()
    for name, path in (("theory__table", secret), ("state__file", target)):
        answer = graph.call_set(NODE, **{name: str(path)})
        assert not answer.successful
        assert name.replace("__", ".") in answer.reason
        assert "files.remote" in answer.reason
    assert not graph.call_set(NODE, files__remote=True).successful
    assert "start again" in graph.call_set(NODE, files__remote=True).reason
    # With other changes, all or nothing; the same value again is no change.
    assert not graph.call_set(NODE, lms__step_size=0.01, state__file=str(target)).successful
    assert graph.call_get(NODE, "lms.step_size") == 0.005
    assert graph.call_set(NODE, state__file="", files__remote=False).successful
    for service in ("save", "load"):
        answer = graph.call(Trigger, f"{NODE}/{service}")
        assert not answer.success
        assert "state.file is empty" in answer.message
    assert not graph.call_set(NODE, theory__kind="table").successful
    assert not target.exists()
    assert "nobody's business" not in process.output()
    assert process.stop() == 0
    assert not target.exists()


def test_files_from_the_graph_where_the_start_allows_it(graph):
    target = graph.folder / "state.json"
    process = graph.start_node({"files.remote": True})
    assert graph.call_set(NODE, state__file=str(target)).successful
    assert graph.call(Trigger, f"{NODE}/save").success
    assert target.exists()
    assert process.stop() == 0


def test_a_reset_that_fails_leaves_what_was_running(graph):
    """The next predictions are those of a node that was not asked, and what it learned can be saved."""
    state, missing = graph.folder / "state.json", graph.folder / "no such table.csv"
    process = graph.start_node({"files.remote": True, "state.file": str(state)})
    feeder, heard = connected(graph)
    stamps, velocity, friction = motion(800, 400.0)
    feed(feeder, stamps[:400], velocity[:400], friction[:400], 400.0)
    await_(lambda: len(heard) == 400, "predictions")
    assert graph.call_set(NODE, theory__kind="table", theory__table=str(missing)).successful
    answer = graph.call(Trigger, f"{NODE}/reset")
    assert not answer.success
    assert missing.name in answer.message
    feed(feeder, stamps[400:], velocity[400:], friction[400:], 400.0)
    await_(lambda: len(heard) == 800, "predictions after the failed reset")
    np.testing.assert_array_equal([force(raw)[1] for raw in heard], offline(stamps, velocity, friction))
    assert graph.call(Trigger, f"{NODE}/save").success
    values = diagnostics(graph, lambda v: v["estimator level"] == 1)
    assert missing.name in values["reset"]
    assert graph.call_set(NODE, theory__kind="seal").successful
    assert graph.call(Trigger, f"{NODE}/reset").success
    assert "reset" not in diagnostics(graph, lambda v: "reset" not in v)
    assert process.stop() == 0


LIVE = (
    {"sync__gap_factor": 4.0},
    {"sync__slop": 0.0001},
    {"sync__queue": 500},
    {"sync__jump_back": 2.0},
    {"publish__parameters_rate": 5.0},
    {"rls__forgetting_factor": 0.999},
    {"state__period": 3.0},
    {"input__joint": "shaft"},
    {"input__axis": "y"},
    {"input__axis": "x"},
    {"input__friction_sign": 1},
    {"lms__step_size": 0.001},
    {"sync__queue": 1000, "sync__gap_factor": 5.0},
)
"""One change after the other while samples come; none concerns what is predicted here, but for the axis."""


def test_no_parameter_that_acts_at_once_costs_a_sample(graph):
    """Subscriptions stay open, waiting messages wait on: every sample is predicted, as if nothing had been set."""
    import threading

    process = graph.start_node()
    feeder, heard = connected(graph)
    stamps, velocity, friction = motion(3000, 500.0)
    # On y the messages hold zeros: those samples are told from the others by what is predicted of them, not by number.
    feeding = threading.Thread(target=feed, args=(feeder, stamps, velocity, friction, 500.0))
    feeding.start()
    changes = [change for change in LIVE if "input__axis" not in change]
    for change in changes:
        answer = graph.call_set(NODE, **change)
        assert answer.successful, answer.reason
    feeding.join()
    feeder.acknowledged()
    await_(lambda: len(heard) >= stamps.size, "all predictions")
    assert [force(raw)[0] for raw in heard] == stamps.tolist()
    np.testing.assert_array_equal([force(raw)[1] for raw in heard], offline(stamps, velocity, friction))
    for change in LIVE:
        before = len(heard)
        later = stamps[-1] + (stamps[:200] - stamps[0]) + 2_000_000 * (1 + LIVE.index(change) * 200)
        feed(feeder, later[:100], velocity[:100], friction[:100], 500.0)
        assert graph.call_set(NODE, **change).successful
        feed(feeder, later[100:], velocity[100:200], friction[100:200], 500.0)
        await_(lambda n=before: len(heard) == n + 200, f"all predictions around {change}")
    values = diagnostics(graph, lambda v: v["predictions"] == str(len(heard)))
    assert "rejected: unmatched" not in values
    assert values["velocity: messages"] == values["predictions"]  # counted on, not anew
    assert process.stop() == 0


def test_a_topic_of_another_type_is_told_and_lived_with(graph):
    """Two inputs remapped to one name, and an optional one to a topic of the node's own: no respawn loop, no trace."""
    process = graph.start_node(arguments=("-r", "velocity:=/f", "-r", "friction:=/f", "-r", "~/residual:=/rosout"))
    values = diagnostics(graph, lambda v: v["inputs level"] == 2)
    assert "/f: cannot be subscribed to as geometry_msgs/msg/WrenchStamped" in values["inputs message"]
    assert "residual cannot be published" in values["outputs"]
    assert "Traceback" not in process.output()
    assert process.stop() == 0

    process = graph.start_node(arguments=("-r", "pressure:=/diagnostics"))
    feeder, heard = connected(graph)
    await_(lambda: feeder.pair(time.time_ns(), 0.1, 2.0) or heard, "a prediction without the optional channel")
    values = diagnostics(graph, lambda v: v["inputs level"] == 1)
    assert any("/diagnostics: cannot be subscribed to" in str(text) for text in values.values())
    assert process.stop() == 0


@pytest.mark.parametrize("rule", ["__ns:=a//b", "velocity:=/a//b", "/diagnostics:=/rosout"])
def test_names_that_rcl_refuses_are_one_line(graph, rule):
    process = graph.start("-m", "friction_estimator.ros.node", "--ros-args", "-r", rule)
    assert process.popen.wait(ros_graph.LIMIT_S) == 2, process.output()
    assert "Traceback" not in process.output()
    assert len([line for line in process.output().splitlines() if line.startswith("friction_estimator: ")]) == 1


def test_a_second_publisher_is_told_while_it_is_there(graph):
    process = graph.start_node()
    feeder, _ = connected(graph)
    stamps, velocity, friction = motion(100_000, 200.0)
    ahead = iter(range(stamps.size))

    def fed(condition):
        for _ in range(20):
            k = next(ahead)
            feeder.pair(int(stamps[k]), velocity[k], friction[k])
        return condition

    values = diagnostics(graph, lambda v: fed(v["velocity: publishers"] == "1" and int(v["predictions"]) > 20))
    other = ros_graph.Graph(graph.domain, graph.folder)
    other.publisher(TwistStamped, "/velocity")
    said = "/velocity: expected one publisher, seen 2 (/probe, /probe)"
    # The graph knows a publisher some time before the name of its node.
    values = diagnostics(graph, lambda v: fed(any(said in str(text) for text in v.values())))
    assert (values["velocity: publishers"], values["inputs level"]) == ("2", 1)
    other.close()
    diagnostics(graph, lambda v: fed(v["velocity: publishers"] == "1" and v["inputs level"] == 0))
    told = [line for line in process.output().splitlines() if "expected one publisher" in line]
    assert len([line for line in told if "no longer so" not in line]) == 1
    assert process.stop() == 0


def test_joints_of_a_machine_in_parts_are_no_second_sensor(graph):
    graph.start_node({"input.mode": "joint_state", "input.joint": "shaft"})
    publisher = graph.publisher(JointState, "/joint_states")
    other = ros_graph.Graph(graph.domain, graph.folder)
    second = other.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    other.matched("/joint_states")
    tick = iter(range(1, 10**6))

    def send(joint, condition):
        for name, sink in (("shaft", publisher), (joint, second)):
            message = JointState(name=[name], velocity=[0.1], effort=[1.0])
            message.header.stamp.nanosec = 1000 * next(tick)
            sink.publish(message)
        return condition

    diagnostics(
        graph,
        lambda v: send("elbow", v["joint_states: publishers"] == "2" and int(v.get("rejected: wrong_joint", 0)) > 2
                       and "several publishers" not in str(v) and "expected one publisher" not in str(v)),
    )  # fmt: skip
    diagnostics(graph, lambda v: send("shaft", "expected one publisher" in str(v)))
    other.close()


def test_a_frame_of_a_megabyte_does_not_fill_the_log(graph):
    process = graph.start_node({"input.mode": "joint_state", "input.joint": "shaft"})
    publisher = graph.publisher(JointState, "/joint_states")
    graph.matched("/joint_states")
    tick = iter(range(1, 10**6))

    def send(condition):
        for frame in ("", "w" * 1_000_000):
            message = JointState(name=["shaft"], velocity=[0.1], effort=[1.0])
            message.header.frame_id = frame + "\n[FATAL] forged"
            message.header.stamp.sec = next(tick)
            publisher.publish(message)
        return condition

    values = diagnostics(graph, lambda v: send("expected frame" in v["inputs message"]))
    assert len(values["inputs message"]) <= 2000
    assert process.stop() == 0
    assert len(process.output()) < 20_000
    assert not [line for line in process.output().splitlines() if line.startswith("[FATAL]")]


def test_messages_that_never_came_are_counted_by_their_stamps(graph):
    process = graph.start_node()
    feeder, heard = connected(graph)
    stamps, velocity, friction = motion(2000, 500.0)
    gone = (np.arange(2000) > 500) & (np.arange(2000) % 50 < 3)
    gone[-1] = False
    keep = np.flatnonzero(~gone)
    feed(feeder, stamps[keep], velocity[keep], friction[keep], 500.0)
    await_(lambda: len(heard) == keep.size, "predictions")
    lost = int(gone.sum())
    values = diagnostics(graph, lambda v: int(v["velocity: messages missing"]) >= 0.9 * lost)
    for name in ("velocity", "friction"):
        assert abs(int(values[f"{name}: messages missing"]) - lost) <= max(1, 0.01 * lost)
    assert "are missing since the last look" in process.output()
    assert process.stop() == 0


def test_a_failed_save_is_a_warning(graph):
    process = graph.start_node({"state.file": "/proc/no/such/state.json", "state.period": 0.1})
    feeder, _ = connected(graph)
    stamps, velocity, friction = motion(100, 500.0)
    feed(feeder, stamps, velocity, friction, 500.0)
    values = diagnostics(graph, lambda v: v["estimator level"] == 1 and "state file failure" in v)
    assert "/proc/no/such/state.json" in values["estimator message"]
    assert process.stop() == 0


def test_a_thread_that_is_kept_from_the_processor_does_not_take_its_samples_for_slow():
    """As it was, one sample a turn was worked off: on a busy machine 30 % were dropped at 15 % of a processor."""
    config = Config().updated(UNITS)
    turns, interrupted = 0, -1

    def publish(*_):
        nonlocal interrupted
        if interrupted != turns:
            interrupted = turns
            time.sleep(0.011)  # to the thread as if others ran; longer than a piece may take

    stream = SampleStream(config, build, publish)
    stream.begin(config, build(config))
    began = time.monotonic()
    await_(lambda: time.monotonic() - began > SLOWEST_BREATH_S, "time in which no timer is served")
    stamps, velocity, friction = motion(1500, 1000.0)
    for stamp, *pair in zip(stamps.tolist(), velocity, friction, strict=True):
        for channel, value in enumerate(pair):
            stream.event(channel, stamp, value)
    assert stream.working_off
    while stream.working_off and turns < 100:
        turns += 1
        stream.work_off()
    assert (stream.predictions, stream.overrun) == (1500, 0)
    assert 0.0 < stream.sample_s < 0.005  # what /diagnostics say that a sample needs
