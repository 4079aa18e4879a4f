"""Run the hidden cases and write a table: `python study.py KIND OUT.jsonl [--seeds 5] [--first-seed 1000]`.

Kinds: single (26 effects x sizes x noises x seeds), nothing, coloured (AR noise), catalogue (each effect in turn taken
out of it), pairs. One JSON line a record; a run that was interrupted goes on where it stopped. `table.py`
turns the lines into the table.
"""

import argparse
import itertools
import json
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases import CATALOGUE, hidden, record, record_ar

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import Diagnosis, diagnose
from friction_estimator.effects import EFFECTS
from friction_estimator.rig.simulate import Simulation

CONDITIONS = ((0.04, 0.01), (0.04, 0.03), (0.005, 0.01), (0.005, 0.03))


def cases(kind: str, seeds: range) -> Iterator[dict[str, Any]]:
    """Yield what to run."""
    if kind == "single":
        for seed, (size, noise), name in itertools.product(seeds, CONDITIONS, CATALOGUE):
            yield {"kind": kind, "truth": [name], "size": size, "noise": noise, "seed": seed}
    elif kind in ("nothing", "coloured"):
        for seed in seeds:
            yield {"kind": kind, "truth": [], "size": 0.0, "noise": (0.01, 0.03)[seed % 2], "seed": seed}
    elif kind == "catalogue":
        for seed, name in itertools.product(seeds, CATALOGUE):
            yield {"kind": kind, "truth": [name], "size": 0.04, "noise": 0.01, "seed": seed}
    elif kind == "pairs":
        for seed in seeds:
            rng = np.random.default_rng([seed, 77])
            one, other = rng.choice(len(CATALOGUE), 2, replace=False)
            yield {
                "kind": kind,
                "truth": [CATALOGUE[one], CATALOGUE[other]],
                "size": 0.04,
                "noise": 0.01,
                "seed": seed,
            }
    else:
        sys.exit(f"unknown kind {kind}")


def run(case: dict[str, Any]) -> dict[str, Any]:
    """Simulate and diagnose one case."""
    seed = case["seed"]
    if case["kind"] == "coloured":
        made = record_ar(case["noise"], seed)
    else:
        made = record([hidden(name, seed, case["size"]) for name in case["truth"]], case["noise"], seed)
    removed = {}
    if case["kind"] == "catalogue":
        removed = {name: EFFECTS._entries.pop(name) for name in case["truth"]}
    started = time.perf_counter()
    try:
        result = diagnose([made.samples], Config())
    finally:
        for name, cls in removed.items():
            EFFECTS.register(name, cls)
    return case | {"seconds": time.perf_counter() - started} | summary(made, result)


def summary(made: Simulation, result: Diagnosis) -> dict[str, Any]:
    """Return what the table needs."""
    spread = float(np.std(made.samples.friction_N))
    noise = float(np.std(made.noise_N)) / spread
    return {
        "spec": [e.spec for e in made.effects],
        "verdict": result.verdict,
        "noise_rms": noise,
        "floor": result.noise_floor,
        "base": result.nrmse_holdout,
        "unexplained": result.unexplained_percent,
        "remainder": None if result.remainder is None else [result.remainder.variable, result.remainder.share],
        "asked": [name for name, _ in result.needs_channel],
        "effects": [
            {
                "name": e.name,
                "rivals": list(e.rivals),
                "p": e.p_value,
                "before": e.gain.nrmse_before,
                "after": e.gain.nrmse_after,
                "parameters": {k: [v.value, v.low, v.high] for k, v in e.parameters.items()},
            }
            for e in result.effects
        ],
        "true": [e.values for e in made.effects],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind")
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--share", default="0/1", help="part k/n of the cases, for several processes")
    given = parser.parse_args()
    part, parts = map(int, given.share.split("/"))
    done = set()
    if given.out.exists():
        done = {_key(json.loads(line)) for line in given.out.read_text().splitlines()}
    for number, case in enumerate(cases(given.kind, range(given.first_seed, given.first_seed + given.seeds))):
        if number % parts != part or _key(case) in done:
            continue
        try:
            line = run(case)
        except Exception:
            line = case | {"error": traceback.format_exc()}
        with given.out.open("a") as handle:
            handle.write(json.dumps(line) + "\n")


def _key(case: dict[str, Any]) -> tuple[Any, ...]:
    return case["kind"], tuple(case["truth"]), case["size"], case["noise"], case["seed"]


if __name__ == "__main__":
    main()
