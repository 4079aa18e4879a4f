"""1 kHz pairs between two processes: loss, bit equality with replay, round trip and CPU beside echo nodes.

python pairs.py [--seconds 60] [--rounds 7] [--round-seconds 10]
"""

# ruff: noqa: E402 - the number of threads is set before numpy comes in
import argparse
import statistics
import tempfile
from pathlib import Path

from friction_estimator.threads import one_thread

one_thread()  # as the node does, or the replay beside it differs in last bits

import numpy as np
from common import HERE, Load, rows, write_section
from ros_graph import RELIABLE, UNITS, Graph, Process, graph

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.settings.config import Config


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--round-seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    args = parser.parse_args()
    variants = ["node", "echo, raw, events", "echo, typed, events", "node, stock executor", "echo, typed, single"]
    results: dict[str, list[dict]] = {variant: [] for variant in variants}
    with graph(Path(tempfile.mkdtemp())) as made:
        load = Load(made)
        for _ in range(args.rounds):
            for variant in variants:
                process = start(made, variant)
                results[variant].append(load.run(process, args.rate, args.round_seconds))
                process.stop()
        process = made.start_node(deep=False, units=False)
        long = load.run(process, args.rate, args.seconds)
        code = process.stop()
    expected = replayed(long["stamps"], long["velocity"], long["friction"])
    equal = np.array_equal(long["predicted"], expected)
    best = {
        v: {key: statistics.median(r[key] for r in runs) for key in ("cpu_us", "p50_us", "p99_us")}
        for v, runs in results.items()
    }
    lines = []

    def ratio(variant: str, key: str) -> str:
        return (
            f"{statistics.median(a[key] / b[key] for a, b in zip(results['node'], results[variant], strict=True)):.2f}"
        )

    for variant, runs in results.items():
        lost = 1.0 - sum(r["received"] for r in runs) / sum(r["sent"] for r in runs)
        lines.append(
            [
                variant,
                f"{best[variant]['cpu_us']:.0f}",
                ratio(variant, "cpu_us"),
                f"{best[variant]['p50_us']:.0f}",
                ratio(variant, "p50_us"),
                f"{best[variant]['p99_us']:.0f}",
                ratio(variant, "p99_us"),
                f"{100 * lost:.2f} %",
            ]
        )
    header = [
        "variant",
        "CPU a pair (us)",
        "node / it",
        "round trip p50 (us)",
        "node / it",
        "p99 (us)",
        "node / it",
        "lost",
    ]
    write_section(
        "Pairs",
        f"{args.rate:g} Hz pairs, rounds of {args.round_seconds:g} s in turns, medians of {args.rounds} (of the ratios "
        "within rounds), law rls, model parallel, reliable on both sides.\n\n"
        + rows(header, lines)
        + f"\n\nThe node without configuration for {args.seconds:g} s (the load took {long['took_s']:.1f} s): "
        f"{long['received']} predictions "
        f"of {long['sent']} samples, in order: {long['in_order']}, bit-equal to replay: {equal}, exit code {code}.",
    )


if __name__ == "__main__":
    main()
