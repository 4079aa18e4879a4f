"""What a second process is worth to `sweep` and `diagnose --each`, and a Dask cluster, and whether it changes a bit.

Beside it what the machine gives: the verb on one process twice at once, two that share nothing but the machine. Two
cores that share caches, memory or a clock limit do less than twice the work of one, whoever hands it out.

A part of `python benchmarks/bench.py`: 64 configurations over three recordings of 60 s at 1 kHz, and a fleet of 16
recordings of 64 s at 100 Hz, of which fewer are diagnosed, too. All take turns. The cluster is a scheduler and two
workers of one thread, each a process of its own, which have computed the verb once before; it is there for its own
measurements only, since one that waits for work takes a twelfth of a core.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Client
from measure import PROGRAM, ROOT, Cost, child, columns, in_turn, part

sys.path.append(str(ROOT / "test"))
from dask_cluster import cluster

GRID = {
    "fir.order": "0,4,8,16",
    "prior.tap_deviation": "0.05,0.1,0.2,0.4",
    "prior.weight_slope": "1,1.5,2,2.5",
}
PLANTS = ("rig", "tabulated", "film_lag")
FLEET_DRIVE = ("--schedule", "1:50:12,5:200:20,5:50:20,1:200:12", "--rate", "100", "--plant", "clean")
FLEET_S = 64
DASK_WORKERS = 2
WORKERS = [count for count in (1, 2, 4, 8) if count <= max(2, os.cpu_count() or 1)]


def simulated(folder: Path, wanted: list[list[str]]) -> list[str]:
    """Simulate recordings; return their paths."""
    folder.mkdir()
    paths = [str(folder / f"recording{k:02d}") for k in range(len(wanted))]
    for path, words in zip(paths, wanted, strict=True):
        subprocess.run([*PROGRAM, "simulate", *words, "--out", path], check=True, stdout=subprocess.DEVNULL)
    return paths


class Verb:
    """A verb whose rows are to be the same wherever they are computed."""

    def __init__(self, words: list[str], folder: Path) -> None:
        self._words, self._folder = words, folder
        self._rows: set[bytes] = set()

    def on(self, *where: str) -> Callable[[], Cost]:
        """Return a measurement of the verb with the words that say where it is computed."""

        def measurement() -> Cost:
            with TemporaryDirectory(dir=self._folder) as scratch:
                out = Path(scratch) / "out"
                cost = child([*PROGRAM, *self._words, *where, "--out", str(out)])
                self._rows.add((out / "rows.jsonl").read_bytes())
            return cost

        return measurement

    def on_cluster(self) -> Cost:
        """Measure the verb on a Dask cluster whose workers have loaded what it needs."""
        with TemporaryDirectory(dir=self._folder) as scratch, cluster(Path(scratch), DASK_WORKERS) as (address, _):
            with Client(address) as client:
                client.wait_for_workers(DASK_WORKERS)
            measurement = self.on("--scheduler", address)
            measurement()
            return measurement()

    def twice(self) -> Cost:
        """Measure the verb on one process, started twice at once: until both have ended."""
        alone = self.on("--workers", "1")
        with ThreadPoolExecutor(2) as threads:
            first, second = threads.map(lambda _: alone(), range(2))
        cpu, memory = first.cpu + second.cpu, first.memory + second.memory
        return Cost(cpu, max(first.clock, second.clock), memory)

    @property
    def equal(self) -> bool:
        """Whether all rows so far were the same to the bit."""
        return len(self._rows) == 1


def measured(rounds: int, seconds: int, settings: int, fleet: int) -> dict[str, Any]:
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        plants = [["--schedule", f"5:50:{seconds}", "--rate", "1000", "--plant", plant] for plant in PLANTS]
        effects = [["--seed", str(k), "--effect", f"inertia:mass={0.05 + 0.01 * k:g}"] for k in range(fleet)]
        long = simulated(folder / "long", plants)
        short = simulated(folder / "fleet", [[*FLEET_DRIVE, *effect] for effect in effects])
        grid = [f"{name}={','.join(values.split(',')[:settings])}" for name, values in GRID.items()]
        sets = [word for value in grid for word in ("--set", value)]
        verbs = {
            "sweep": Verb(["sweep", *long, *sets], folder),
            "diagnose --each": Verb(["diagnose", *short, "--each"], folder),
        }
        counts = [fleet >> k for k in (3, 2, 1) if fleet >> k > 0]
        measurements = {}
        for name, verb in verbs.items():
            measurements |= {(name, workers): verb.on("--workers", str(workers)) for workers in WORKERS}
            measurements[name, "dask"] = verb.on_cluster
            measurements[name, "twice"] = verb.twice
        for count in counts:
            part_of = Verb(["diagnose", *short[:count], "--each"], folder)
            measurements["recordings", count] = part_of.on("--workers", "1")
        found = {key: columns(costs) for key, costs in in_turn(measurements, rounds, unkept=0).items()}
    whole = found["diagnose --each", 1]
    about = {
        "sweep": f"{settings**3} configurations, {len(PLANTS)} recordings of {seconds} s at 1 kHz",
        "diagnose --each": f"{fleet} recordings of {FLEET_S} s at 100 Hz",
    }
    return {
        "dask_workers": DASK_WORKERS,
        "verbs": {
            name: {
                "what": about[name],
                "equal": verb.equal,
                "workers": WORKERS,
                "processes": [found[name, workers] for workers in WORKERS],
                "dask": found[name, "dask"],
                "twice": found[name, "twice"],
            }
            for name, verb in verbs.items()
        },
        "recordings": {"size": [*counts, fleet], "costs": [*(found["recordings", count] for count in counts), whole]},
    }


if __name__ == "__main__":
    part(measured, __doc__, rounds=3, seconds=60, settings=4, fleet=16)
