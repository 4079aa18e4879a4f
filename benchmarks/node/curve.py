"""What the static curve costs the samples: round trips with and without a listener of ~/friction_curve.

python curve.py [--rounds 3] [--round-seconds 10] [--rate 1000]
"""

# ruff: noqa: E402 - the number of threads is set before numpy comes in
import argparse
import statistics
import tempfile
import time
from pathlib import Path

from friction_estimator.threads import one_thread

one_thread()  # as the node does

import numpy as np
from common import Load, write_section
from ros_graph import UNITS, graph
from std_msgs.msg import Float64MultiArray
from tables import table

from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import Config

REPETITIONS = 20


def alone(points: int) -> float:
    """Return the time of one curve, ms."""
    estimator = Estimator(Config.from_mapping(UNITS))
    velocity = np.linspace(-0.15, 0.15, points)
    took = []
    for _ in range(REPETITIONS):
        begin = time.perf_counter()
        estimator.curve(None, velocity)
        took.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--round-seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    args = parser.parse_args()
    lines = []
    for listened in (False, True):
        runs = []
        for _ in range(args.rounds):
            with graph(Path(tempfile.mkdtemp())) as made:
                load = Load(made)
                process = made.start_node(deep=False)
                heard = made.hear(Float64MultiArray, "/friction_estimator/friction_curve", raw=True) if listened else []
                runs.append(load.run(process, args.rate, args.round_seconds) | {"curves": len(heard)})
                process.stop()
        middle = {k: statistics.median(r[k] for r in runs) for k in ("cpu_us", "p50_us", "p99_us", "curves")}
        lost = sum(r["sent"] - r["received"] for r in runs)
        lines.append(
            [
                "yes" if listened else "no",
                f"{middle['cpu_us']:.0f}",
                f"{middle['p50_us']:.0f}",
                f"{middle['p99_us']:.0f}",
                f"{middle['curves']:.0f}",
                lost,
            ]
        )
    header = ["listener", "CPU a pair (us)", "round trip p50 (us)", "p99 (us)", "curves", "samples lost"]
    write_section(
        "Curve",
        f"{args.rate:g} Hz pairs, rounds of {args.round_seconds:g} s, medians of {args.rounds}. "
        f"One curve of 401 velocities takes {alone(401):.1f} ms, one of 41, which the diagnostics need, "
        f"{alone(41):.1f} ms.\n\n" + table(header, lines),
    )


if __name__ == "__main__":
    main()
