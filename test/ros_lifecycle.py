"""Nodes that are stopped and killed at random moments; shared by the tests and benchmarks/node."""

import random
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ros_graph import Feeder, Graph, await_, motion

from friction_estimator.ros.state import read_state


@dataclass
class Endings:
    """What became of the nodes: seconds to end, exit codes, and what was wrong."""

    seconds: list[float]
    codes: list[int]
    faults: list[str]


def stop_at_random(graph: Graph, number: int, count: int, seed: int, *, longest_wait_s: float = 2.5) -> Endings:
    """Start nodes, send each a signal at a random moment after its first line of output, judge the end.

    Half of them are fed while they run, so that there is a state to save.
    """
    rng = random.Random(seed)
    endings = Endings([], [], [])
    stamps, velocity, friction = motion(400_000, 1000.0)
    feeder = Feeder(graph)
    for run in range(count):
        state = graph.folder / f"state_{number}_{run}.json"
        process = graph.start_node({"state.file": str(state), "state.period": 0.2}, ready=False)
        await_(lambda p=process: p.log.stat().st_size > 0, "a first line of output")
        until = time.perf_counter() + rng.choice([0.02, 0.3, longest_wait_s]) * rng.random()
        k = 1000 * run
        while time.perf_counter() < until:
            feeder.pair(int(stamps[k]), velocity[k], friction[k])
            k += 1
            time.sleep(0.001)
        begin = time.perf_counter()
        process.popen.send_signal(number)
        try:
            code = process.popen.wait(30.0)
        except Exception:
            process.popen.kill()
            code = -9
        endings.seconds.append(time.perf_counter() - begin)
        endings.codes.append(code)
        output = process.output()
        if code or "Traceback" in output or "Error" in output:
            endings.faults.append(f"run {run}: code {code}\n{output}")
        endings.faults += judge(state, run)
    return endings


def judge(state: Path, run: int) -> list[str]:
    """Return what is wrong with what a node left on disk."""
    faults = []
    if state.exists():
        try:
            read_state(state)
        except Exception as error:
            faults.append(f"run {run}: {error}")
    return faults


def kill_at_random(graph: Graph, count: int, seed: int) -> list[str]:
    """Kill nodes that save all the time; return what was wrong with what the next one restored."""
    rng = random.Random(seed)
    faults = []
    feeder = Feeder(graph)
    stamps, velocity, friction = motion(400_000, 1000.0)
    state = graph.folder / "killed.json"
    parameters = {"state.file": str(state), "state.period": 0.02}
    k = 0
    least = -1
    for run in range(count):
        process = graph.start_node(parameters)
        output = process.output()
        if state.exists() and least >= 0:
            restored = [line for line in output.splitlines() if "restored" in line]
            if not restored or "starting cold" in output:
                faults.append(f"run {run}: the state was not restored:\n{output}")
        until = time.perf_counter() + 0.1 + 1.4 * rng.random()
        while time.perf_counter() < until:
            feeder.pair(int(stamps[k]), velocity[k], friction[k])
            k += 1
            time.sleep(0.001)
        process.popen.send_signal(signal.SIGKILL)
        process.popen.wait(30.0)
        if state.exists():
            try:
                kept = read_state(state)["arrays"]
            except Exception as error:
                faults.append(f"run {run}: {error}")
                continue
            samples = int(kept["status"][1])
            if samples < least:
                faults.append(f"run {run}: {samples} samples after {least}: not the last complete state")
            if not all(np.isfinite(array).all() for array in kept.values()):
                faults.append(f"run {run}: values that are not finite")
            least = samples
    leftovers = list(graph.folder.glob(".killed.json*"))
    if len(leftovers) > 1:
        faults.append(f"{len(leftovers)} temporary folders left")
    return faults
