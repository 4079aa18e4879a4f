"""What `watch` costs the node: its processor time at 1 kHz with and without a listener of ~/monitor, in turns.

usage: python benchmarks/node/monitor.py [--turns N] [--seconds S] [--rate HZ]
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))

import ros_graph
from ros_graph import Feeder, await_, motion


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    args = parser.parse_args()
    count = int(args.rate * args.seconds)
    stamps, velocity, friction = (values.tolist() for values in motion(2 * args.turns * count, args.rate))
    shares: dict[bool, list[float]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as folder, ros_graph.graph(Path(folder)) as graph:
        node = graph.start_node()
        feeder = Feeder(graph)
        feeder.matched()
        for turn in range(2 * args.turns):
            watched = bool((turn + turn // 2) % 2)  # off, on, on, off, ...
            watch = graph.start("-m", "friction_estimator", "watch", "--port", "0") if watched else None
            if watch is not None:
                watch.says("shows")
            await_(
                lambda watched=watched: graph.probe.count_subscribers("/friction_estimator/monitor") == watched, "watch"
            )
            before, begun = node.cpu_s(), time.perf_counter()
            for k in range(count):
                due = begun + k / args.rate
                while (left := due - time.perf_counter()) > 0.0:
                    time.sleep(left)
                feeder.pair(*(values[turn * count + k] for values in (stamps, velocity, friction)))
            shares[watched].append((node.cpu_s() - before) / (time.perf_counter() - begun))
            if watch is not None:
                watch.stop()
        node.stop()
    off, on = (statistics.median(shares[watched]) for watched in (False, True))
    ratios = sorted(b / a for a, b in zip(shares[False], shares[True], strict=True))
    print(f"{args.rate:g} Hz, {args.turns} turns of {args.seconds:g} s each: {100 * off:.1f} % of a core unwatched")
    spread = f"{ratios[0]:.3f} to {ratios[-1]:.3f}"
    print(f"{100 * on:.1f} % watched; of neighbouring turns {statistics.median(ratios):.3f} ({spread})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
