"""Every online law against the batch fit of the same structure, on the simulated rig.

    python benchmarks/identification/online_against_batch.py --out benchmarks/out/online.json

20 seeds for each of the paper's conditions a, b and c, with 1 % and 3 % noise; the plant is unlike the theory. Each run
is 60 s at 1000 Hz. For each model and law:

last5     a priori error over the last five drive cycles over that of the batch fit to the whole record, scored on the
          same cycles
to 1.10x  samples learned from until the error over every later stretch of one drive cycle is within 1.10x of the batch
          fit's over the same stretch
first     error over the first drive cycle, in N and Parallel's over Hammerstein's
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from friction_estimator.cli.common import progress
from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.metrics import drive_cycles
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config
from friction_estimator.output.target import write_text
from friction_estimator.rig.drive import CONDITIONS, segment
from friction_estimator.rig.simulate import Scenario, simulate

LAWS = ("lms", "nlms", "rls")
MODELS = ("hammerstein", "parallel")
NOISES = (0.01, 0.03)
WITHIN = 1.10


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def samples_until_within(online, batch, cycle):
    """First sample from which every window of one cycle has an error within WITHIN of the batch fit's; None: never."""
    energy = [np.concatenate([[0.0], np.cumsum(np.square(error))]) for error in (online, batch)]
    ours, theirs = (e[cycle:] - e[:-cycle] for e in energy)
    outside = np.flatnonzero(~(ours <= WITHIN**2 * theirs))
    if not outside.size:
        return 0
    return None if outside[-1] + 1 >= ours.size else int(outside[-1] + 1)


def one_run(condition, noise, seed, seconds, rate, base):
    """Return the rows of one recording, one a model and law."""
    period, pressure = CONDITIONS[condition]
    samples = simulate(Scenario((segment(period, pressure, seconds),), rate_hz=rate, noise=noise, seed=seed)).paired()
    units = chosen(base, samples)
    cycles = drive_cycles(samples.velocity_m_s)
    cycle = int(np.median([part.stop - part.start for part in cycles]))
    first, last = slice(0, cycle), slice(cycles[-5].start, cycles[-1].stop)
    rows = []
    for model in MODELS:
        config = units.updated({"model.type": model})
        fit = fit_batch(samples, config)
        batch = samples.friction_N - fit.predicted_N
        for law in LAWS:
            estimator = Estimator(config.updated({"model.law": law}))
            online = samples.friction_N - estimator.run(samples)
            rows.append(
                {
                    "condition": condition,
                    "noise": noise,
                    "seed": seed,
                    "model": model,
                    "law": law,
                    "cycle_samples": cycle,
                    "batch_nrmse": fit.nrmse,
                    "identifiable_rank": fit.identifiable_rank,
                    "last5_ratio": rms(online[last]) / rms(batch[last]),
                    "samples_to_within": samples_until_within(online, batch, cycle),
                    "first_cycle_N": rms(online[first]),
                    "guarded": estimator.health.guarded,
                    "clipped": estimator.health.clipped,
                }
            )
    return rows


def table(rows):
    """Return the summary as lines of Markdown: medians, [worst], and counts over seeds."""
    keys = sorted({(r["law"], r["condition"], r["noise"]) for r in rows})
    lines = [
        "| law | condition | noise | H last5 | P last5 | H to 1.10x | P to 1.10x | P/H samples | P/H first cycle "
        "| P first |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for law, condition, noise in keys:
        cells = [law, condition, f"{100 * noise:g} %"]
        part = {model: [r for r in rows if _key(r) == (law, condition, noise, model)] for model in MODELS}
        needed = {}
        for model in MODELS:
            ratio = [r["last5_ratio"] for r in part[model]]
            cells.append(f"{np.median(ratio):.3f} [{max(ratio):.3f}]")
        for model in MODELS:
            needed[model] = [np.inf if r["samples_to_within"] is None else r["samples_to_within"] for r in part[model]]
            middle, worst = np.median(needed[model]), max(needed[model])
            cells.append(f"{_count(middle)} [{_count(worst)}]")
        middle = {model: float(np.median(needed[model])) for model in MODELS}
        known = np.isfinite(middle["parallel"]) and 0.0 < middle["hammerstein"] < np.inf
        cells.append(f"{middle['parallel'] / middle['hammerstein']:.2f}" if known else "-")
        pairs = zip(part["parallel"], part["hammerstein"], strict=True)  # runs are in the order of their seeds
        first = [p["first_cycle_N"] / h["first_cycle_N"] for p, h in pairs]
        cells.append(f"{np.median(first):.2f} [{max(first):.2f}]")
        cells.append(f"{sum(f < 1.0 for f in first)}/{len(first)}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _key(row):
    return row["law"], row["condition"], row["noise"], row["model"]


def _count(value):
    return f"{value:.0f}" if np.isfinite(value) else "never"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/out/online_against_batch.json"))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--conditions", default="a,b,c")
    parser.add_argument("--config", help="ROS parameter file in place of the defaults")
    args = parser.parse_args()
    base = read_config(args.config) if args.config else Config()
    runs = [(c, n, s) for s in range(args.seeds) for c in args.conditions.split(",") for n in NOISES]
    rows = []
    with progress("runs", len(runs), "runs") as advance:
        for condition, noise, seed in runs:
            rows += one_run(condition, noise, seed, args.seconds, args.rate, base)
            advance(1)
    arguments = {"seeds": args.seeds, "seconds": args.seconds, "rate_hz": args.rate}
    write_text(args.out, json.dumps({"arguments": arguments, "rows": rows}, indent=1) + "\n")
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
