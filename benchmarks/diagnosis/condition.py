"""Fit on three operating conditions, show on the fourth: `python condition.py [--seed S]`.

Diagnosed are records at 50 psi (1 s and 5 s) and 200 psi (1 s); base and extended model, frozen, then predict
200 psi at 5 s.
"""

import argparse
from dataclasses import replace

import numpy as np
from draws import hidden
from drives import USUAL
from records import make

from friction_estimator.core.online.replay import replay
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.extend import extended_config
from friction_estimator.effects import extension_from_config

NAMES = ("inertia", "presliding", "backlash", "time_delay", "squeeze_film", "frictional_lag", "position_dependence")
THREE = ((1.0, 50.0, 12.0, "sine"), (5.0, 50.0, 20.0, "sine"), (1.0, 200.0, 12.0, "sine")) * 2
FOURTH = ((5.0, 200.0, 30.0, "sine"),)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=3100)
    given = parser.parse_args()
    frozen = {"model.adapt": False}
    drives = [replace(USUAL, name=name, parts=parts) for name, parts in (("three", THREE), ("fourth", FOURTH))]
    for name in NAMES:
        three = make(drives[0], "clean", [hidden(name, drives[0], given.seed, 0.04)], 0.01, given.seed)
        fourth = make(drives[1], "clean", three.effects, 0.01, given.seed + 1)
        result = diagnose([three.samples], Config())
        extended = extended_config(result).updated(frozen)
        bare = extended_config(replace(result, models=result.models[:1], effects=(), faults=())).updated(frozen)
        before = replay(fourth.samples, bare).figures()["nrmse"]
        after = replay(fourth.samples, extended, extension=extension_from_config(extended)).figures()["nrmse"]
        noise = float(np.std(fourth.noise_N) / np.std(fourth.samples.friction_N))
        recovered = (before**2 - after**2) / (before**2 - noise**2)
        print(
            f"{name:20s} named {', '.join(e.name for e in result.effects):24s} base {before:.4f} "
            f"extended {after:.4f} noise {noise:.4f} recovered {100 * recovered:.0f} %"
        )


if __name__ == "__main__":
    main()
