"""What the node benchmarks share: the load they put on a node, and the table of those that are not of speed."""

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "test"), str(HERE.parent)]

import as_users  # noqa: E402 - after the path
import provenance  # noqa: E402
from geometry_msgs.msg import WrenchStamped  # noqa: E402
from ros_graph import Feeder, Graph, Process, await_, force, motion, qos  # noqa: E402

as_users.prepare()

PREDICTED = "/friction_estimator/friction_predicted"
TABLE = HERE / "table.md"
SECTIONS = ("Curve", "JointState", "Joints", "Endurance", "Endings", "Faults")


def write_section(title: str, text: str) -> None:
    """Replace one section of the table, under the commit and the command that it comes from; the others stay."""
    parts: dict[str, str] = {}
    if TABLE.exists():
        for piece in TABLE.read_text().split("\n## ")[1:]:
            name, _, body = piece.partition("\n")
            parts[name] = body.strip()
    command = " ".join(["python", f"benchmarks/node/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    parts[title] = f"{provenance.line(command)}\n{text.strip()}"
    head = (
        "# What the node was measured to do\n\nWritten by the scripts here; docs/node.md says how to read it; start, "
        "processor time and latency of the node are on the page of `make bench`. Each section names the commit and the "
        "command that it comes from; one that names none is older than this rule.\n"
    )
    # Sections of other scripts, and of former ones until their figures stand elsewhere, come first.
    ordered = sorted(parts, key=lambda name: SECTIONS.index(name) if name in SECTIONS else -1)
    TABLE.write_text(head + "".join(f"\n## {name}\n\n{parts[name]}\n" for name in ordered))
    print(f"## {title}\n\n{text.strip()}\n", flush=True)


Drive = Callable[[int, float], tuple[Any, Any, Any]]
"""Takes the number of samples and their rate (Hz); returns stamps (ns), velocity (m/s) and friction (N)."""


class Load:
    """Publishes pairs at a steady rate and keeps what comes back, with the time it took.

    Parameters
    ----------
    graph : with or without a node yet.
    """

    def __init__(self, graph: Graph) -> None:
        self.feeder = Feeder(graph)
        self._heard: list[tuple[bytes, int]] = []
        graph.probe.create_subscription(
            WrenchStamped,
            PREDICTED,
            lambda raw: self._heard.append((raw, time.perf_counter_ns())),
            qos(True, 10000),
            raw=True,
        )
        self._graph = graph

    def run(
        self, process: Process, rate_hz: float, seconds: float, offset: int = 0, drive: Drive = motion
    ) -> dict[str, Any]:
        """Load one node; return CPU, round trips, stamps and values of the predictions."""
        self.feeder.matched()
        await_(lambda: self._graph.probe.count_publishers(PREDICTED) == 1, "one publisher of predictions")
        time.sleep(1.0)  # let discovery calm down: it is not what is measured
        self._heard.clear()
        count = round(rate_hz * seconds)
        stamps, velocity, friction = drive(count, rate_hz)
        stamps = stamps + offset
        sent = np.zeros(count, np.int64)
        cpu = process.cpu_s()
        start = time.perf_counter_ns()
        step = 1e9 / rate_hz
        for k, (stamp, v, f) in enumerate(zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True)):
            while (wait := start + k * step - time.perf_counter_ns()) > 0:
                time.sleep(wait * 1e-9)
            sent[k] = time.perf_counter_ns()
            self.feeder.pair(stamp, v, f)
        took = (time.perf_counter_ns() - start) * 1e-9
        # Before anything is asked of the publishers: that keeps this process from hearing for up to a second.
        with contextlib.suppress(AssertionError):
            await_(lambda: len(self._heard) >= count, "all predictions", 5.0)
        cpu = process.cpu_s() - cpu
        found = [(*force(raw), arrived) for raw, arrived in self._heard]
        place = {stamp: k for k, stamp in enumerate(stamps.tolist())}
        trips = np.full(count, np.nan)
        for stamp, _, arrived in found:
            if (k := place.get(stamp)) is not None:
                trips[k] = 1e-3 * (arrived - sent[k])
        heard = trips[np.isfinite(trips)] if found else np.array([np.nan])
        return {
            "sent": count,
            "received": len(found),
            "in_order": [stamp for stamp, *_ in found] == sorted(stamp for stamp, *_ in found),
            "cpu_us": cpu / count * 1e6,
            "p50_us": float(np.median(heard)),
            "p99_us": float(np.percentile(heard, 99)),
            "max_us": float(heard.max()),
            "trip_us": trips,
            "took_s": took,
            "stamps": stamps,
            "velocity": velocity,
            "friction": friction,
            "predicted": np.array([value for _, value, _ in found]),
        }
