"""Round trips at 1 kHz: the node beside a typed echo node, with nothing and with everything periodic going on.

python latency.py [--rounds 3] [--round-seconds 10] [--rate 1000] [--before COMMIT]

"Everything periodic": listeners of diagnostics, curve and parameters, parameters at 10 Hz, a save and a parameter
that is set every second. With --before the node of that commit is measured in the same turns: what has
changed since then in processor time and latency.
"""

import argparse
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common import HERE, Load, rows, write_section
from ros_graph import RELIABLE, UNITS, Graph, Process, graph

KEYS = ("cpu_us", "p50_us", "p99_us", "max_us")


def start(made: Graph, variant: str, before: Path | None) -> Process:
    if variant.startswith("echo"):
        process = made.start(str(HERE / "echo_node.py"), "events", "typed")
        process.says("listening")
        return process
    if variant == "node before":
        given = [word for name, value in (RELIABLE | UNITS).items() for word in ("-p", f"{name}:={value}")]
        code = f"import sys; sys.path.insert(0, {str(before)!r}); from friction_estimator.ros.node import main; main()"
        process = made.start("-c", code, "--ros-args", *given)
        process.says("listening", 300.0)
        return process
    if variant == "node, everything periodic":
        state = {"state.file": str(made.folder / "state.json"), "state.period": 1.0, "publish.parameters_rate": 10.0}
        return made.start_node(state, deep=False)
    return made.start_node(deep=False)


@contextmanager
def disturbed(made: Graph, variant: str) -> Iterator[None]:
    """Let another process listen to everything and set a parameter every second, where the variant says so."""
    if variant != "node, everything periodic":
        yield
        return
    process = made.start(str(HERE / "disturber.py"))
    process.says("disturbing")
    try:
        yield
    finally:
        process.stop()


def checked_out(commit: str) -> Path:
    """Return a folder with the package as it was at a commit."""
    folder = Path(tempfile.mkdtemp())
    archive = folder / "package.tar"
    root = HERE.parents[1]
    subprocess.run(["git", "archive", "-o", archive, commit, "friction_estimator"], cwd=root, check=True)
    shutil.unpack_archive(archive, folder, filter="data")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--round-seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--before")
    args = parser.parse_args()
    variants = ["echo, typed", "node", "node, everything periodic"]
    before = None
    if args.before:
        variants.insert(1, "node before")
        before = checked_out(args.before)
    results: dict[str, list[dict]] = {variant: [] for variant in variants}
    with graph(Path(tempfile.mkdtemp())) as made:
        load = Load(made)
        for _ in range(args.rounds):
            for variant in variants:
                process = start(made, variant, before)
                with disturbed(made, variant):
                    results[variant].append(load.run(process, args.rate, args.round_seconds))
                process.stop()
    middle = {v: {k: statistics.median(r[k] for r in runs) for k in KEYS} for v, runs in results.items()}
    lines = []
    for variant, runs in results.items():
        own, echo = middle[variant], middle["echo, typed"]
        lost = sum(r["sent"] - r["received"] for r in runs)
        lines.append(
            [
                variant,
                *(f"{own[k]:.0f}" for k in KEYS),
                *(f"{own[k] / echo[k]:.2f}" for k in ("cpu_us", "p99_us")),
                lost,
            ]
        )
    header = [
        "variant",
        "CPU a pair (us)",
        "p50 (us)",
        "p99 (us)",
        "max (us)",
        "CPU over echo",
        "p99 over echo",
        "lost",
    ]
    notes = [
        "Everything periodic costs the p99 a factor of "
        f"{middle['node, everything periodic']['p99_us'] / middle['node']['p99_us']:.2f}."
    ]
    if args.before:
        ratio = {k: middle["node"][k] / middle["node before"][k] for k in KEYS}
        notes.append(
            f"The node against that of {args.before}: CPU {ratio['cpu_us']:.2f}, p50 {ratio['p50_us']:.2f}, "
            f"p99 {ratio['p99_us']:.2f}."
        )
    write_section(
        "Latency",
        f"Round trips of {args.rate:g} Hz pairs, rounds of {args.round_seconds:g} s in turns, medians of {args.rounds} "
        "(the maximum too), law rls, model parallel, reliable on both sides.\n\n"
        + rows(header, lines)
        + "\n\n"
        + " ".join(notes),
    )


if __name__ == "__main__":
    main()
