"""How the benchmarks measure: what is compared takes turns, so that what else the machine does meets all of it alike.

Ratios are made within a round. Figures are kept round by round; `page` makes medians, ratios and ranges of them.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import linear_regression
from typing import Any, NamedTuple, TypeVar

import as_users

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = [sys.executable, "-m", "friction_estimator"]
DEMO = ROOT / "bags/demo"

Figure = TypeVar("Figure")

CHILD = (
    "import json,resource,subprocess,sys,time;t=time.perf_counter();"
    "subprocess.run(sys.argv[1:],check=True,stdout=subprocess.DEVNULL);"
    "t=time.perf_counter()-t;u=resource.getrusage(resource.RUSAGE_CHILDREN);"
    "print(json.dumps([u.ru_utime+u.ru_stime,t,u.ru_maxrss*1024/1e6]))"
)
"""A small process between: the peak memory of a child begins at its parent's."""


class Cost(NamedTuple):
    """Of a process and what it started: processor time and time by the clock, s, and the largest resident set, MB."""

    cpu: float
    clock: float
    memory: float


def in_turn(measurements: Mapping[str, Callable[[], Figure]], rounds: int, unkept: int = 1) -> dict[str, list[Figure]]:
    """Return the figures of each measurement, round by round.

    Parameters
    ----------
    unkept : rounds before, which fill the caches.
    """
    found: dict[str, list[Figure]] = {name: [] for name in measurements}
    for number in range(unkept + rounds):
        for name, measurement in measurements.items():
            figure = measurement()
            if number >= unkept:
                found[name].append(figure)
    return found


def cpu_us(body: Callable[[], object], count: int) -> Callable[[], float]:
    """Return a measurement: the processor time of a call over what it works off, us."""

    def measurement() -> float:
        begin = time.process_time()
        body()
        return 1e6 * (time.process_time() - begin) / count

    return measurement


def child(words: Sequence[str]) -> Cost:
    """Run a process; return what it costs."""
    done = subprocess.run([sys.executable, "-c", CHILD, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stderr[-2000:]}")
    return Cost(*json.loads(done.stdout))


def columns(costs: Sequence[Cost]) -> dict[str, list[float]]:
    """Return the figures of rounds by name."""
    return {name: list(column) for name, column in zip(Cost._fields, zip(*costs, strict=True), strict=True)}


def exponent(size: Sequence[float], cost: Sequence[float]) -> float:
    """Return the slope of log cost over log size (least squares) in the upper half of the sizes."""
    half = len(size) // 2 if len(size) > 2 else 0
    x, y = ([math.log(value) for value in values[half:]] for values in (size, cost))
    return linear_regression(x, y).slope


def part(measured: Callable[..., dict[str, Any]], about: str | None, **sizes: float) -> None:
    """Be the script of a part: take its sizes from the command line, measure, print the figures as JSON."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in sizes.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value, help="default: %(default)s")
    as_users.prepare()
    print(json.dumps(measured(**vars(parser.parse_args()))))
