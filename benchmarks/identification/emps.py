"""Real data: learn friction on laps 1-2 of EMPS, predict laps 3-4 frozen, beside known models and SysIdentPy.

    python benchmarks/identification/emps.py --make-peers      once: benchmarks/out/peers with requirements.txt
    python benchmarks/identification/emps.py

Data: Janot, Gautier, Brunot 2019 (EMPS), as ../shared/data/emps_nlgreyfast/data.csv beside the project; without them it
says so and ends with code 1. All models get the velocity only and are scored by nrmse over laps 3-4.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import numpy as np
from scipy.optimize import curve_fit

from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.output.target import write_text

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DATA = ROOT.parent / "shared" / "data" / "emps_nlgreyfast" / "data.csv"
PEERS = ROOT / "benchmarks" / "out" / "peers"


def load(path):
    time_s, velocity, friction = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 6, 8), unpack=True)
    stamp = np.rint(time_s * 1e9).astype(np.int64)
    return Samples(stamp, velocity, friction, np.arange(stamp.size) == 0)


def coulomb(samples, half):
    """Coulomb, viscous and offset with sign(v), least squares."""
    columns = np.column_stack([np.sign(samples.velocity_m_s), samples.velocity_m_s, np.ones(len(samples))])
    return columns @ np.linalg.lstsq(columns[:half], samples.friction_N[:half], rcond=None)[0]


def stribeck(samples, half):
    """F = (Fc + (Fs - Fc) exp(-(v/vs)^2)) sign(v) + Fv v + F0 (Armstrong-Helouvry), nonlinear least squares."""

    def curve(v, coulomb_N, static_N, stribeck_m_s, viscous, offset_N):
        bump = (static_N - coulomb_N) * np.exp(-np.square(v / stribeck_m_s))
        return (coulomb_N + bump) * np.sign(v) + viscous * v + offset_N

    v, f = samples.velocity_m_s, samples.friction_N
    best, _ = curve_fit(curve, v[:half], f[:half], p0=(20.0, 25.0, 0.01, 200.0, 0.0), maxfev=20000)
    return curve(v, *best)


def ours(samples, half):
    """Return rows of the Hammerstein model: batch fit and each law, default settings."""
    base = Config.from_mapping({"model.type": "hammerstein", "theory.kind": "none"})
    config = chosen(base, samples)
    known = np.arange(len(samples)) < half
    fit = fit_batch(samples, config, use=known)
    rows = [
        {
            "model": "Hammerstein, batch fit (identify)",
            "nrmse_frozen": nrmse(samples.friction_N[half:], fit.predicted_N[half:]),
            "parameters": fit.identifiable_rank,
        }
    ]
    for law in sorted(LAWS, reverse=True):
        run = replay(samples, config.updated({"model.law": law}), freeze_after=0.5)
        rows.append({"model": f"Hammerstein, {law} (replay)", "nrmse_frozen": run.figures()["nrmse_frozen"]})
    return rows


def peers(samples, half):
    """Return rows of SysIdentPy, run in an environment of its own."""
    python = PEERS / "bin" / "python"
    if not python.exists():
        print("SysIdentPy left out: run with --make-peers once", file=sys.stderr)
        return []
    with tempfile.TemporaryDirectory() as scratch:
        record, result = Path(scratch) / "record.npz", Path(scratch) / "result.json"
        np.savez(record, velocity_m_s=samples.velocity_m_s, friction_N=samples.friction_N, learn=half)
        subprocess.run([python, HERE / "peers.py", record, result], check=True)
        found = json.loads(result.read_text())
    return [
        {
            "model": f"SysIdentPy {row['kind']}, degree {row['degree']}, inputs {row['inputs']}",
            "nrmse_frozen": row["nrmse_frozen"],
            "parameters": row["terms"],
            "nrmse_one_step": row.get("nrmse_one_step"),
        }
        for row in found
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--make-peers", action="store_true", help="make the environment of SysIdentPy and stop")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "out" / "emps.json")
    args = parser.parse_args()
    if args.make_peers:
        venv.create(PEERS, with_pip=True)
        requirements = HERE / "requirements.txt"
        subprocess.run([PEERS / "bin" / "python", "-m", "pip", "install", "-q", "-r", requirements], check=True)
        return 0
    if not args.data.exists():
        print(f"{args.data} is not here: the measured data are kept outside the project", file=sys.stderr)
        return 1
    samples = load(args.data)
    half = round(0.5 * len(samples))
    rows = ours(samples, half)
    for name, model, size in (("Coulomb, viscous, offset", coulomb, 3), ("Stribeck curve fit", stribeck, 5)):
        guess = model(samples, half)
        rows.append({"model": name, "nrmse_frozen": nrmse(samples.friction_N[half:], guess[half:]), "parameters": size})
    rows += peers(samples, half)
    write_text(args.out, json.dumps(rows, indent=1) + "\n")
    print("| model | nrmse, laps 3-4 frozen | parameters | one step ahead |\n| --- | --- | --- | --- |")
    for row in rows:
        step = row.get("nrmse_one_step")
        one_step = "" if step is None else f"{step:.4f}"
        cells = [row["model"], f"{row['nrmse_frozen']:.4f}", row.get("parameters", ""), one_step]
        print("| " + " | ".join(map(str, cells)) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
