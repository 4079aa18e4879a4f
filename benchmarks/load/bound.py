"""What not knowing the load costs the friction at the least: the Cramer-Rao bound where friction's form is known.

    python benchmarks/load/bound.py [--first-seed 0] [--seeds 20]

Of an estimator without bias that knows the form of friction, the motion exactly, and has to find the numbers in it:
with J the derivatives of friction with respect to these and L the columns of the load, over the samples in motion,

    (rms error of friction, load unknown / load known)^2 = tr((J' J) (J' M J)^-1) / n,   M = 1 - L (L' L)^-1 L'

whatever the noise is, if white.
"""

import argparse

import numpy as np
from run import DRIVES, GEARED, JOINT, MAIN, PENDULUM, cases, geared, record, stribeck

REST = 0.02
"""Of the top speed, below which samples do not count."""

STEP = 1e-5


FORMS = {GEARED: (geared, np.array(JOINT)), "pendulum": (stribeck, np.array(PENDULUM))}


def bound(plant: str, drive: str, rate_hz: float, seed: int) -> float:
    """Return the ratio of one record."""
    rec = record(plant, drive, rate_hz, seed)
    q, v, a = rec.exact
    form, numbers = FORMS[plant]
    load = rec.load / np.std(rec.load)
    moves = np.abs(v) > REST * np.abs(v).max()
    jacobian = np.column_stack(
        [
            (form(v, load, v, numbers + d) - form(v, load, v, numbers - d)) / (2.0 * STEP)
            for d in STEP * np.eye(numbers.size)
        ]
    )[moves]
    columns = np.column_stack([a, np.sin(q), np.cos(q)])[moves]
    basis, _ = np.linalg.qr(columns / np.sqrt(np.mean(np.square(columns), axis=0)))
    left = jacobian - basis @ (basis.T @ jacobian)
    return float(np.sqrt(np.trace(np.linalg.solve(left.T @ left, jacobian.T @ jacobian)) / numbers.size))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    found: dict[tuple[str, str], list[float]] = {}
    for part in ("joints", "moves"):
        for plant, drive, rate, seed in cases(part, seeds):
            found.setdefault((plant, drive), []).append(bound(plant, drive, rate, seed))
    print("| friction | drive | median | smallest | largest |\n|" + " --- |" * 5)
    for plant in FORMS:
        for drive in (name for name in DRIVES if name in (*MAIN, "moves")):
            ratios = found[plant, drive]
            print(f"| {plant} | {drive} | {np.median(ratios):.2f} | {min(ratios):.2f} | {max(ratios):.2f} |")


if __name__ == "__main__":
    main()
