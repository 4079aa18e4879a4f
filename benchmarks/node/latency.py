"""Round trips at 1 kHz: the node with and without everything periodic, beside a typed echo node, in one run.

A part of `python benchmarks/bench.py`. Alone, beside the node of a former commit: python latency.py --before COMMIT

"Everything periodic": a save every second, listeners of diagnostics, curve and parameters, and a parameter that is set
every second. "Refits": a drive that runs up by a tenth a second, so that the range of the curve has to grow, and the
curve to be fitted anew over a larger one, about once a second. One node process a round is measured without and
with each, in turns that swap their order from round to round, so that what else the machine does meets both alike: the
factor is the median of these pairs. A refit takes milliseconds of a second, and a restless machine's p99 differs more
than that from round to round; so the rounds with refits are also compared with themselves, all of their pairs with
those that are not near a refit. With --before the node of that commit is measured in the same way, for what has changed
since then.
"""

import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, Load
from measure import part
from ros_graph import RELIABLE, UNITS, Graph, Process, graph, motion

from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import Config

ECHO = "echo, typed"
KEYS = ("cpu_us", "p50_us", "p99_us", "max_us", "sent", "received")

PAIRS = {"periodic": "quiet", "refits": "no refits"}
"""What is measured, and what without it."""

WORDS = {"quiet": "", "periodic": ", everything periodic", "no refits": ", range of its own", "refits": ", refits"}

STATE = {"state.period": 0.0}

OWN_RANGE = {
    "basis.velocity_range": [],
    "learned.velocity_range": [-0.15, 0.15],
    "learned.velocity_scale": 0.15,
    "theory.kind": "seal",
    "force_unit": 10.0,
}
"""The units of the other nodes, but the range may grow."""

CALM_S = 3.0
"""Time until the graph has settled: in the second after this process makes its first client of a service, it hears
nothing for 0.15 to 0.5 s in three of ten rounds, whatever the node does."""

FASTER = 1.1
"""Factor on the speed from second to second under refits."""

NEAR = slice(-20, 80)
"""Pairs about a refit, from the first one beyond the range, that what a refit takes may have made late."""


def start(made: Graph, before: Path | None, own_range: bool) -> Process:
    """Start the node, quiet: `periodic` sets going what it can do beside samples."""
    values = STATE | {"state.file": str(made.folder / f"state{len(made.processes)}.json")}
    units = OWN_RANGE if own_range else UNITS
    if before is None:
        return made.start_node(units | values, deep=False, units=False)
    given = [word for name, value in (RELIABLE | units | values).items() for word in ("-p", f"{name}:={value}")]
    code = f"import sys; sys.path.insert(0, {str(before)!r}); from friction_estimator.ros.node import main; main()"
    process = made.start("-c", code, "--ros-args", *given)
    process.says("listening", 300.0)
    return process


def faster_and_faster(count: int, rate_hz: float) -> tuple[Any, Any, Any]:
    """Return `motion`, a fifth beyond the range from the first second on and faster from second to second."""
    stamps, velocity, _ = motion(count, rate_hz)
    velocity = 1.8 * velocity * FASTER ** np.floor(np.arange(count) / rate_hz)
    return stamps, velocity, 4.0 * np.tanh(velocity / 0.004) + 12.0 * velocity


def near_refits(velocity: np.ndarray, friction: np.ndarray, reach: float | None) -> np.ndarray:
    """Return which pairs are near a refit; the estimator of this process grows at the same samples as the node's.

    Parameters
    ----------
    reach : of the node, afterwards; None for one of another commit, which may have grown some samples sooner or later.
    """
    estimator = Estimator(Config.from_mapping(OWN_RANGE))
    near = np.zeros(velocity.size, np.bool_)
    grown = 0
    for k, (v, f) in enumerate(zip(velocity.tolist(), friction.tolist(), strict=True)):
        estimator.step(stamp_ns=1 + k, velocity_m_s=v, friction_N=f)
        if estimator.health.grown > grown:
            grown = estimator.health.grown
            near[max(0, k + NEAR.start) : k + NEAR.stop] = True
    if reach not in (None, estimator.model.basis.reach[1]):
        raise RuntimeError(f"the node's range ends at {reach} m/s, that of the same samples here elsewhere")
    return near


