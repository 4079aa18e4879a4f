"""While learning, the drive changes: from condition b to another profile, in one record without a break."""

import numpy as np
from judge import MODELS, config_of, learned, rms
from page import Target, grouped, median, table, target_table, worst
from records import FIRST_TRAIN_SEED, PLANTS, scheduled

from friction_estimator.core.model.theory import theory_from_config

RATE_HZ = 1000.0
BEFORE_S, AFTER_S = 20, 20
SECOND = {"speed_steps": 4, "triangle": 1, "multisine": 2, "sine": 5}
"""Profile and period, s, of the drive that follows."""


def jobs(seeds: int) -> list[dict]:
    return [
        {"plant": plant, "profile": profile, "seed": seed}
        for seed in range(seeds)
        for plant in PLANTS
        for profile in SECOND
    ]


def rows(plant: str, profile: str, seed: int) -> list[dict]:
    """Return a row a model; errors of cycles over the theory's on the same samples."""
    period = SECOND[profile]
    schedule = f"1:50:{BEFORE_S},{period}:50:{AFTER_S}:{profile}"
    samples = scheduled(schedule, plant, RATE_HZ, FIRST_TRAIN_SEED + seed)
    start, cycle = round(BEFORE_S * RATE_HZ), round(period * RATE_HZ)
    after = slice(start, None)
    friction = samples.friction_N[after]
    out = []
    for model in MODELS:
        config = config_of(model)
        _, predicted = learned(samples, config)
        error = (samples.friction_N - predicted)[after]
        pressure = samples.pressure_Pa - config.theory.ambient_pressure
        theory = theory_from_config(config).evaluate(samples.velocity_m_s, pressure, samples.temperature_degC)
        theirs = (samples.friction_N - theory)[after]
        first = slice(0, round(RATE_HZ))
        cycles = [slice(k, k + cycle) for k in range(0, friction.size - cycle + 1, cycle)]
        ratio = [rms(error[c]) / rms(theirs[c]) for c in cycles]
        out.append(
            {
                "plant": plant, "profile": profile, "seed": seed, "model": model,
                "largest_over_peak": float(np.max(np.abs(error[first])) / np.max(np.abs(friction))),
                "first_second": rms(error[first]) / float(np.std(friction)),
                "over_theory": max(ratio[1:]), "worst_cycle": 2 + int(np.argmax(ratio[1:])), "by_cycle": ratio,
            }
        )  # fmt: skip
    return out


def _label(row):
    return f"{row['plant']}, {row['profile']}, seed {row['seed']}"


def targets(rows: list[dict]) -> list[Target]:
    out = []
    for (model,), part in grouped(rows, "model").items():
        judged = model == "parallel"
        for what, name, most in (
            ("largest error of the first second over the peak", "largest_over_peak", 1.0),
            ("nrmse of the first second", "first_second", 0.3),
            ("from the second cycle, largest error of a cycle over the theory's", "over_theory", 1.0),
        ):
            out.append(worst(f"{model}: {what}", part, name, most, _label, judged=judged))
    return out


def report(rows: list[dict]) -> str:
    detail = [
        {
            "model": model, "plant": plant, "second drive": f"{profile} {SECOND[profile]} s",
            **{
                head: f"{median(part, name):.3f} [{max(r[name] for r in part):.3f}]"
                for head, name in (
                    ("largest / peak", "largest_over_peak"),
                    ("nrmse, first second", "first_second"),
                    ("cycles from the second / theory", "over_theory"),
                )
            },
        }
        for (model, plant, profile), part in grouped(rows, "model", "plant", "profile").items()
    ]  # fmt: skip
    return "\n\n".join(
        [
            f"{BEFORE_S} s of condition b, then {AFTER_S} s of the second drive, learning throughout, {RATE_HZ:g} Hz. "
            "Median over seeds [worst].",
            target_table(targets(rows)),
            table(detail),
        ]
    )
