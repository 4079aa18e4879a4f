"""Reading beside rosbags' own loop, memory and speed of the verbs on a long recording, and start-up.

    python benchmarks/reading/run.py [--samples 10000000] [--pairs 1000000] [--keep FOLDER]

Times are processor time, of reading the least of some runs, else medians of rounds in turns; for the verbs on a long
recording beside it time by the clock: `replay` reads in one thread and learns in another, so it needs two free cores.
Every ratio is of one run of this script. Memory is the largest resident set of the process (`ru_maxrss`). Writes
README.md beside this file.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.write import write_samples
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.output.target import write_text

sys.path.append(str(Path(__file__).resolve().parents[1]))
import as_users
import provenance

HERE = Path(__file__).parent
PYTHON = sys.executable
PROGRAM = [PYTHON, "-m", "friction_estimator"]
DEMO = HERE.parents[1] / "bags/demo"
RUNS = 3
START_ROUNDS = 9

LONG = [
    "verb", "s", "s by the clock", "samples/s", "share", "share by the clock", "with its start", "memory, MB",
    "bytes a sample",
]  # fmt: skip

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
begin = time.process_time()
Estimator(met).run(samples)
print(json.dumps(time.process_time() - begin))
"""


def driven(n: int) -> Samples:
    """Return a shaft that swings at 0.5 Hz, 1 kHz, with friction of Coulomb, Stribeck and viscous kind and noise."""
    k = np.arange(n)
    time_s = 1e-3 * k
    velocity = 0.05 * np.sin(np.pi * time_s) * (1.0 + 0.5 * np.sin(0.2 * time_s))
    friction = 12.0 * np.tanh(velocity / 0.002) * (1.0 + 0.4 * np.exp(-((velocity / 0.01) ** 2))) + 80.0 * velocity
    friction += 0.1 * np.random.default_rng(1).standard_normal(n)
    return Samples(1_700_000_000 * NS_PER_S + 1_000_000 * k, velocity, friction, k == 0)


def rosbags_loop(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and values of velocity and friction, read as rosbags' documentation reads them."""
    rows: dict[str, list[tuple[int, float]]] = {"/velocity": [], "/friction": []}
    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in rows]
        for connection, _, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
            own = message.twist.linear.x if connection.topic == "/velocity" else message.wrench.force.x
            rows[connection.topic].append((stamp, own))
    return np.array(rows["/velocity"]), np.array(rows["/friction"])


def least(work: object, runs: int = RUNS) -> float:
    """Return the least processor time of a call, s."""
    times = []
    for _ in range(runs):
        begin = time.process_time()
        work()  # type: ignore[operator]
        times.append(time.process_time() - begin)
    return min(times)


def reading(folder: Path, pairs: int) -> list[list[str]]:
    """Return rows: storage, ours, rosbags', ratio, bound."""
    rows = []
    for storage, bound in (("mcap", "25"), ("sqlite3", "12")):
        path = folder / storage
        write_samples(path, driven(pairs), storage)
        ours = least(lambda path=path: read_recording(path))
        theirs = least(lambda path=path: rosbags_loop(path), 1)
        opened = least(lambda path=path: AnyReader([path]).open())
        figures = [f"{1e6 * figure / pairs:.3f}" for figure in (ours, theirs, opened)]
        rows.append([storage, *figures, f"{theirs / ours:.1f}", bound])
    return rows


class Cost(NamedTuple):
    """Processor time and time by the clock, s, and the largest resident set, MB."""

    cpu: float
    clock: float
    memory: float


def child(words: list[str], out: Path) -> Cost:
    """Run a process; return what it costs."""
    script = (
        "import json,resource,subprocess,sys,time;t=time.perf_counter();"
        "subprocess.run(sys.argv[2:],check=True,stdout=subprocess.DEVNULL,stderr=subprocess.DEVNULL);"
        "t=time.perf_counter()-t;u=resource.getrusage(resource.RUSAGE_CHILDREN);"
        "open(sys.argv[1],'w').write(json.dumps([u.ru_utime+u.ru_stime,t,u.ru_maxrss*1024/1e6]))"
    )
    subprocess.run([PYTHON, "-c", script, str(out), *words], check=True)
    return Cost(*json.loads(out.read_text()))


def verbs(folder: Path, samples: int, keep: Path | None) -> list[list[str]]:
    """Return rows: verb, two times, samples a second and shares of the bare loop's, memory, bytes a sample."""
    path, out = keep or folder / "long", folder / "figures.json"
    if not path.exists():
        write_samples(path, driven(samples))
    rows = []
    for law in ("rls", "lms"):
        words = [*PROGRAM, "replay", str(path), "--law", law]
        # In turns, so that each is compared with what the machine could do at that moment.
        turns = [(bare_loop(path, law), *started_and_whole(words, out)) for _ in range(RUNS)]
        loop = statistics.median(loop for loop, _, _ in turns)
        rows.append(
            [f"bare loop, {law}", f"{loop:.1f}", f"{loop:.1f}", f"{samples / loop:.3g}", "1", "1", "1", "-", "-"]
        )
        rows.append(row(f"replay, {law}", samples, turns))
    for name, words in (
        ("info", [*PROGRAM, "info", str(path)]),
        ("identify --fit-only", [*PROGRAM, "identify", str(path), "--fit-only"]),
    ):
        rows.append(row(name, samples, [(None, *started_and_whole(words, out))]))
    return rows


