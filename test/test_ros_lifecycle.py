"""Stop and start: every signal ends the node in order, and what it learned survives."""

import os
import signal

import pytest

pytest.importorskip("rclpy")

import numpy as np
import ros_graph
from geometry_msgs.msg import WrenchStamped
from ros_graph import Feeder, await_, force, motion
from ros_lifecycle import kill_at_random, stop_at_random
from std_srvs.srv import Trigger

from friction_estimator.core.errors import InputError
from friction_estimator.ros.state import dumps, loads, read_state, sweep, write_state

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_moment_ends_in_order(graph, number):
    endings = stop_at_random(graph, number, 4, seed=number)
    assert not endings.faults, "\n".join(endings.faults)
    assert endings.codes == [0] * 4


def test_a_signal_before_the_first_line(graph):
    """While modules are imported."""
    for number in (signal.SIGINT, signal.SIGTERM):
        process = graph.start_node(ready=False)
        await_(lambda p=process, n=number: handles(p.pid, n), "the signal handlers")
        process.popen.send_signal(number)
        assert process.popen.wait(ros_graph.LIMIT_S) == 0, process.output()
        assert "Traceback" not in process.output()


def handles(pid, number):
    with open(f"/proc/{pid}/status") as status:
        caught = next(int(line.split()[1], 16) for line in status if line.startswith("SigCgt"))
    return caught >> (number - 1) & 1 and caught >> (signal.SIGTERM - 1) & 1


def test_a_killed_node_comes_back_with_the_last_complete_state(graph):
    assert not kill_at_random(graph, 3, seed=5)


def test_state_survives_a_restart_bit_for_bit(graph):
    """Stop, start, go on: the same predictions as without the stop, but for the delay lines' restart."""
    stamps, velocity, friction = motion(1200, 400.0)
    state = graph.folder / "state.json"

    def run(part, **parameters):
        process = graph.start_node({"state.file": str(state), **parameters})
        feeder = Feeder(graph)
        heard = graph.hear(WrenchStamped, f"{NODE}/friction_predicted", raw=True)
        feeder.matched()
        graph.heard_by(f"{NODE}/friction_predicted")
        for k in range(*part.indices(stamps.size)):
            feeder.pair(int(stamps[k]), velocity[k], friction[k])
            await_(lambda n=k - part.start: len(heard) > n, "a prediction")
        process.stop()
        return [force(raw)[1] for raw in heard]

    run(slice(0, 800))
    kept = state.read_bytes()
    first = run(slice(800, 1200))
    assert np.std(np.array(first) - friction[800:1200]) < 0.1 * np.std(friction)
    state.write_bytes(kept)
    assert run(slice(800, 1200)) == first
    # The stop itself saved what was learned meanwhile.
    assert state.read_bytes() != kept


def test_damaged_and_foreign_state_files_are_refused_with_the_reason(graph):
    state = graph.folder / "state.json"
    process = graph.start_node({"state.file": str(state)})
    assert graph.call(Trigger, f"{NODE}/save").success
    good = state.read_bytes()
    for content, words in (
        (good[: len(good) // 2], "cut short"),
        (good.replace(b"version", b"Version", 1), "damaged"),
        (b"", "cut short"),
        (os.urandom(200), "no state file"),
        (dumps({"estimator": {"version": 99}}), "version"),
        (dumps({"something": 1}), "no estimator"),
    ):
        state.write_bytes(content)
        answer = graph.call(Trigger, f"{NODE}/load")
        assert not answer.success
        assert words in answer.message, answer.message
    state.unlink()
    assert "No such file" in graph.call(Trigger, f"{NODE}/load").message
    state.write_bytes(good)
    assert graph.call(Trigger, f"{NODE}/load").success
    assert process.stop() == 0

    state.write_bytes(good[:1000])
    process = graph.start_node({"state.file": str(state)})
    assert "starting cold" in process.output()
    assert "cut short" in process.output()
    assert (graph.folder / "state.json.refused").read_bytes() == good[:1000]
    assert process.stop() == 0
    state.write_bytes(good)
    process = graph.start_node({"state.file": str(state), "fir.order": 3})
    assert "fir.order" in process.output()
    assert process.stop() == 0


def test_an_unwritable_state_file_is_reported_and_survived(graph):
    process = graph.start_node({"state.file": "/proc/no/such/state.json", "state.period": 0.1})
    answer = graph.call(Trigger, f"{NODE}/save")
    assert not answer.success
    assert "/proc/no/such/state.json" in answer.message
    assert process.stop() == 0
    assert "Traceback" not in process.output()


def test_state_content_round_trip():
    state = {
        "a": np.array([1.5, -0.0, 5e-324, np.pi]),
        "b": np.array([[1, 2], [3, 4]], np.int32),
        "c": {"d": [1, 2.5, "x", None, True]},
        "e": np.zeros((0, 3)),
    }
    again = loads(dumps(state), "test")
    for name in ("a", "b", "e"):
        assert again[name].dtype == state[name].dtype
        assert again[name].shape == state[name].shape
        assert again[name].tobytes() == state[name].tobytes()
    assert again["c"] == state["c"]


def test_sweep_removes_what_killed_writers_left(tmp_path):
    state = tmp_path / "state.json"
    write_state(state, dumps({"x": 1}))
    old, new, other = tmp_path / ".state.json.old", tmp_path / ".state.json.new", tmp_path / ".other.json.old"
    for folder in (old, new, other):
        folder.mkdir()
        os.utime(folder, (1, 1) if folder is not new else None)
    sweep(state)
    assert not old.exists()
    assert new.exists()
    assert other.exists()
    assert read_state(state) == {"x": 1}
    with pytest.raises(InputError, match="cannot read"):
        read_state(tmp_path / "none.json")
