"""Beyond the speeds learned: the same drive with 1.5 times the stroke, frozen; only the faster samples count."""

import numpy as np
from judge import MODELS, both_fits, covered, fit_baselines, frozen, rms, scored
from page import Target, grouped, median, table, target_table, worst
from records import FIRST_TEST_SEED, FIRST_TRAIN_SEED, PLANTS, Drive

RATES_HZ = (1000.0, 200.0)
TRAIN_S, TEST_S = 24.0, 10.0
STROKE = 1.5
DRIVES = (
    Drive("sine", 1.0),
    Drive("sine", 5.0),
    Drive("triangle", 1.0),
    Drive("crank", 3.0),
    Drive("multisine", 2.0),
    Drive("dwell", 3.0),
    Drive("speed_steps", 4.0),
)


def jobs(seeds: int) -> list[dict]:
    return [
        {"plant": plant, "rate_hz": rate, "seed": seed, "drive": drive}
        for seed in range(seeds)
        for rate in RATES_HZ
        for plant in PLANTS
        for drive in DRIVES
    ]


def rows(plant: str, rate_hz: float, seed: int, drive: Drive) -> list[dict]:
    """Return a row a model and fit."""
    train = drive.record(TRAIN_S, plant, rate_hz, FIRST_TRAIN_SEED + seed)
    wide = Drive(drive.profile, drive.period_s, drive.pressure_psi, STROKE)
    test = wide.record(TEST_S, plant, rate_hz, FIRST_TEST_SEED + seed)
    v, f = test.velocity_m_s, test.friction_N
    curve = fit_baselines(train.velocity_m_s, train.friction_N)["coulomb_viscous"]
    beyond = (v < train.velocity_m_s.min()) | (v > train.velocity_m_s.max())
    out = []
    for model in MODELS:
        for fit, source in both_fits(train, model).items():
            use = beyond & scored(test, source.config if fit == "rls" else source.model.config)
            predicted, deviation = frozen(source, test)
            error, theirs = (f - predicted)[use], (f - curve.evaluate(v))[use]
            out.append(
                {
                    "plant": plant, "rate_hz": rate_hz, "seed": seed, "drive": str(drive), "model": model, "fit": fit,
                    "samples": int(np.count_nonzero(use)),
                    "right_sign": float(np.mean(np.sign(predicted[use]) == np.sign(v[use]))),
                    "error_N": rms(error), "coulomb_viscous_N": rms(theirs), "ratio": rms(error) / rms(theirs),
                    "friction_N": rms(f[use]), "covered": covered(error, deviation[use]),
                }
            )  # fmt: skip
    return out


def _label(row: dict) -> str:
    seed = f", seed {row['seed']}" if "seed" in row else ""
    return f"{row['plant']}, {row['rate_hz']:g} Hz, {row['model']}: {row['drive']}{seed}"


def _seed_medians(rows):
    keys = ("plant", "rate_hz", "drive", "model", "fit")
    return [
        dict(zip(keys, key, strict=True))
        | {name: median(group, name) for name in ("ratio", "covered", "error_N", "coulomb_viscous_N", "friction_N")}
        | {"right_sign": min(r["right_sign"] for r in group)}
        for key, group in grouped(rows, *keys).items()
    ]


def targets(rows: list[dict]) -> list[Target]:
    out = []
    for model in MODELS:
        for fit in ("rls", "identify"):
            mine = [r for r in rows if (r["model"], r["fit"]) == (model, fit)]
            part, name, judged = _seed_medians(mine), f"{model}, {fit}", fit == "rls"
            sign = f"{name}: least share of right signs, all seeds"
            out.append(worst(sign, mine, "right_sign", 1.0, _label, least=True, judged=judged))
            out.append(worst(f"{name}: largest error over Coulomb-viscous'", part, "ratio", 2.0, _label, judged=judged))
            share = f"{name}: least share inside the band"
            out.append(worst(share, part, "covered", 0.90, _label, least=True, judged=judged))
    return out


def report(rows: list[dict]) -> str:
    detail = []
    for (rate, plant, drive), group in grouped(_seed_medians(rows), "rate_hz", "plant", "drive").items():
        by = {(r["model"], r["fit"]): r for r in group}
        row = {"rate, Hz": f"{rate:g}", "plant": plant, "drive": drive}
        row |= {"friction, N": group[0]["friction_N"], "Coulomb-viscous, N": group[0]["coulomb_viscous_N"]}
        for model, short in (("parallel", "P"), ("hammerstein", "H")):
            for fit in ("rls", "identify"):
                r = by[model, fit]
                row[f"{short} {fit}"] = f"{r['ratio']:.2f} ({100 * r['covered']:.0f} %)"
        detail.append(row)
    return "\n\n".join(
        [
            "The same period with 1.5 times the stroke; only samples faster than any learned from count. Error rms "
            "over that of Coulomb-viscous fitted to the same samples, medians over seeds.",
            target_table(targets(rows)),
            "Ratio (share inside the band):",
            table(detail),
        ]
    )
