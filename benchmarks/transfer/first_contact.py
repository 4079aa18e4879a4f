"""First contact: range and units found while running against those known before, and a range that grows."""

import numpy as np
from judge import MODELS, config_of, learned, nrmse, rms
from page import Target, grouped, median, table, target_table, worst
from records import (
    BAM,
    EMPS,
    FIRST_TRAIN_SEED,
    ZILLEN,
    ZILLEN_FILES,
    Drive,
    after_standstill,
    bam,
    emps,
    in_one,
    zillen,
)

from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen, meet
from friction_estimator.rig.drive import CONDITIONS

RATES_HZ = (1000.0, 200.0)
SECONDS = 60.0
GROWN_STROKE = (0.25, 1.0)
"""Strokes of the drive that grows, in the rig's: eccentric 5 mm, then 20 mm."""


class Watched(Estimator):
    """An estimator that notes at which sample its range grew."""

    def __init__(self, config):
        super().__init__(config)
        self.grown_at = []

    def grow(self):
        before = self.model.basis.reach
        super().grow()
        if self.model.basis.reach != before:
            self.grown_at.append(self.health.samples)


def jobs(seeds: int) -> list[dict]:
    measured = [("emps",)] if EMPS.is_file() else []
    measured += [("bam",)] if BAM.is_file() else []
    measured += [("zillen", *name) for name in ZILLEN_FILES] if ZILLEN.is_file() else []
    names = [(name, 0) for name in measured]
    names += [(("rig", c, rate), s) for s in range(seeds) for rate in RATES_HZ for c in CONDITIONS]
    names += [(("grow", profile, rate), s) for s in range(seeds) for rate in RATES_HZ for profile in ("sine", "crank")]
    return [{"name": name, "seed": seed} for name, seed in names]


def missing() -> list[str]:
    """Return the data that are not here."""
    return [str(path) for path in (EMPS, BAM, ZILLEN) if not path.is_file()]


