"""Transfer: learned on one drive, frozen, judged on another beside static curves fitted to the same samples."""

import numpy as np
from judge import MODELS, both_fits, covered, fit_baselines, frozen, nrmse, scored, static_error
from page import Target, grouped, least, median, table, target_table, worst
from records import FIRST_TEST_SEED, FIRST_TRAIN_SEED, PLANTS, Drive

RATES_HZ = (1000.0, 200.0)
TRAIN_S, TEST_S = 24.0, 10.0
WITHIN = 1.01
"""A test drive whose top speed is at most this much above the training drive's stays within the speeds learned."""

PAIRS = {
    Drive("sine", 1.0): [
        Drive("triangle", 1.0),
        Drive("speed_steps", 4.0),
        Drive("sine", 2.9),
        Drive("multisine", 2.0),
        Drive("crank", 1.3),
        Drive("dwell", 3.0),
        Drive("crank", 0.8),
        Drive("sine", 1.0, stroke=0.5),
        Drive("triangle", 1.0, stroke=1.5),
        Drive("sine", 1.0, pressure_psi=120.0),
    ],
    Drive("sine", 1.0, pressure_psi=120.0): [Drive("sine", 1.0)],
    Drive("sine", 1.0, stroke=0.5): [Drive("sine", 2.0)],
    Drive("sine", 1.0, stroke=1.5): [Drive("crank", 1.0)],
    Drive("sine", 5.0): [Drive("triangle", 4.0)],
    Drive("sine", 2.9): [Drive("sine", 1.0)],
    Drive("triangle", 1.0): [Drive("sine", 2.0), Drive("sine", 1.0)],
    Drive("crank", 1.0): [Drive("triangle", 0.8), Drive("speed_steps", 3.0)],
    Drive("multisine", 2.0): [Drive("sine", 1.5), Drive("speed_steps", 4.0)],
    Drive("dwell", 2.0): [Drive("triangle", 1.0)],
    Drive("dwell", 3.0): [Drive("multisine", 2.0)],
    Drive("speed_steps", 4.0): [Drive("sine", 3.0)],
    Drive("speed_steps", 2.0): [Drive("multisine", 3.0)],
}
TUNED = Drive("sine", 1.0)
TUNED_TESTS = ("triangle", "speed_steps", "sine", "multisine", "crank", "dwell")


def was_tuned_on(train: Drive, test: Drive) -> bool:
    """Whether the estimator was tuned on drives of these forms (other seeds, other periods for some)."""
    return train == TUNED and test.pressure_psi == 50.0 and test.stroke == 1.0 and test.profile in TUNED_TESTS


def jobs(seeds: int) -> list[dict]:
    return [
        {"plant": plant, "rate_hz": rate, "seed": seed, "train": train}
        for seed in range(seeds)
        for rate in RATES_HZ
        for plant in PLANTS
        for train in PAIRS
    ]


def rows(plant: str, rate_hz: float, seed: int, train: Drive) -> list[dict]:
    """Return a row a test drive, model and fit."""
    samples = train.record(TRAIN_S, plant, rate_hz, FIRST_TRAIN_SEED + seed)
    top = float(np.max(np.abs(samples.velocity_m_s)))
    curves = fit_baselines(samples.velocity_m_s, samples.friction_N)
    fits = {model: both_fits(samples, model) for model in MODELS}
    out = []
    for drive in PAIRS[train]:
        test = drive.record(TEST_S, plant, rate_hz, FIRST_TEST_SEED + seed)
        speed = float(np.max(np.abs(test.velocity_m_s))) / top
        kind = "pressure" if drive.pressure_psi != train.pressure_psi else "within" if speed <= WITHIN else "faster"
        for model in MODELS:
            for fit, source in fits[model].items():
                use = scored(test, source.config if fit == "rls" else source.model.config)
                name, static = static_error(curves, test, use)
                predicted, deviation = frozen(source, test)
                error = nrmse(test.friction_N[use], predicted[use])
                out.append(
                    {
                        "plant": plant, "rate_hz": rate_hz, "seed": seed, "train": str(train), "test": str(drive),
                        "kind": kind, "speed_ratio": speed, "held_out_form": not was_tuned_on(train, drive),
                        "model": model, "fit": fit, "nrmse": error, "static": static, "static_curve": name,
                        "ratio": error / static, "covered": covered((test.friction_N - predicted)[use], deviation[use]),
                    }
                )  # fmt: skip
    return out


