"""Is a Stribeck curve that is found from the first contact worth its place, without pressure and configuration?

    .venv/bin/python benchmarks/theory/run.py --seeds 2

Three questions, each judged on what was not learned from; writes README.md beside this file.

- measured: learned on the first half, frozen on the second, beside Hammerstein, the seal and the textbook's curves.
- drives: plants of the rig simulation learned on one drive, frozen on others (faster, slower, other profiles).
- scales: nothing configured at three scales far from a seal's; a priori error after two cycles over that of a node with
  range and unit configured, and of one that is also told the curve which the plant departs from.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.fit.baselines import fit_baselines
from friction_estimator.core.fit.batch import predict
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.output.target import write_text
from friction_estimator.rig.drive import parse_schedule
from friction_estimator.rig.law import scaled_theory
from friction_estimator.rig.simulate import Scenario, simulate

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[1] / "transfer"))
import provenance
from records import BAM, EMPS, ZILLEN, ZILLEN_FILES, bam, emps, zillen
from tables import table

HERE = Path(__file__).parent

KINDS = {
    "hammerstein": {"model.type": "hammerstein"},
    "seal": {"theory.kind": "seal"},
    "stribeck": {"theory.kind": "stribeck"},
}
TEXTBOOK = ("coulomb_viscous", "stribeck_asymmetric")

PLANTS = ("rig", "clean", "film_lag", "tabulated", "stribeck", "parallel_memory", "maxwell_slip")
LEARNED = "5:50:40"
OTHERS = {
    "2 s triangle": "2:50:10:triangle",
    "10 s multisine": "10:50:20:multisine",
    "5 s steps": "5:50:15:speed_steps",
}

SCALES = {"0.001 m/s, 5 kN": (1e-3, 5e3), "1 m/s, 3 N": (1.0, 3.0), "40 rad/s, 0.2 N m": (40.0, 0.2)}
CYCLES = 2


def without_pressure(samples: Samples) -> Samples:
    return replace(samples, pressure_Pa=None, temperature_degC=None)


def recorded() -> Iterator[tuple[str, Samples]]:
    if EMPS.is_file():
        yield "EMPS", emps()
    if BAM.is_file():
        yield "bam", bam()
    for name in ZILLEN_FILES if ZILLEN.is_file() else []:
        yield "zillen " + " ".join(name), without_pressure(zillen(*name))


def measured() -> list[list[str]]:
    """Return nrmse over the second half by record and model."""
    rows = [["record", *TEXTBOOK, *KINDS]]
    for name, samples in recorded():
        runs = [replay(samples, Config.from_mapping(given), freeze_after=0.5).figures() for given in KINDS.values()]
        rows.append(
            [name, *(cell(runs[0]["baselines"][b]) for b in TEXTBOOK), *(cell(r["nrmse_frozen"]) for r in runs)]
        )
    return rows


def drives(seeds: int) -> list[list[str]]:
    """Return the mean nrmse over seeds on drives that were not learned."""
    rows = [["plant", "drive", *TEXTBOOK, *KINDS]]
    for plant in PLANTS:
        found: dict[str, list[list[float]]] = {name: [] for name in OTHERS}
        for seed in range(seeds):
            known = simulated(plant, LEARNED, seed)
            curves = fit_baselines(known.velocity_m_s, known.friction_N, TEXTBOOK)
            runs = [replay(known, Config.from_mapping(given)) for given in KINDS.values()]
            for number, (name, schedule) in enumerate(OTHERS.items()):
                other = simulated(plant, schedule, 100 * (1 + number) + seed)
                scored = metrics.settled(other.restart, 8)
                guesses = [curves[name].evaluate(other.velocity_m_s) for name in TEXTBOOK]
                guesses += [predict(other, run.estimator.config, run.parameters) for run in runs]
                found[name].append([metrics.nrmse(other.friction_N[scored], guess[scored]) for guess in guesses])
        rows += [[plant, name, *map(cell, np.mean(values, axis=0))] for name, values in found.items()]
    return rows


def simulated(plant: str, schedule: str, seed: int) -> Samples:
    scenario = Scenario(parse_schedule(schedule), plant=plant, rate_hz=500.0, seed=seed)
    return without_pressure(simulate(scenario).paired())


def scales(seeds: int) -> list[list[str]]:
    """Return a priori nrmse after two cycles with nothing configured, and the largest ratios over the seeds."""
    rows = [["scale", "plant", "nothing configured", "over range and unit given", "over the curve given too"]]
    for scale, (speed, force) in SCALES.items():
        for plant in ("rig", "tabulated", "stribeck"):
            table = []
            for seed in range(seeds):
                samples, given = at_scale(simulated(plant, "2:50:20:crank", seed), speed, force)
                motion = {"input.motion": "rotary"} if "rad" in scale else {}
                errors = [late(samples, Config.from_mapping(motion | values)) for values in ({}, *given)]
                table.append([errors[0], errors[0] / errors[1], errors[0] / errors[2]])
            mean, largest = np.mean(table, axis=0), np.max(table, axis=0)
            rows.append([scale, plant, cell(mean[0]), f"{largest[1]:.3f}", f"{largest[2]:.3f}"])
    return rows


def at_scale(samples: Samples, speed: float, force: float) -> tuple[Samples, list[dict[str, object]]]:
    """Return the samples of a machine of this top speed and usual friction, and what a user could configure."""
    motion = speed / float(np.abs(samples.velocity_m_s).max())
    factor = force / float(np.sqrt(np.mean(np.square(samples.friction_N))))
    moved = replace(
        samples,
        velocity_m_s=samples.velocity_m_s * motion,
        friction_N=samples.friction_N * factor,
        position_m=None,
    )
    units = {"basis.velocity_range": [-1.05 * speed, 1.05 * speed], "force_unit": force}
    seal = scaled_theory(SealConfig(), factor, motion)
    told = {f"seal.{name}": value for name, value in vars(seal).items()}
    return moved, [units, {**units, "theory.kind": "seal", **told}]


def late(samples: Samples, config: Config) -> float:
    """Return the a priori nrmse after two cycles."""
    run = replay(samples, config)
    after = samples.time_s >= CYCLES * 2.0
    return metrics.nrmse(run.samples.friction_N[after], run.predicted_N[after])


def cell(value: float) -> str:
    return f"{value:.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    seeds = parser.parse_args().seeds
    command = f".venv/bin/python benchmarks/theory/run.py --seeds {seeds}"
    parts = {
        "Measured records, pressure taken away: frozen on the second half": measured,
        "Simulated plants without pressure: learned on a 5 s sine, frozen on other drives": lambda: drives(seeds),
        "Nothing configured, at other scales: a priori error after two cycles (ratios: largest over seeds)": lambda: (
            scales(seeds)
        ),
    }
    page = ["# The Stribeck curve of the first contact", provenance.line(command), "Error rms over std of friction."]
    for title, part in parts.items():
        head, *rows = part()
        page += [f"## {title}", table(head, rows)]
        print(page[-2], page[-1], sep="\n", flush=True)
    write_text(HERE / "README.md", "\n\n".join(page) + "\n")


if __name__ == "__main__":
    main()