def bare_loop(path: Path, law: str) -> float:
    """Return the processor time of the loop over the samples of a recording, s."""
    words = [PYTHON, "-c", LOOP, str(path), law]
    printed = subprocess.run(words, check=True, capture_output=True, text=True)
    return float(printed.stdout)


def started_and_whole(words: list[str], out: Path) -> tuple[Cost, Cost]:
    """Return what a verb costs on bags/demo, which is its start, and on its recording."""
    return child([*words[:4], str(DEMO), *words[5:]], out), child(words, out)


def row(name: str, samples: int, turns: list[tuple[float | None, Cost, Cost]]) -> list[str]:
    """Return a row of the medians of turns: the bare loop, the start, the whole."""

    def median(of: Callable[[Cost, Cost], float]) -> float:
        return statistics.median(of(start, whole) for _, start, whole in turns)

    def share(of: Callable[[Cost, Cost], float]) -> str:
        shares = [loop / of(start, whole) for loop, start, whole in turns if loop is not None]
        return f"{statistics.median(shares):.2f}" if shares else "-"

    per_sample = median(lambda start, whole: whole.memory - start.memory) / samples
    return [
        name,
        f"{median(lambda _, whole: whole.cpu):.1f}",
        f"{median(lambda _, whole: whole.clock):.1f}",
        f"{samples / median(lambda start, whole: whole.clock - start.clock):.3g}",
        share(lambda start, whole: whole.cpu - start.cpu),
        share(lambda start, whole: whole.clock - start.clock),
        share(lambda _, whole: whole.clock),
        f"{max(whole.memory for _, _, whole in turns):.0f}",
        f"{1e6 * per_sample:.0f}",
    ]


def start_up() -> list[list[str]]:
    """Return rows: command, time, ratio to the import of rosbags and numpy, bound."""
    wanted = {
        "import rosbags.highlevel, numpy": ([PYTHON, "-c", "import rosbags.highlevel, numpy"], "1"),
        "import friction_estimator": ([PYTHON, "-c", "import friction_estimator"], "0.3"),
        "import numba": ([PYTHON, "-c", "import numba"], "-"),
        "--help": ([*PROGRAM, "--help"], "0.7"),
        "info of bags/demo": ([*PROGRAM, "info", str(DEMO)], "4"),
        "replay of bags/demo": ([*PROGRAM, "replay", str(DEMO)], "-"),
    }
    with TemporaryDirectory() as scratch:
        out = Path(scratch) / "figures.json"
        # In turns, so that each is compared with what the machine could do then; the first round fills the caches.
        rounds = [[child(words, out) for words, _ in wanted.values()] for _ in range(START_ROUNDS + 1)][1:]
    rows = []
    for (name, (_, bound)), runs in zip(wanted.items(), zip(*rounds, strict=True), strict=True):
        ratio = statistics.median(one.cpu / whole[0].cpu for one, whole in zip(runs, rounds, strict=True))
        cpu, memory = statistics.median(one.cpu for one in runs), max(one.memory for one in runs)
        rows.append([name, f"{cpu:.3f}", f"{ratio:.2f}", bound, f"{memory:.0f}"])
    return rows


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--pairs", type=int, default=1_000_000)
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the long recording there, or take it from there"
    )
    args = parser.parse_args()
    as_users.prepare()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        started = start_up()
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # or waiting threads of a fit count as its processor time
        read = reading(folder, args.pairs)
        long = verbs(folder, args.samples, args.keep)
    command = f"python benchmarks/reading/run.py --samples {args.samples} --pairs {args.pairs}"
    page = f"""# Reading, memory, start-up

{provenance.line(command)}
Processor time, the clock only where it is named; memory is the largest resident set. docs/decisions/0120, 0121, 0145
and 0146 say what the figures led to.

## Pairs of velocity and friction into arrays, {args.pairs} of them

Microseconds a pair. Opening a file is part of both ways; rosbags counts the messages of a .db3 file when it opens it.

{table(["storage", "here", "rosbags' loop", "opening alone, rosbags", "ratio", "at least"], read)}

## A recording of {args.samples} samples (mcap)

Samples a second by the clock, and the share of the bare loop's speed by processor time and by the clock, without the
start of the program (that of bags/demo), and by the clock with it. `replay` reads, and says what does not depend on the
prediction, in a thread beside the one that learns. It writes nothing here: with `--out` it holds what it writes,
1.05 GB for 3,000,000 samples and 0.5 GB for 1,000,000 (commit 079911b).

{table(LONG, long)}

## Start-up

{table(["command", "s", "ratio", "at most", "memory, MB"], started)}
"""
    write_text(HERE / "README.md", page)
    print(page)


if __name__ == "__main__":
    main()
