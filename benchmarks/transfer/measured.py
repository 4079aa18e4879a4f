"""Measured records: learned on the first half, frozen on the second, and the curve used in a simulation of EMPS."""

from dataclasses import replace

import numpy as np
from forward import load, position_error_m
from judge import MODELS, config_of, fit_baselines, fitted, frozen, learned, nrmse, scored
from page import Target, grouped, table, target_table
from records import BAM, EMPS, bam, emps

LAWS = ("rls", "identify", "nlms", "lms")
BLOCK = 8192
RECORDS = {"EMPS": (EMPS, emps), "bam": (BAM, bam)}


def jobs(seeds: int) -> list[dict]:  # noqa: ARG001 - measured once
    return [{"record": name} for name, (path, _) in RECORDS.items() if path.is_file()]


def missing() -> list[str]:
    """Return the data that are not here."""
    return [str(path) for path, _ in RECORDS.values() if not path.is_file()]


def friction_of(source):
    """Return what a model says at constant velocity, at its default pressure: velocities (n,) m/s to (n,) N."""
    model, theta = source.model, source.parameters.theta

    def friction(velocity):
        settings = model.config.theory
        out = np.empty(velocity.size)
        for start in range(0, velocity.size, BLOCK):
            part = velocity[start : start + BLOCK]
            theory = model.theory_at(part, settings.default_pressure, settings.default_temperature)
            out[start : start + BLOCK] = model.steady_state(theta, part, theory)[0]
        return out

    return friction


def rows(record: str) -> list[dict]:
    """Return a row a model and law, and one a textbook's curve."""
    samples = RECORDS[record][1]()
    half = len(samples) // 2
    train, test = samples[:half], samples[half:]
    test = replace(test, restart=np.append(True, test.restart[1:]))  # for all alike: no delay line is warm
    use = scored(test, config_of("parallel"))
    axis = load().halves[1] if record == "EMPS" else None
    out = []

    def add(model, law, predicted, friction, in_band=None):
        row = {"record": record, "model": model, "law": law, "in_band": in_band}
        row["nrmse"] = nrmse(test.friction_N[use], predicted[use])
        row["position_mm"] = None if axis is None else 1e3 * position_error_m(friction, axis)
        out.append(row)

    for name, curve in fit_baselines(train.velocity_m_s, train.friction_N).items():
        add("static", name, curve.evaluate(test.velocity_m_s), curve.evaluate)
    for model in MODELS:
        for law in LAWS:
            config = config_of(model, "rls" if law == "identify" else law)
            source = fitted(train, config) if law == "identify" else learned(train, config)[0]
            predicted, deviation = frozen(source, test)
            inside = np.abs(test.friction_N - predicted)[use] <= 1.96 * deviation[use]
            add(model, law, predicted, friction_of(source), float(np.mean(inside)))
    return out


def _label(row):
    return f"{row['model']}, {row['law']}"


def targets(rows: list[dict]) -> list[Target]:
    out = []
    for (record,), part in grouped(rows, "record").items():
        by = {(r["model"], r["law"]): r for r in part}
        ours = [r for r in part if r["model"] != "static"]
        for row in ours:
            name = f"{record}, {_label(row)}"
            best = row["law"] in ("rls", "identify")
            if record == "EMPS":
                out.append(Target(f"{name}: frozen nrmse", row["nrmse"], 0.048, judged=best))
                theirs = by["static", "coulomb_viscous_asymmetric"]["position_mm"]
                text = f"{row['position_mm']:.2f} mm against {theirs:.2f}"
                ratio = row["position_mm"] / theirs
                out.append(Target(f"{name}: position error over asymmetric C-v's", ratio, 1.25, text, judged=best))
            else:
                ratio = row["nrmse"] / by["static", "coulomb_viscous"]["nrmse"]
                text = f"{row['nrmse']:.3f} against {by['static', 'coulomb_viscous']['nrmse']:.3f}"
                out.append(Target(f"{name}: frozen nrmse over Coulomb-viscous'", ratio, 1.05, text, judged=best))
        if record == "bam":
            for model in MODELS:
                other = min((by[model, law] for law in ("lms", "nlms")), key=lambda r: r["nrmse"])
                value = by[model, "rls"]["nrmse"] / other["nrmse"]
                what = f"bam, {model}: rls over the better of lms and nlms"
                out.append(Target(what, value, 1.05, f"{other['law']} {other['nrmse']:.3f}"))
    return out


def report(rows: list[dict]) -> str:
    away = missing()
    words = [f"Left out, not here: {', '.join(away)}."] if away else []
    return "\n\n".join(
        [
            "Learned on the first half, frozen on the second; EMPS' position error is that of M a = F - f(v) over the "
            "second half (see forward.py). EMPS' first half was seen while tuning, bam was not.",
            *words,
            target_table(targets(rows)),
            table(
                {
                    "record": r["record"], "model": r["model"], "law": r["law"], "nrmse": r["nrmse"],
                    "inside the band": "-" if r["in_band"] is None else f"{100 * r['in_band']:.0f} %",
                    "position error, mm": "-" if r["position_mm"] is None else f"{r['position_mm']:.2f}",
                }
                for r in rows
            ),
        ]
    )  # fmt: skip
