"""Nodes stopped and killed at random moments.

python endings.py [--signals 100] [--kills 50]
"""

import argparse
import signal
import tempfile
from pathlib import Path

from common import write_section
from ros_graph import graph
from ros_lifecycle import kill_at_random, stop_at_random
from tables import table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--signals", type=int, default=100)
    parser.add_argument("--kills", type=int, default=50)
    args = parser.parse_args()
    lines, complaints = [], []
    for number in (signal.SIGINT, signal.SIGTERM):
        with graph(Path(tempfile.mkdtemp())) as made:
            endings = stop_at_random(made, number, args.signals, seed=number)
        zero = sum(code == 0 for code in endings.codes)
        slow = max(endings.seconds)
        lines.append([number.name, args.signals, zero, f"{slow:.2f}", len(endings.faults)])
        complaints += endings.faults
    with graph(Path(tempfile.mkdtemp())) as made:
        faults = kill_at_random(made, args.kills, seed=9)
    lines.append(["SIGKILL", args.kills, "-", "-", len(faults)])
    complaints += faults
    header = ["signal", "runs", "exit code 0", "slowest end (s)", "faults (state file included)"]
    write_section("Endings", table(header, lines) + "".join(f"\n\n```\n{text}\n```" for text in complaints[:5]))


if __name__ == "__main__":
    main()
