"""Time from the start of a process to its first message: the node's first prediction beside a bare rclpy node's echo.

python start.py [--rounds 7] [--rate 100]
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from common import HERE, PREDICTED, rows, write_section
from geometry_msgs.msg import WrenchStamped
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--rate", type=float, default=100.0)
    args = parser.parse_args()
    heard: list[int] = []
    took: dict[str, list[list[float]]] = {name: [] for name in NODES}
    with graph(Path(tempfile.mkdtemp())) as made:
        made.probe.create_subscription(
            WrenchStamped, PREDICTED, lambda _: heard.append(time.perf_counter_ns()), qos(False, 1000), raw=True
        )
        feeder = Feeder(made)
        for _ in range(args.rounds + 1):
            for name, start in NODES.items():
                took[name].append(first_message(made, feeder, heard, start, args.rate))
    lines = []
    bare = took["bare rclpy node"][1:]  # the first round fills the caches
    for name, every in took.items():
        runs = every[1:]
        ratios = [statistics.median(a[k] / b[k] for a, b in zip(runs, bare, strict=True)) for k in (0, 1)]
        clock, cpu = (statistics.median(run[k] for run in runs) for k in (0, 1))
        lines.append([name, f"{clock:.2f}", f"{ratios[0]:.2f}", f"{cpu:.2f}", f"{ratios[1]:.2f}"])
    write_section(
        "Start",
        f"From the start of a process to its first message, while pairs come at {args.rate:g} Hz; medians of "
        f"{args.rounds} rounds in turns, with warm caches, range and units given, and a feeder that announces itself "
        "every 50 ms. At most 3 by the clock.\n\n"
        + rows(["process", "s by the clock", "over the bare node", "CPU, s", "over the bare node"], lines),
    )


if __name__ == "__main__":
    main()
