"""What `watch` costs the node: processor time at 1 kHz of two nodes fed alike, of which one is watched, in turns.

What else the machine does meets both of them alike; the one that is watched changes from turn to turn. A turn is
measured once the listener has been met: that costs the node once, not as long as it lasts.

usage: python benchmarks/node/monitor.py [--turns N] [--seconds S] [--settle S] [--rate HZ]
"""

import argparse
import statistics
import sys
import tempfile
import time
from itertools import islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))

import ros_graph
from ros_graph import Feeder, await_, motion

NAMESPACES = ("/left", "/right")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--settle", type=float, default=2.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    args = parser.parse_args()
    if args.turns < 2 or args.turns % 2:
        parser.error(f"--turns {args.turns}: give an even number, each node is watched in one of two turns")
    count, unmeasured = int(args.rate * args.seconds), int(args.rate * args.settle)
    samples = motion(args.turns * (unmeasured + count), args.rate)
    waiting = zip(*(values.tolist() for values in samples), strict=True)
    unwatched, ratios = [], []
    with tempfile.TemporaryDirectory() as folder, ros_graph.graph(Path(folder)) as graph:
        nodes = [graph.start_node(namespace=namespace) for namespace in NAMESPACES]
        feeders = [Feeder(graph, namespace) for namespace in NAMESPACES]
        for feeder in feeders:
            feeder.matched()
        for turn in range(args.turns):
            chosen = (turn + turn // 2) % 2  # left, right, right, left, ...
            name = f"{NAMESPACES[chosen]}/friction_estimator"
            watch = graph.start("-m", "friction_estimator", "watch", "--port", "0", "--node", name)
            watch.says("shows")
            await_(lambda name=name: graph.probe.count_subscribers(f"{name}/monitor") == 1, "watch")
            for part in (unmeasured, count):
                before, begun = [node.cpu_s() for node in nodes], time.perf_counter()
                for k, sample in enumerate(islice(waiting, part)):
                    due = begun + k / args.rate
                    while (left := due - time.perf_counter()) > 0.0:
                        time.sleep(left)
                    for feeder in feeders:
                        feeder.pair(*sample)
            spent = [node.cpu_s() - start for node, start in zip(nodes, before, strict=True)]
            unwatched.append(spent[1 - chosen] / (time.perf_counter() - begun))
            ratios.append(spent[chosen] / spent[1 - chosen])
            watch.stop()
            await_(lambda name=name: graph.probe.count_subscribers(f"{name}/monitor") == 0, "its end")
        for node in nodes:
            node.stop()
    # One node may be dearer than the other: of two turns each is watched once.
    pairs = [(a * b) ** 0.5 for a, b in zip(ratios[::2], ratios[1::2], strict=True)]
    error = statistics.stdev(pairs) / len(pairs) ** 0.5 if len(pairs) > 1 else float("nan")
    share = 100.0 * statistics.median(unwatched)
    print(f"{args.rate:g} Hz, {args.turns} turns of {args.seconds:g} s each: {share:.1f} % of a core unwatched")
    told = f"mean {statistics.mean(pairs):.3f} +- {error:.3f}, {min(pairs):.3f} to {max(pairs):.3f}"
    print(f"watched over unwatched, of two turns each: median {statistics.median(pairs):.3f}, {told}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
