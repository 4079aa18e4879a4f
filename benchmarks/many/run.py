"""What a second process is worth to `sweep` and `diagnose --each`, and whether it changes a bit.

    python benchmarks/many/run.py

64 configurations over three recordings of 60 s at 1 kHz, and a fleet of 16 recordings: each with one process and with
two in turn, `ROUNDS` times; the ratio is the median of those of the rounds. Run it with nothing beside it. Writes
README.md beside this file.
"""

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from friction_estimator.output.target import write_text

sys.path.append(str(Path(__file__).resolve().parents[1]))
import as_users
import provenance

HERE = Path(__file__).parent
PROGRAM = [sys.executable, "-m", "friction_estimator"]

GRID = (
    *("--set", "fir.order=0,4,8,16"),
    *("--set", "prior.tap_deviation=0.05,0.1,0.2,0.4"),
    *("--set", "prior.weight_slope=1,1.5,2,2.5"),
)
RECORDINGS = [
    ["--schedule", "5:50:60", "--rate", "1000", "--plant", plant] for plant in ("rig", "tabulated", "film_lag")
]
FLEET_DRIVE = ("--schedule", "1:50:12,5:200:20,5:50:20,1:200:12", "--rate", "100", "--plant", "clean")
FLEET = [[*FLEET_DRIVE, "--seed", str(k), "--effect", f"inertia:mass={0.05 + 0.01 * k:g}"] for k in range(16)]
BOUND = 1.8


def simulated(folder: Path, wanted: list[list[str]]) -> list[str]:
    """Simulate recordings; return their paths."""
    paths = [str(folder / f"recording{k:02d}") for k in range(len(wanted))]
    for path, words in zip(paths, wanted, strict=True):
        subprocess.run([*PROGRAM, "simulate", *words, "--out", path], check=True, stdout=subprocess.DEVNULL)
    return paths


def timed(words: list[str], workers: int, out: Path) -> tuple[float, float]:
    """Run a verb; return wall-clock and processor time, s."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [*PROGRAM, *words, "--workers", str(workers), "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(what: str, words: list[str], folder: Path, rounds: int) -> list[str]:
    """Return a row of the page."""
    times: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
    same = True
    for number in range(rounds):
        outs = {workers: folder / f"{words[0]}_{number}_{workers}" / "out" for workers in times}
        for workers, out in outs.items():
            out.parent.mkdir()
            times[workers].append(timed(words, workers, out))
        rows = [(out / "rows.jsonl").read_bytes() for out in outs.values()]
        same &= rows[0] == rows[1]
    (one, one_cpu), (two, two_cpu) = (map(median, zip(*times[workers], strict=True)) for workers in (1, 2))
    ratio = median(a[0] / b[0] for a, b in zip(times[1], times[2], strict=True))
    figures = f"{one:.1f} ({one_cpu:.1f})", f"{two:.1f} ({two_cpu:.1f})", f"{ratio:.2f}", f"{BOUND}"
    return [what, *figures, "equal" if same else "**they differ**"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    as_users.prepare()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "long").mkdir()
        (folder / "fleet").mkdir()
        long, fleet = simulated(folder / "long", RECORDINGS), simulated(folder / "fleet", FLEET)
        head = ["what", "one process, s (CPU)", "two, s (CPU)", "ratio", "at least", "rows"]
        rows = [
            head,
            ["---"] * len(head),
            measured("sweep: 64 settings, 3 recordings of 60 s at 1 kHz", ["sweep", *long, *GRID], folder, rounds),
            measured("diagnose --each: 16 of 64 s at 100 Hz", ["diagnose", *fleet, "--each"], folder, rounds),
        ]
    page = "\n".join("| " + " | ".join(row) + " |" for row in rows)
    command = f"python benchmarks/many/run.py --rounds {rounds}"
    write_text(HERE / "README.md", f"# Many recordings on two processes\n\n{provenance.line(command)}\n{page}\n")
    print(page)


if __name__ == "__main__":
    main()
