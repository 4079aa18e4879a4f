"""Round trips at 1 kHz: the node with and without everything periodic, beside a typed echo node, in one run.

python latency.py [--rounds 8] [--round-seconds 6] [--rate 1000] [--before COMMIT]

"Everything periodic": a save every second, listeners of diagnostics, curve and parameters, and a parameter that is set
every second. One node process a round is measured without and with it, in turns that swap their order from round to
round, so that what else the machine does meets both alike: the factor is the median of these pairs. With --before the
node of that commit is measured in the same way: what has changed since then.
"""

import argparse
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from common import HERE, Load, rows, write_section
from ros_graph import RELIABLE, UNITS, Graph, Process, graph

KEYS = ("cpu_us", "p50_us", "p99_us", "max_us")


STATE = {"state.period": 0.0}


def start(made: Graph, before: Path | None) -> Process:
    """Start the node, quiet: `periodic` sets going what it can do beside samples."""
    values = STATE | {"state.file": str(made.folder / f"state{len(made.processes)}.json")}
    if before is None:
        return made.start_node(values, deep=False)
    given = [word for name, value in (RELIABLE | UNITS | values).items() for word in ("-p", f"{name}:={value}")]
    code = f"import sys; sys.path.insert(0, {str(before)!r}); from friction_estimator.ros.node import main; main()"
    process = made.start("-c", code, "--ros-args", *given)
    process.says("listening", 300.0)
    return process


@contextmanager
def periodic(made: Graph) -> Iterator[None]:
    """Have the state saved every second; let another process listen to everything and set a parameter every second."""
    made.call_set("/friction_estimator", state__period=1.0)
    process = made.start(str(HERE / "disturber.py"))
    process.says("disturbing")
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


def measured(made: Graph, load: Load, args: argparse.Namespace, before: Path | None, turn: int) -> dict[str, dict]:
    """Return the figures of one node process without and with everything periodic."""
    process = start(made, before)
    found = {}
    for kind in ("quiet", "periodic") if turn % 2 == 0 else ("periodic", "quiet"):
        # A stamp later than all before: one node sees both.
        offset = round((1 + len(found)) * (args.round_seconds + 10.0) * 1e9)
        with periodic(made) if kind == "periodic" else nullcontext():
            found[kind] = load.run(process, args.rate, args.round_seconds, offset)
    process.stop()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--round-seconds", type=float, default=6.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--before")
    args = parser.parse_args()
    nodes = {"node": None} | ({f"node of {args.before}": checked_out(args.before)} if args.before else {})
    echo: list[dict] = []
    runs: dict[str, dict[str, list[dict]]] = {name: {"quiet": [], "periodic": []} for name in nodes}
    with graph(Path(tempfile.mkdtemp())) as made:
        load = Load(made)
        for turn in range(args.rounds):
            process = made.start(str(HERE / "echo_node.py"), "events", "typed")
            process.says("listening")
            echo.append(load.run(process, args.rate, args.round_seconds))
            process.stop()
            for name, before in nodes.items():
                for kind, figures in measured(made, load, args, before, turn).items():
                    runs[name][kind].append(figures)

    def middle(found: list[dict], key: str) -> float:
        return statistics.median(figures[key] for figures in found)

    def line(name: str, found: list[dict]) -> list[object]:
        figures = [f"{middle(found, key):.0f}" for key in KEYS]
        beside = [f"{middle(found, key) / middle(echo, key):.2f}" for key in ("cpu_us", "p99_us")]
        return [name, *figures, *beside, sum(r["sent"] - r["received"] for r in found)]

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
    lines, notes = [line("echo, typed", echo)], []
    for name, kinds in runs.items():
        lines += [line(name, kinds["quiet"]), line(f"{name}, everything periodic", kinds["periodic"])]
        pairs = list(zip(kinds["periodic"], kinds["quiet"], strict=True))
        factors = {key: sorted(with_it[key] / without[key] for with_it, without in pairs) for key in KEYS[1:]}
        told = ", ".join(
            f"{key.removesuffix('_us')} {statistics.median(f):.2f} ({f[0]:.2f} to {f[-1]:.2f})"
            for key, f in factors.items()
        )
        notes.append(f"What everything periodic costs the {name}, median and range of {args.rounds} pairs: {told}.")
    if args.before:
        former = runs[f"node of {args.before}"]["quiet"]
        ratio = {key: middle(runs["node"]["quiet"], key) / middle(former, key) for key in KEYS}
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
