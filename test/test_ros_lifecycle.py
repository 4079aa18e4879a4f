"""Stop and start: every signal ends the node in order, and what it learned survives."""

import os
import signal

import pytest

pytest.importorskip("rclpy")

import numpy as np
import ros_graph
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from ros_graph import Feeder, await_, force, motion
from ros_lifecycle import kill_at_random, stop_at_random
from std_srvs.srv import Trigger

from friction_estimator.ros.state import dumps

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
        graph.reached_by()
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
        (b"", "no state file"),
        (os.urandom(200), "no state file"),
        (dumps({"version": 99}), "version"),
        (dumps({"something": 1}), "lacks version"),
    ):
        state.write_bytes(content)
        answer = graph.call(Trigger, f"{NODE}/load")
        assert not answer.success
        assert words in answer.message, answer.message
    state.unlink()
    assert "No such file" in graph.call(Trigger, f"{NODE}/load").message
    state.mkdir()
    for service in ("load", "save"):
        assert "it is a folder" in graph.call(Trigger, f"{NODE}/{service}").message
    state.rmdir()
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


def test_a_state_path_that_is_foreign_hangs_nothing_and_is_told(graph):
    """A named pipe once held up the start, ~/load and then the signal."""
    pipe = graph.folder / "pipe"
    os.mkfifo(pipe)
    process = graph.start_node({"state.file": str(pipe), "state.period": 0.1})
    assert "starting cold and not saving" in process.output()
    for service in ("load", "save"):
        assert "a named pipe" in graph.call(Trigger, f"{NODE}/{service}").message
    heard = graph.hear(DiagnosticArray, "/diagnostics")
    await_(lambda: heard, "diagnostics")
    said = {item.key: item.value for status in heard[0].status for item in status.values}
    assert "a named pipe" in said["state file failure"]
    assert process.stop(signal.SIGTERM) == 0
    assert "Traceback" not in process.output()
    assert pipe.is_fifo()


def test_two_nodes_with_one_state_file_do_not_both_save(graph):
    state = graph.folder / "state.json"
    first = graph.start_node({"state.file": str(state)})
    second = graph.start_node({"state.file": str(state)}, namespace="/second")
    assert f"in use by process {first.pid}" in second.output()
    answer = graph.call(Trigger, "/second/friction_estimator/save")
    assert not answer.success
    assert f"process {first.pid}" in answer.message
    assert not state.exists()
    assert first.stop() == 0
    assert graph.call(Trigger, "/second/friction_estimator/save").success
    assert second.stop() == 0
    assert [name for name in os.listdir(graph.folder) if "state.json" in name] == ["state.json"]
