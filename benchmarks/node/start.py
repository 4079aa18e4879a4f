"""Time from the start of a process to its first message: the node's first prediction beside a bare rclpy node's echo.

A part of `python benchmarks/bench.py`.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from common import HERE, PREDICTED
from geometry_msgs.msg import WrenchStamped
from measure import in_turn, part
from ros_graph import Feeder, Graph, Process, graph, motion, qos

NODES: dict[str, Callable[[Graph], Process]] = {
    "bare rclpy node": lambda made: made.start(str(HERE / "bare_node.py")),
    "node": lambda made: made.start_node(deep=False, ready=False),
}
"""The node is told its range and units: without them it waits for two reversals of the drive, as long as these take."""

LONGEST_S = 60.0


def first_message(
    made: Graph, feeder: Feeder, heard: list[int], start: Callable[[Graph], Process], rate: float
) -> list[float]:
    """Return the time from a process's start to its first message by the clock and of its processor, s."""
    heard.clear()
    stamps, velocity, friction = motion(round(LONGEST_S * rate), rate)
    begin = time.perf_counter_ns()
    process = start(made)
    for stamp, *pair in zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True):
        if heard:
            break
        feeder.pair(stamp, *pair)
        time.sleep(1.0 / rate)
    cpu = process.cpu_s()
    assert heard, process.output()
    process.stop()  # rclpy's own executor may fail at a signal: no matter here
    return [1e-9 * (heard[0] - begin), cpu]


def measured(rounds: int, rate: float) -> dict[str, Any]:
    heard: list[int] = []
    with graph(Path(tempfile.mkdtemp())) as made:
        made.probe.create_subscription(
            WrenchStamped, PREDICTED, lambda _: heard.append(time.perf_counter_ns()), qos(False, 1000), raw=True
        )
        feeder = Feeder(made)
        first = {
            name: (lambda start=start: first_message(made, feeder, heard, start, rate)) for name, start in NODES.items()
        }
        found = in_turn(first, rounds)
    return {
        "rate_hz": rate,
        "processes": {
            name: dict(zip(("clock", "cpu"), map(list, zip(*runs, strict=True)), strict=True))
            for name, runs in found.items()
        },
    }


if __name__ == "__main__":
    part(measured, __doc__, rounds=9, rate=100.0)
