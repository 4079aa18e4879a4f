"""The learned static curve against the plant's own, with its band."""

import numpy as np
from judge import MODELS, both_fits, rms
from page import Target, grouped, median, table, target_table, worst
from records import FIRST_TRAIN_SEED, PLANTS, Drive

from friction_estimator.core.settings.theory_groups import SealConfig
from friction_estimator.rig import plant as rig
from friction_estimator.rig.drive import CONDITIONS

SECONDS = 60.0
POINTS = 401
CASES = {("a", 1000.0): 0.05, ("b", 1000.0): 0.05, ("c", 1000.0): 0.05, ("b", 200.0): 0.08}
"""Condition and rate, and the bound on the rms error over the curve's std."""

COVERED, SEEDS_COVERED = 0.90, 0.9
"""Share of the velocities that the band is to cover, in this share of the seeds."""

WIDTH, LEAST_WIDTH = 3.0, 0.01
"""The median half width is to be at most the larger of so many rms errors and this share of the curve's std."""


def jobs(seeds: int) -> list[dict]:
    return [
        {"plant": plant, "condition": condition, "rate_hz": rate, "seed": seed}
        for seed in range(seeds)
        for plant in PLANTS
        for condition, rate in CASES
    ]


def true_curve(plant: str, velocity, pressure_Pa: float, temperature_degC: float):
    """Return the plant's own steady state, (n,) N."""
    law = rig.PLANTS[plant](SealConfig(), 1000.0)
    conditions = np.full(velocity.size, pressure_Pa), np.full(velocity.size, temperature_degC)
    friction = law.curve.evaluate(velocity, *conditions)
    return friction + law.extra(velocity) if plant == "clean" else friction


def rows(plant: str, condition: str, rate_hz: float, seed: int) -> list[dict]:
    """Return a row a model and fit."""
    period, pressure = CONDITIONS[condition]
    samples = Drive("sine", period, pressure).record(SECONDS, plant, rate_hz, FIRST_TRAIN_SEED + seed)
    velocity = np.linspace(samples.velocity_m_s.min(), samples.velocity_m_s.max(), POINTS)
    out = []
    for model in MODELS:
        for fit, source in both_fits(samples, model).items():
            curve = source.curve(samples, velocity)
            true = true_curve(plant, velocity, curve.pressure_Pa, curve.temperature_degC)
            error, std = rms(curve.friction_N - true), float(np.std(true))
            half = float(np.median(0.5 * (curve.high_N - curve.low_N)))
            off = np.abs(curve.friction_N - true)
            out.append(
                {
                    "plant": plant, "condition": condition, "rate_hz": rate_hz, "seed": seed, "model": model,
                    "fit": fit, "error": error / std,
                    "covered": float(np.mean((curve.low_N <= true) & (true <= curve.high_N))),
                    "half_width": half / std, "width_ratio": half / max(WIDTH * error, LEAST_WIDTH * std),
                    "largest_error": float(off.max()) / std, "at_m_s": float(velocity[off.argmax()]),
                }
            )  # fmt: skip
    return out


def _label(row):
    return f"{row['plant']}, {row['condition']}, {row['rate_hz']:g} Hz, seed {row['seed']}"


def targets(rows: list[dict]) -> list[Target]:
    out = []
    for (model, fit), group in grouped(rows, "model", "fit").items():
        judged = (model, fit) == ("parallel", "rls")
        for rate, most in ((1000.0, 0.05), (200.0, 0.08)):
            part = [r for r in group if r["rate_hz"] == rate]
            name = f"{model}, {fit}, {rate:g} Hz: largest rms error over std"
            out.append(worst(name, part, "error", most, _label, judged=judged))
        shares = [
            {"share": float(np.mean([r["covered"] >= COVERED for r in part])), "case": key}
            for key, part in grouped(group, "plant", "condition", "rate_hz").items()
        ]
        name = f"{model}, {fit}: least share of seeds whose band covers 90 %"
        case = lambda r: ", ".join(map(str, r["case"]))  # noqa: E731
        out.append(worst(name, shares, "share", SEEDS_COVERED, case, least=True, judged=judged))
        name = f"{model}, {fit}: largest median half width over its bound"
        out.append(worst(name, group, "width_ratio", 1.0, _label, judged=judged))
    return out


def report(rows: list[dict]) -> str:
    detail = [
        {
            "model": model, "fit": fit, "plant": plant, "condition": condition, "rate, Hz": f"{rate:g}",
            "rms error / std": f"{median(part, 'error'):.4f} [{max(r['error'] for r in part):.4f}]",
            "inside the band": f"{median(part, 'covered'):.3f} [{min(r['covered'] for r in part):.3f}]",
            "seeds with 90 %": f"{sum(r['covered'] >= COVERED for r in part)}/{len(part)}",
            "half width / std": f"{median(part, 'half_width'):.4f}",
            "over its bound": f"{median(part, 'width_ratio'):.2f} [{max(r['width_ratio'] for r in part):.2f}]",
            "largest error / std": f"{median(part, 'largest_error'):.3f} at {median(part, 'at_m_s'):.3f} m/s",
        }
        for (model, fit, plant, condition, rate), part in grouped(
            rows, "model", "fit", "plant", "condition", "rate_hz"
        ).items()
    ]  # fmt: skip
    return "\n\n".join(
        [
            "60 s of the paper's conditions; 401 velocities evenly over those learned, at median pressure and "
            "temperature, against the plant's own curve. Median over seeds [worst].",
            target_table(targets(rows)),
            table(detail),
        ]
    )
