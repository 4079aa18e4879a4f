"""No divergence, no NaN, bounded parameters: random configurations, and long runs.

    .venv/bin/python benchmarks/robustness/run.py --configurations 1000 --samples 20000
    .venv/bin/python benchmarks/robustness/run.py --configurations 10 --samples 10000000

A run diverges where a prediction is not finite, a parameter leaves the guarded range, or the error over the last fifth
is above `LIMIT` times the rms of the friction over the same samples. Writes table_SAMPLES.md beside this file.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.model.structure import LARGEST_PARAMETER
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import chosen

sys.path.append(str(Path(__file__).resolve().parents[1]))
import provenance

HERE = Path(__file__).parent
BLOCK = 200_000
LIMIT = 2.0
STEP_SIZES = {"lms": (0.002, 0.01), "nlms": (0.05, 0.5), "rls": (0.98, 1.0)}
"""Documented ranges (docs/adaptation.md)."""


def random_config(rng: np.random.Generator, law: str) -> dict[str, object]:
    """Draw a structure and a step size from the documented ranges."""
    finest = int(rng.integers(-2, 1))
    values: dict[str, object] = {
        "model.type": str(rng.choice(["hammerstein", "parallel"])),
        "model.law": law,
        "basis.wavelet": f"db{rng.integers(1, 9)}",
        "basis.finest_level": finest,
        "basis.coarsest_level": finest + int(rng.integers(1, 5)),
        "basis.companding": float(rng.choice([0.0, 4.0, 16.0, 64.0])),
        "fir.order": int(rng.integers(0, 13)),
    }
    low, high = STEP_SIZES[law]
    name = "rls.forgetting_factor" if law == "rls" else f"{law}.step_size"
    values[name] = float(rng.uniform(low, high))
    return values


class Machine:
    """An endless record: drive, friction with a changing level, noise, dropouts, standstill, spikes."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.velocity_scale = 10.0 ** rng.uniform(-6, 6)
        self.force_scale = 10.0 ** rng.uniform(-6, 6)
        self.noise = 10.0 ** rng.uniform(-4, -0.5)
        self.period = int(rng.integers(200, 6000))
        self.kind = int(rng.integers(0, 3))
        self.done = 0

    def block(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (stamp_ns, velocity, friction) of the next n samples."""
        k = self.done + np.arange(n)
        self.done += n
        phase = 2 * np.pi * k / self.period
        shapes = (
            np.cos(phase),
            np.arcsin(np.cos(phase)) / (np.pi / 2),
            np.sign(np.cos(phase)) * (np.sin(3 * phase) > 0),
        )
        v = np.asarray(shapes[self.kind], dtype=float)
        v[(k // (7 * self.period)) % 4 == 3] = 0.0  # standstill
        level = 1.0 + 0.3 * ((k // (23 * self.period)) % 2)
        f = level * np.tanh(v / 0.03) * (1.0 + np.exp(-np.abs(v) / 0.1)) + 0.5 * v
        f += self.noise * self.rng.standard_normal(n)
        f[self.rng.random(n) < 1e-4] *= 50.0
        lost = self.rng.random(n) < 0.003
        f[lost & (self.rng.random(n) < 0.5)] = np.nan
        stamp = 1 + k * 1_000_000
        keep = ~(self.rng.random(n) < 0.001)
        return stamp[keep], (v * self.velocity_scale)[keep], (f * self.force_scale)[keep]


def run_one(seed: int, samples: int) -> tuple[str, dict[str, object], str, float, float]:
    """Return (law, configuration, fault or '', final nrmse, norm of the parameters)."""
    rng = np.random.default_rng([77, seed])
    law = list(LAWS)[seed % len(LAWS)]
    values = random_config(rng, law)
    machine = Machine(rng)
    block = min(BLOCK, samples)
    stamp, v, f = machine.block(block)
    if values["model.type"] == "parallel":  # a theory of the machine's own scale
        values |= {"theory.kind": "seal", "seal.shaft_diameter": 0.025}
    config = chosen(Config.from_mapping(values), v, f)
    intake, estimator = Intake(config), Estimator(config)
    error_power = spread = 0.0
    last = samples - samples // 5
    while machine.done <= samples or stamp.size:
        events = np.repeat(stamp, 2)
        kind = np.tile([VELOCITY, FRICTION], stamp.size)
        batch: Samples = intake.push(kind, events, np.column_stack([v, f]).ravel())
        predicted = estimator.run(batch)
        theta = estimator.parameters.theta
        if not np.isfinite(predicted).all() or not np.isfinite(theta).all():
            return law, values, "not finite", float("nan"), float("nan")
        if machine.done > last:
            # Spikes are the sensor's, not the friction's.
            error = np.abs(batch.friction_N - predicted) / config.unit_N
            usual = np.abs(batch.friction_N) < 10 * config.unit_N
            error_power += float(np.sum(error[usual] ** 2))
            spread += float(np.sum((batch.friction_N[usual] / config.unit_N) ** 2))
        if machine.done >= samples:
            break
        stamp, v, f = machine.block(min(block, samples - machine.done))
    nrmse = float(np.sqrt(error_power / spread)) if spread else 0.0
    size = float(np.linalg.norm(theta))
    fault = "diverged" if nrmse > LIMIT else "large parameters" if size >= LARGEST_PARAMETER else ""
    return law, values, fault, nrmse, size


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--configurations", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--first-seed", type=int, default=0)
    args = parser.parse_args()
    begin = time.perf_counter()
    results = []
    for seed in range(args.first_seed, args.first_seed + args.configurations):
        results.append(run_one(seed, args.samples))
        if results[-1][2]:
            print(seed, *results[-1], flush=True)
    command = f"python benchmarks/robustness/run.py --configurations {args.configurations} --samples {args.samples}"
    lines = [
        "# Random configurations on hostile data\n",
        provenance.line(command),
        f"{args.configurations} configurations, {args.samples} samples each\n",
        "| law | runs | faults | nrmse median | nrmse worst | norm of parameters, worst |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for law in LAWS:
        own = [r for r in results if r[0] == law]
        if own:
            errors, sizes = np.array([r[3] for r in own]), np.array([r[4] for r in own])
            faults = sum(bool(r[2]) for r in own)
            lines.append(
                f"| {law} | {len(own)} | {faults} | {np.median(errors):.3f} | {errors.max():.3f} | {sizes.max():.3g} |"
            )
    text = "\n".join(lines) + "\n"
    (HERE / f"table_{args.samples}.md").write_text(text, encoding="utf-8")
    print(text, f"{time.perf_counter() - begin:.0f} s")
    return int(any(r[2] for r in results))


if __name__ == "__main__":
    sys.exit(main())
