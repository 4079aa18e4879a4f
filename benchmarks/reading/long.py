"""Verbs on a long recording: speed beside the bare loop, memory, and how both grow.

A part of `python benchmarks/bench.py`. `replay` reads in one thread and learns in another, so it needs two free cores:
its share of the bare loop's speed is told by the clock. Start is what the same verb costs on bags/demo.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from measure import DEMO, PROGRAM, Cost, child, columns, in_turn, part
from recordings import driven

from friction_estimator.bag.write import write_samples

LOOP = """
import json, sys, time
from friction_estimator.bag.samples import read_samples
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.settings.config import Config
config = Config.from_mapping({"model.law": sys.argv[2]})
samples = read_samples(sys.argv[1], config)[1].samples
met = meet(config, samples).config
Estimator(met).run(samples[:5000])
clock, cpu = time.perf_counter(), time.process_time()
Estimator(met).run(samples)
print(json.dumps([time.process_time() - cpu, time.perf_counter() - clock, 0.0]))
"""

VERBS: dict[str, tuple[str, ...]] = {
    "replay, rls": ("replay", "--law", "rls"),
    "replay, lms": ("replay", "--law", "lms"),
    "replay --out": ("replay", "--out"),
    "info": ("info",),
    "identify --fit-only": ("identify", "--fit-only"),
    "identify": ("identify",),
}
"""Verbs and their options; --out is given a folder that is removed behind it."""

SIZES = (0.01, 0.03, 0.1, 0.3)
"""Shorter recordings, as shares of the long one."""


def bare_loop(path: Path, law: str) -> Cost:
    """Return the cost of the loop alone over the samples of a recording."""
    words = [sys.executable, "-c", LOOP, str(path), law]
    return Cost(*json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout))


def verb(name: str, path: Path) -> Cost:
    """Return the cost of a verb on a recording."""
    program, *options = VERBS[name]
    with TemporaryDirectory(dir=path.parent) as scratch:
        out = [str(Path(scratch) / "out")] if "--out" in options else []
        return child([*PROGRAM, program, str(path), *options, *out])


def measured(samples: int, rounds: int, keep: str = "") -> dict[str, Any]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # or waiting threads of a fit count as its processor time
    with TemporaryDirectory() as scratch:
        long = Path(keep or Path(scratch) / "long")
        if not long.exists():
            write_samples(long, driven(samples))
        parts = {}
        for share in SIZES:
            parts[round(share * samples)] = Path(scratch) / f"of{share}"
            write_samples(parts[round(share * samples)], driven(round(share * samples)))
        return {
            "samples": samples,
            "loops": {law: columns(costs) for law, costs in beside_the_loop(long, rounds).items()},
            "once": {name: columns(costs) for name, costs in in_turn(once(long), 1, unkept=0).items()},
            "growth": grown(parts),
        }


def beside_the_loop(long: Path, rounds: int) -> dict[str, list[Cost]]:
    """Return the costs of bare loop, start and whole by law."""
    measurements: dict[str, Callable[[], Cost]] = {}
    for law in ("rls", "lms"):
        name = f"replay, {law}"
        measurements |= {
            f"bare loop, {law}": lambda law=law: bare_loop(long, law),
            f"start of {name}": lambda name=name: verb(name, DEMO),
            name: lambda name=name: verb(name, long),
        }
    return in_turn(measurements, rounds, unkept=0)


def once(long: Path) -> dict[str, Callable[[], Cost]]:
    """Return what is measured once: the memory of verbs, and their time."""
    names = ("info", "identify --fit-only", "identify", "replay --out")
    return {
        f"{before}{name}": lambda name=name, path=path: verb(name, path)
        for name in names
        for before, path in (("start of ", DEMO), ("", long))
    }


def grown(parts: dict[int, Path]) -> dict[str, Any]:
    """Return by verb the costs over the number of samples, and of the start."""
    found: dict[str, Any] = {"samples": list(parts)}
    for name in ("replay, rls", "replay --out"):
        costs = in_turn({path: lambda name=name, path=path: verb(name, path) for path in (DEMO, *parts.values())}, 2, 0)
        found[name] = {"start": columns(costs[DEMO]), "sizes": [columns(costs[path]) for path in parts.values()]}
    return found


if __name__ == "__main__":
    part(measured, __doc__, samples=10_000_000, rounds=3, keep="")
