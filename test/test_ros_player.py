"""The player loses nothing at either end, keeps the recorded pace, and says what it cannot do."""

import sys
import time

import pytest

pytest.importorskip("rclpy")

import numpy as np
import ros_graph
from geometry_msgs.msg import TwistStamped, WrenchStamped
from ros_graph import LIMIT_S, NS, ROOT, await_, force
from std_srvs.srv import Trigger

from friction_estimator.bag.source import Source
from friction_estimator.cli.main import main

pytestmark = pytest.mark.ros
DEMO = ROOT / "bags" / "demo"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def play(graph, *options):
    return graph.start("-m", "friction_estimator", "play", str(DEMO), *map(str, options))


def recorded(topic):
    with Source(DEMO) as source:
        return [raw for _, _, raw in source.messages([topic])]


def test_every_byte_arrives_at_the_recorded_pace(graph):
    """From the first message to the last, although the subscriber appears after the player."""
    player = play(graph, "--rate", 5, "--duration", 5)
    heard = []
    graph.probe.create_subscription(
        TwistStamped,
        "/velocity",
        lambda raw: heard.append((time.perf_counter(), raw)),
        ros_graph.qos(True, 10000),
        raw=True,
    )
    assert player.popen.wait(LIMIT_S) == 0, player.output()
    wanted = recorded("/velocity")[:1000]
    await_(lambda: len(heard) >= len(wanted), "all messages", 10.0)
    assert [raw for _, raw in heard] == wanted
    assert heard[-1][0] - heard[0][0] > 0.4
    assert "played 3100 messages" in player.output()


def test_remapped_part_with_clock(graph):
    from rosgraph_msgs.msg import Clock

    heard = graph.hear(WrenchStamped, "/left/friction", raw=True)
    clock = graph.hear(Clock, "/clock")
    player = play(
        graph, "--remap", "/friction:=/left/friction", "--topics", "/friction", "--start-offset", 2, "--duration", 1,
        "--clock", 100, "--rate", 2,
    )  # fmt: skip
    assert player.popen.wait(LIMIT_S) == 0, player.output()
    wanted = recorded("/friction")[400:600]
    await_(lambda: len(heard) >= 200 and len(clock) >= 50, "all messages", 10.0)
    assert list(map(bytes, heard)) == wanted
    times = np.array([message.clock.sec * NS + message.clock.nanosec for message in clock])
    stamps = [force(raw)[0] for raw in wanted]
    assert (np.diff(times) == NS // 50).all()  # 100 Hz at twice the speed
    assert times[0] <= stamps[0]
    assert stamps[-1] - NS // 50 <= times[-1]


def test_a_loop_keeps_what_was_learned(graph):
    """The node hears the recording again and again: nothing is lost, and the second round is better."""
    node = graph.start_node({"publish.parameters_rate": 0.0})
    heard = graph.hear(WrenchStamped, "/friction_estimator/friction_predicted", raw=True)
    graph.heard_by("/friction_estimator/friction_predicted")
    player = play(graph, "--loop", "--duration", 3, "--rate", 3)
    name, calls = "/friction_estimator", 0
    while len(heard) < 1800:  # meanwhile somebody turns every knob that acts at once
        calls += 1
        assert graph.call_set(name, rls__forgetting_factor=0.99 + 0.001 * (calls % 9), lms__step_size=1e-3).successful
        assert graph.call_set(name, state__period=float(calls), publish__parameters_rate=float(calls % 3)).successful
        assert not graph.call(Trigger, f"{name}/save").success
        assert len(graph.call_get(name, "learned.fir_taps")) == 9
    player.stop()
    assert player.popen.returncode == 0, player.output()
    stamps, values = np.array([force(raw) for raw in heard[:1800]]).T
    assert (stamps[:600] == stamps[600:1200]).all()
    truth = np.array([force(raw)[1] for raw in recorded("/friction")[:600]])
    errors = [np.sqrt(np.mean((values[k : k + 600] - truth) ** 2)) for k in (0, 600, 1200)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 1.1 * errors[1]
    assert node.stop() == 0


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--wait", "0.3"], 1, "nobody subscribed to"),
        (["--rate", "0"], 2, "--rate"),
        (["--start-offset", "100"], 2, "ends after"),
        (["--duration", "-1"], 2, "--duration"),
        (["--remap", "/velocity=/x"], 2, "FROM:=TO"),
        (["--remap", "/speed:=/x"], 2, "no topic /speed"),
        (["--topics", "/speed"], 2, "no topic /speed"),
    ],
)
def test_what_cannot_be_played_is_one_line(options, code, words, capsys, monkeypatch):
    with ros_graph.reserved_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        assert main(["play", str(DEMO), *options]) == code
    error = capsys.readouterr().err.strip()
    assert words in error
    assert len(error.splitlines()) == 1


def test_without_ros_the_reason_is_told(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "friction_estimator.ros.player", None)
    assert main(["play", str(DEMO)]) == 2
    assert "rclpy" in capsys.readouterr().err
