"""1 kHz pairs between two processes: loss, bit equality with replay, round trip and CPU beside echo nodes.

A part of `python benchmarks/bench.py`.
"""

# ruff: noqa: E402 - the number of threads is set before numpy comes in
import tempfile
from pathlib import Path
from typing import Any

from friction_estimator.threads import one_thread

one_thread()  # as the node does, or the replay beside it differs in last bits

import numpy as np
from common import HERE, Load
from measure import in_turn, part
from ros_graph import RELIABLE, UNITS, Graph, Process, graph

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.settings.config import Config

VARIANTS = ("node", "echo, raw, events", "echo, typed, events", "node, stock executor", "echo, typed, single")
FIGURES = ("cpu_us", "p50_us", "p99_us", "sent", "received")


def start(made: Graph, variant: str) -> Process:
    if variant == "node":
        return made.start_node(deep=False)
    if variant == "node, stock executor":
        ros = [word for name, value in (RELIABLE | UNITS).items() for word in ("-p", f"{name}:={value}")]
        process = made.start(str(HERE / "stock_node.py"), "--ros-args", *ros)
    else:
        kind, executor = variant.removeprefix("echo, ").split(", ")
        process = made.start(str(HERE / "echo_node.py"), executor, kind)
    process.says("listening")
    return process


def replayed(stamps: np.ndarray, velocity: np.ndarray, friction: np.ndarray) -> np.ndarray:
    events = np.stack([velocity, friction], 1).ravel()
    samples = Intake(Config()).push(np.tile([0, 1], stamps.size), np.repeat(stamps, 2), events)
    return Estimator(meet(Config(), samples).config).run(samples)


def measured(seconds: float, rounds: int, round_seconds: float, rate: float) -> dict[str, Any]:
    with graph(Path(tempfile.mkdtemp())) as made:
        load = Load(made)

        def loaded(variant: str) -> dict[str, Any]:
            process = start(made, variant)
            found = load.run(process, rate, round_seconds)
            process.stop()
            return {key: found[key] for key in FIGURES}

        runs = in_turn({variant: (lambda variant=variant: loaded(variant)) for variant in VARIANTS}, rounds, unkept=0)
        process = made.start_node(deep=False, units=False)
        long = load.run(process, rate, seconds)
        code = process.stop()
    expected = replayed(long["stamps"], long["velocity"], long["friction"])
    return {
        "rate_hz": rate,
        "round_seconds": round_seconds,
        "variants": {name: {key: [run[key] for run in found] for key in FIGURES} for name, found in runs.items()},
        "unconfigured": {key: long[key] for key in ("sent", "received", "in_order", "took_s")}
        | {"seconds": seconds, "equal": bool(np.array_equal(long["predicted"], expected)), "exit_code": code},
    }


if __name__ == "__main__":
    part(measured, __doc__, seconds=60.0, rounds=15, round_seconds=10.0, rate=1000.0)