def _seed_medians(rows: list[dict]) -> list[dict]:
    keys = ("plant", "rate_hz", "train", "test", "kind", "held_out_form", "model", "fit")
    figures = ("nrmse", "static", "ratio", "covered", "speed_ratio")
    return [
        dict(zip(keys, key, strict=True))
        | {name: median(group, name) for name in figures}
        | {"worst_ratio": max(row["ratio"] for row in group)}
        for key, group in grouped(rows, *keys).items()
    ]


def _label(row: dict) -> str:
    return f"{row['plant']}: {row['train']} -> {row['test']}"


def targets(rows: list[dict]) -> list[Target]:
    medians = _seed_medians(rows)

    def some(model, rate, fit="rls", kinds=("within", "faster")):
        return [
            r
            for r in medians
            if (r["model"], r["rate_hz"], r["fit"]) == (model, rate, fit) and r["kind"] in kinds
        ]  # fmt: skip

    def middle(what, part, limit, judged):
        return Target(what, median(part, "ratio"), limit, f"of {len(part)} pairs and plants", judged=judged)

    out = []
    for fit in ("rls", "identify"):
        judged = fit == "rls"
        for rate, most in ((1000.0, 1.25), (200.0, 2.5)):
            part, name = some("parallel", rate, fit), f"Parallel, {fit}, {rate:g} Hz"
            out.append(worst(f"{name}: largest ratio to static", part, "ratio", most, _label, judged=judged))
            out.append(middle(f"{name}: median ratio", part, 0.9, judged))
        for rate in RATES_HZ:
            part, name = some("parallel", rate, fit, ("pressure",)), f"Parallel, {fit}, {rate:g} Hz, another pressure"
            out.append(worst(f"{name}: largest nrmse", part, "nrmse", 0.20, _label, judged=judged))
        for rate in RATES_HZ:
            judged = fit == "rls" and rate == 1000.0
            part, name = some("hammerstein", rate, fit, ("within",)), f"Hammerstein, {fit}, {rate:g} Hz, speeds learned"
            out.append(worst(f"{name}: largest ratio to static", part, "ratio", 2.5, _label, judged=judged))
            out.append(middle(f"{name}: median ratio", part, 1.2, judged))
            worse = [r for r in some("hammerstein", rate, fit) if r["ratio"] > 1.2]
            what = f"Hammerstein, {fit}, {rate:g} Hz, ratio above 1.2 ({len(worse)}): least share inside the band"
            out.append(worst(what, worse, "covered", 0.90, _label, least=True, judged=judged))
    return out


def report(rows: list[dict]) -> str:
    medians = _seed_medians(rows)
    summary = []
    for (rate, model, fit), group in grouped(medians, "rate_hz", "model", "fit").items():
        sets = {
            "all": [r for r in group if r["kind"] != "pressure"],
            "within the speeds learned": [r for r in group if r["kind"] == "within"],
            "faster": [r for r in group if r["kind"] == "faster"],
            "held-out forms": [r for r in group if r["kind"] != "pressure" and r["held_out_form"]],
        }
        for name, part in sets.items():
            bad = max(part, key=lambda r: r["ratio"])
            summary.append(
                {
                    "rate, Hz": f"{rate:g}", "model": model, "fit": fit, "pairs": name, "median": median(part, "ratio"),
                    "max": bad["ratio"], "worst": _label(bad), "least inside the band": least(part, "covered"),
                }
            )  # fmt: skip
    detail = []
    for (rate, plant, train, test), group in grouped(medians, "rate_hz", "plant", "train", "test").items():
        by = {(r["model"], r["fit"]): r for r in group}
        first = group[0]
        row = {
            "rate, Hz": f"{rate:g}", "plant": plant, "learned on": train, "judged on": test,
            "speed": first["speed_ratio"], "static": first["static"],
        }  # fmt: skip
        for model, short in (("parallel", "P"), ("hammerstein", "H")):
            for fit in ("rls", "identify"):
                r = by[model, fit]
                row[f"{short} {fit}"] = f"{r['ratio']:.2f} ({r['nrmse']:.3f}, {100 * r['covered']:.0f} %)"
        row["form"] = "held out" if first["held_out_form"] else "tuned"
        detail.append(row)
    return "\n\n".join(
        [
            "Learned on the first drive (24 s), frozen, nrmse on the second (10 s, another seed) over `static`: the "
            "least of the errors of Coulomb-viscous, Stribeck and asymmetric Stribeck, fitted to the same samples. "
            "Medians over seeds, then over pairs and both plants; pairs of unlike pressure are judged "
            "by nrmse, not by ratio.",
            target_table(targets(rows)),
            table(summary),
            "Each pair: ratio (nrmse, share of the samples inside the band; for identify inside the curve's band); "
            "`speed` is the top speed of the second drive over that of the first.",
            table(detail),
        ]
    )