def rows(name: tuple, seed: int) -> list[dict]:
    """Return a row a model and, but for the growing drive, a row with and without standstill."""
    if name[0] == "grow":
        return _growing(name[1], name[2], seed)
    if name[0] == "rig":
        period, pressure = CONDITIONS[name[1]]
        samples = Drive("sine", period, pressure).record(SECONDS, "rig", name[2], FIRST_TRAIN_SEED + seed)
    elif name[0] == "zillen":
        samples = zillen(*name[1:])
    else:
        samples = {"emps": emps, "bam": bam}[name[0]]()
    last = slice(-(len(samples) // 5), None)
    out = []
    for still in (False, True):
        record = after_standstill(samples, FIRST_TRAIN_SEED + seed) if still else samples
        for model in MODELS:
            config = config_of(model)
            contact = meet(config, record)
            _, mine = learned(record, config)
            told = Estimator(chosen(config, record))
            theirs = told.run(record)
            ours, known = (nrmse(record.friction_N[last], p[last]) for p in (mine, theirs))
            out.append(
                {
                    "kind": "contact", "record": " ".join(map(str, name)), "seed": seed, "standstill": still,
                    "model": model, "nrmse": ours, "configured": known, "ratio": ours / known,
                    "contact_samples": contact.samples, "contact_ended": contact.ended,
                }
            )  # fmt: skip
    return out


def _growing(profile, rate, seed):
    small, large = (
        Drive(profile, 1.0, stroke=stroke).record(20.0, "rig", rate, FIRST_TRAIN_SEED + 50 * k + seed)
        for k, stroke in enumerate(GROWN_STROKE)
    )
    record = in_one(small, large)
    last = slice(-(len(record) // 5), None)
    out = []
    for model in MODELS:
        config = config_of(model)
        estimator = Watched(meet(config, record).config)
        predicted = estimator.run(record)
        step, peak = np.abs(np.diff(predicted)), float(np.max(np.abs(record.friction_N)))
        events = [k for k in estimator.grown_at if 0 < k < len(record)]
        told = Estimator(chosen(config, record)).run(record)
        out.append(
            {
                "kind": "grow", "record": f"{profile} {rate:g}", "seed": seed, "model": model,
                "events": len(events), "jump_over_peak": float(max((step[k - 1] for k in events), default=0.0)) / peak,
                "largest_jump_over_peak": float(step.max()) / peak,
                "largest_error_over_peak": float(np.max(np.abs(record.friction_N - predicted))) / peak,
                "first_cycle_after": rms((record.friction_N - predicted)[len(small) : len(small) + round(rate)])
                / float(np.std(large.friction_N)),
                "nrmse": nrmse(record.friction_N[last], predicted[last]),
                "configured": nrmse(record.friction_N[last], told[last]),
                "range_m_s": list(estimator.model.basis.reach),
                "top_m_s": float(np.max(np.abs(record.velocity_m_s))),
            }
        )  # fmt: skip
    return out


def _label(row):
    still = ", after standstill" if row.get("standstill") else ""
    return f"{row['record']}, {row['model']}{still}, seed {row['seed']}"


def targets(rows: list[dict]) -> list[Target]:
    contact = [r for r in rows if r["kind"] == "contact"]
    growing = [r for r in rows if r["kind"] == "grow"]
    out = []
    for (model,), part in grouped(contact, "model").items():
        for still in (False, True):
            mine = [r for r in part if r["standstill"] is still]
            name = f"{model}{', 60 s of noisy standstill before' if still else ''}: last fifth over configured"
            out.append(worst(name, mine, "ratio", 1.1, _label))
        moving = {(r["record"], r["seed"]): r["nrmse"] for r in part if not r["standstill"]}
        cost = [r | {"cost": r["nrmse"] / moving[r["record"], r["seed"]]} for r in part if r["standstill"]]
        name = f"{model}: last fifth after 60 s of noisy standstill over the same without"
        out.append(worst(name, cost, "cost", 1.1, _label, judged=False))
    for (model,), part in grouped(growing, "model").items():
        name = f"{model}, range growing 4x: largest jump at growth over the peak"
        out.append(worst(name, part, "jump_over_peak", 1.0, _label))
        name = f"{model}, range growing 4x: largest jump anywhere over the peak"
        out.append(worst(name, part, "largest_jump_over_peak", 1.0, _label, judged=False))
        over = [r | {"over": r["nrmse"] / r["configured"]} for r in part]
        name = f"{model}, range growing 4x: last fifth over configured"
        out.append(worst(name, over, "over", 1.1, _label, judged=False))
    return out


def report(rows: list[dict]) -> str:
    contact = grouped([r for r in rows if r["kind"] == "contact"], "record", "model", "standstill")
    growing = grouped([r for r in rows if r["kind"] == "grow"], "record", "model")
    away = missing()
    words = [f"Left out, not here: {', '.join(away)}."] if away else []
    return "\n\n".join(
        [
            "nrmse over the last fifth of a run without configuration over that of a run that knows range and units of "
            "the whole record. Median over seeds [worst].",
            *words,
            target_table(targets(rows)),
            table(
                {
                    "record": record, "model": model, "standstill before": still,
                    "contact, samples": median(part, "contact_samples"),
                    "ended": all(r["contact_ended"] for r in part),
                    "nrmse": median(part, "nrmse"), "configured": median(part, "configured"),
                    "ratio": f"{median(part, 'ratio'):.3f} [{max(r['ratio'] for r in part):.3f}]",
                }
                for (record, model, still), part in contact.items()
            ),
            "A drive whose stroke grows fourfold after 20 s (rig, 1 s):",
            table(
                {
                    "drive, rate": record, "model": model, "growths": median(part, "events"),
                    "range at the end / top speed": f"{part[0]['range_m_s'][1] / part[0]['top_m_s']:.3f}",
                    **{
                        head: f"{median(part, name):.3f} [{max(r[name] for r in part):.3f}]"
                        for head, name in (
                            ("jump at growth / peak", "jump_over_peak"),
                            ("largest jump / peak", "largest_jump_over_peak"),
                            ("largest error / peak", "largest_error_over_peak"),
                            ("nrmse, first cycle after", "first_cycle_after"),
                            ("nrmse, last fifth", "nrmse"),
                            ("configured", "configured"),
                        )
                    },
                }
                for (record, model), part in growing.items()
            ),
        ]
    )  # fmt: skip
