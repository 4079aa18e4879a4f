"""The player loses nothing at either end, keeps the recorded pace, and says what it cannot do."""

import sys
import threading
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
    graph.reached_by()
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


def test_services_pause_and_step(graph):
    """Names as rosbag2's player has them; without its types they are triggers, and what they cannot say is told."""
    velocity = graph.hear(TwistStamped, "/velocity", raw=True)
    player = play(graph, "--topics", "/velocity", "--start-paused")
    player.says("rosbag2_interfaces is not installed, so there is no is_paused, set_rate, get_rate, seek")

    def ask(name):
        return graph.call(Trigger, f"/rosbag2_player/{name}")

    await_(lambda: ask("play_next").success, "a first message, once somebody listens")
    assert ask("play_next").success
    wanted = recorded("/velocity")
    await_(lambda: len(velocity) == 2, "two steps")
    assert ask("resume").success
    await_(lambda: len(velocity) > 20, "motion")
    refused = ask("play_next")
    assert not refused.success
    assert "single steps are for pauses" in refused.message
    assert ask("toggle_paused").message == "paused"
    count = len(velocity)
    assert ask("play_next").success
    await_(lambda: len(velocity) > count, "a step")
    assert ask("stop").success
    assert player.popen.wait(LIMIT_S) == 0, player.output()
    assert list(map(bytes, velocity)) == wanted[: len(velocity)]


def test_names_and_types_are_those_of_rosbag2():
    """As rosbag2_transport's player creates them (player.cpp, create_control_services); its types check themselves."""
    from friction_estimator.ros.playback_clock import PlaybackClock
    from friction_estimator.ros.playback_control import PlaybackControl
    from friction_estimator.ros.player_services import NODE_NAME, REQUESTS, TRIGGERS

    assert NODE_NAME == "rosbag2_player"
    for name, (kind, _) in REQUESTS.items():
        assert kind == "".join(word.capitalize() for word in name.split("_"))
    assert set(TRIGGERS) < set(REQUESTS)
    types = pytest.importorskip("rosbag2_interfaces.srv", reason="rosbag2_interfaces is not installed")
    control = PlaybackControl(PlaybackClock(0, 1.0), 0, NS)
    for kind, answer in REQUESTS.values():
        service = getattr(types, kind)
        answer(control, service.Request(), service.Response())


def test_loop_clock_pause_and_jump_together(graph, monkeypatch):
    """Every message is as recorded, in order between jumps, and no stamp is ahead of the clock's grid."""
    from rosgraph_msgs.msg import Clock

    from friction_estimator.ros.player import Playback, Player

    monkeypatch.setenv("ROS_DOMAIN_ID", str(graph.domain))
    heard = graph.hear(WrenchStamped, "/friction", raw=True)
    clock = graph.hear(Clock, "/clock")
    with Source(DEMO) as source, Player(
        source, Playback(rate=5.0, duration_s=2.0, loop=True, clock_hz=100.0, topics=["/friction"]), lambda _: None
    ) as player:  # fmt: skip
        begin_ns = source.span_ns[0]
        thread = threading.Thread(target=player.run)
        thread.start()
        try:
            await_(lambda: len(heard) > 450, "the second round")
            player.control.pause()
            assert player.control.seek(begin_ns + NS)
            await_(lambda: clock and time_of(clock[-1]) == begin_ns + NS, "the clock at the jump")
            count = len(heard)
            assert player.control.play_next()
            assert player.control.play_next()
            await_(lambda: len(heard) == count + 2, "two steps")
            player.control.resume()
            await_(lambda: len(heard) > count + 500, "a round more")
        finally:
            player.control.stop()
            thread.join(LIMIT_S)
    wanted = recorded("/friction")[:400]
    assert bytes(heard[count]) == wanted[200]
    index = {raw: k for k, raw in enumerate(wanted)}
    order = np.array([index[bytes(raw)] for raw in heard])
    jumps = np.flatnonzero(np.diff(order) != 1)
    landed = [int(order[k + 1]) for k in jumps]
    assert landed.count(200) == 1
    assert set(landed) == {0, 200}  # rounds of the loop, and the one jump
    times = np.array([time_of(message) for message in clock])
    assert np.count_nonzero(np.diff(times) < 0) <= len(jumps)
    assert begin_ns <= times.min()
    assert times.max() < begin_ns + 2 * NS


def time_of(message):
    return message.clock.sec * NS + message.clock.nanosec


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--wait", "0.3"], 1, "nobody subscribed to"),
        (["--rate", "0"], 2, "--rate"),
        (["--start-offset", "100"], 2, "ends after"),
        (["--start-offset", "nan"], 2, "--start-offset"),
        (["--start-offset", "1e300"], 2, "ends after"),
        (["--duration", "-1"], 2, "--duration"),
        (["--duration", "nan"], 2, "--duration"),
        (["--duration", "inf"], 2, "--duration"),
        (["--wait", "nan"], 2, "--wait"),
        (["--remap", "/velocity:=/friction"], 2, "another message type"),
        (["--remap", "/velocity:=bad!name"], 2, "--remap"),
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