@contextmanager
def periodic(made: Graph) -> Iterator[None]:
    """Have the state saved every second; let another process listen to everything and set a parameter every second."""
    made.call_set("/friction_estimator", state__period=1.0)
    process = made.start(str(HERE / "disturber.py"))
    process.says("disturbing")
    time.sleep(CALM_S)
    try:
        yield
    finally:
        process.stop()
        made.call_set("/friction_estimator", state__period=0.0)


def checked_out(commit: str) -> Path:
    """Return a folder with the package as it was at a commit."""
    folder = Path(tempfile.mkdtemp())
    archive = folder / "package.tar"
    root = HERE.parents[1]
    subprocess.run(["git", "archive", "-o", archive, commit, "friction_estimator"], cwd=root, check=True)
    shutil.unpack_archive(archive, folder, filter="data")
    return folder


def loaded(
    made: Graph, load: Load, drive_of: tuple[float, float], before: Path | None, turn: int, kinds: tuple[str, str]
) -> dict[str, dict]:
    """Return the figures of one node process without and with something, at a rate (Hz) for a time (s) each."""
    rate, round_seconds = drive_of
    process = start(made, before, own_range="refits" in kinds)
    found = {}
    for kind in kinds if turn % 2 == 0 else kinds[::-1]:
        # A stamp later than all before: one node sees both.
        offset = round((1 + len(found)) * (round_seconds + 10.0) * 1e9)
        drive = faster_and_faster if kind == "refits" else motion
        with periodic(made) if kind == "periodic" else nullcontext():
            found[kind] = load.run(process, rate, round_seconds, offset, drive)
        if kind == "refits":
            one = found[kind]
            one["reach"] = made.call_get("/friction_estimator", "learned.velocity_range")[1]
            one["near"] = near_refits(one["velocity"], one["friction"], None if before else one["reach"])
    process.stop()
    return found


def beside_themselves(found: list[dict]) -> dict[str, float]:
    """Return what refits cost by the pairs of the rounds with refits alone."""
    trips = np.concatenate([figures["trip_us"] for figures in found])
    near = np.concatenate([figures["near"] for figures in found])[np.isfinite(trips)]
    trips = trips[np.isfinite(trips)]
    rest = float(np.percentile(trips[~near], 99))
    return {
        "reach": statistics.median(figures["reach"] for figures in found),
        "pairs": trips.size,
        "near": int(near.sum()),
        "p99_us": float(np.percentile(trips, 99)),
        "rest_p99_us": rest,
        "near_p99_us": float(np.percentile(trips[near], 99)) if near.any() else float("nan"),
        "near_late": float(np.mean(trips[near] > rest)) if near.any() else float("nan"),
    }


def measured(rounds: int, round_seconds: float, rate: float, before: str) -> dict[str, Any]:
    nodes = {"node": None} | ({f"node of {before}": checked_out(before)} if before else {})
    runs: dict[str, list[dict]] = {ECHO: []}
    with graph(Path(tempfile.mkdtemp())) as made:
        load = Load(made)
        for turn in range(rounds):
            process = made.start(str(HERE / "echo_node.py"), "events", "typed")
            process.says("listening")
            runs[ECHO].append(load.run(process, rate, round_seconds))
            process.stop()
            for name, folder in nodes.items():
                for with_it, without in PAIRS.items():
                    found = loaded(made, load, (rate, round_seconds), folder, turn, (without, with_it))
                    for kind, figures in found.items():
                        runs.setdefault(f"{name}{WORDS[kind]}", []).append(figures)
    return {
        "rate_hz": rate,
        "round_seconds": round_seconds,
        "variants": {variant: {key: [run[key] for run in found] for key in KEYS} for variant, found in runs.items()},
        "costs": {
            f"{with_it} to the {name}": [f"{name}{WORDS[with_it]}", f"{name}{WORDS[without]}"]
            for name in nodes
            for with_it, without in PAIRS.items()
        },
        "refits": {name: beside_themselves(runs[f"{name}{WORDS['refits']}"]) for name in nodes},
    }


if __name__ == "__main__":
    part(measured, __doc__, rounds=9, round_seconds=6.0, rate=1000.0, before="")
