"""How fast the estimate recovers from plausible bad data, how fast it follows a lasting change, and false alarms.

    python benchmarks/recovery/run.py                    all parts, writes README.md beside this file
    python benchmarks/recovery/run.py --quick            one seed, records of a minute; writes to benchmarks/out/
    python benchmarks/recovery/run.py --part faults      one part; may be repeated; writes benchmarks/out/

Every figure is a ratio of errors of two runs of the same estimator over the same samples: with the fault and without
it, or with the change and with the changed law from the start.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from faults import FAULTS, faulty
from records import HELD_OUT_PLANTS, Law, rig, synthetic

from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

sys.path.append(str(Path(__file__).resolve().parents[1]))
import provenance
from tables import table

HERE = Path(__file__).resolve().parent
OUT = HERE.parents[0] / "out"
MODELS = ("hammerstein", "parallel")
RATES_HZ = (200.0, 500.0, 1000.0, 5000.0)
NOISE = 0.01
PLAIN = "two sines"
LIMIT = 1.2
ONSET_S, SPREAD_S = 30.0, 3.0
"""The fault begins after this time, and up to so much later."""

CHANGES = {
    "all + 30 %": Law(1.3, 1.3),
    "all - 30 %": Law(0.7, 0.7),
    "Coulomb + 30 %": Law(coulomb=1.3),
    "Coulomb - 30 %": Law(coulomb=0.7),
    "viscous + 30 %": Law(viscous=1.3),
    "viscous - 30 %": Law(viscous=0.7),
    "one direction + 30 %": Law(forward=1.3),
    "one direction - 30 %": Law(forward=0.7),
}
CLEAN = [
    (plant, schedule, noise)
    for plant in ("rig", "clean")
    for schedule, noise in (
        ("5:50:600", 0.01),
        ("1:50:600", 0.02),
        ("5:200:600", 0.03),
        ("1:50:600:triangle", 0.01),
        ("2:50:600:multisine", 0.02),
        ("4:50:600:speed_steps", 0.01),
        ("3:50:600:dwell", 0.02),
        ("1:50:200,5:50:200:crank,2:50:200:multisine", 0.01),
        ("5:50:200,1:50:200,2:50:200:triangle", 0.02),
        ("1:120:600:crank", 0.03),
    )
]
"""Plant, schedule (two change the drive on the way) and noise of the records in which nothing is wrong."""


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def estimator_of(samples: Samples, model: str, law: str) -> Estimator:
    return Estimator(meet(Config.from_mapping({"model.type": model, "model.law": law}), samples).config)


def fault_rows(model: str, rate: float, plant: str, seed: int, law: str, names: list[str]) -> list[dict]:
    """Return a row a fault: errors from 2 s (or a cycle if longer) and 10 s after its end, over two cycles."""
    rng = np.random.default_rng([seed, round(rate)])
    longest = max(FAULTS[name].seconds for name in names)
    seconds = ONSET_S + SPREAD_S + longest + 15.0
    noise = NOISE
    record = synthetic(seconds, rate, seed, noise) if plant == PLAIN else rig(HELD_OUT_PLANTS[plant], rate, seed, noise)
    samples = record.samples
    estimator = estimator_of(samples, model, law)
    clean = samples.friction_N - estimator.run(samples)
    false = estimator.health.alarmed
    out = []
    for name in names:
        start = round((ONSET_S + rng.uniform(0.0, SPREAD_S)) * rate)
        data, _, stop = faulty(record, name, start, seed)
        length = round(FAULTS[name].seconds * rate)
        shift = stop - (start + length)
        mine = estimator_of(data, model, law)
        deviation = np.empty(len(data))
        predicted = mine.run(data[:stop], True, deviation[:stop])
        held = getattr(mine.health, "held", 0) > 0
        after, held_s = [predicted], float("nan")
        step = max(1, round(0.1 * rate))
        for k in range(stop, len(data), step):
            after.append(mine.run(data[k : k + step], True, deviation[k : k + step]))
            if np.isnan(held_s) and getattr(mine.health, "held", 0) == 0:
                held_s = (k + step - stop) / rate if held else 0.0
        error = data.friction_N - np.concatenate(after)
        row = {
            "fault": name,
            "model": model,
            "rate": rate,
            "plant": plant,
            "seed": seed,
            "false": false,
            "alarms": mine.health.alarmed - false,
            "held": held,
            "held_after_s": held_s,
        }
        for label, wait in (("2 s", max(2.0, record.cycle_s)), ("10 s", max(10.0, 2 * record.cycle_s))):
            begin = stop + round(wait * rate)
            end = begin + round(2.0 * record.cycle_s * rate)
            row[label] = rms(error[begin:end]) / rms(clean[begin - shift : end - shift])
        out.append(row)
    return out


def change_rows(model: str, rate: float, noise: float, seed: int, law: str) -> list[dict]:
    """Return a row a change: errors in the fourth and fifth cycle after it."""
    seconds, out = ONSET_S + SPREAD_S + 8.0, []
    rng = np.random.default_rng([seed, round(rate), 1])
    before = synthetic(seconds, rate, seed, noise)
    same = estimator_of(before.samples, model, law)
    former = before.samples.friction_N - same.run(before.samples)
    for name, changed in CHANGES.items():
        start = round((ONSET_S + rng.uniform(0.0, SPREAD_S)) * rate)
        after = synthetic(seconds, rate, seed, noise, changed).samples
        force = before.samples.friction_N.copy()
        force[start:] = after.friction_N[start:]
        data = replace(after, friction_N=force)
        mine, told = estimator_of(data, model, law), estimator_of(after, model, law)
        error = force - mine.run(data)
        theirs = after.friction_N - told.run(after)
        window = slice(start + round(3.0 * before.cycle_s * rate), start + round(5.0 * before.cycle_s * rate))
        level = max(rms(theirs[window]), rms(former[window]))
        out.append(
            {
                "change": name,
                "model": model,
                "rate": rate,
                "noise": noise,
                "seed": seed,
                "ratio": rms(error[window]) / level,
                "alarms": mine.health.alarmed,
            }
        )
    return out


def clean_rows(model: str, plant: str, schedule: str, noise: float, rate: float, seed: int, law: str) -> list[dict]:
    """Return the alarms of a record in which nothing is wrong."""
    samples = rig(schedule, rate, seed, noise, plant).samples
    mine = estimator_of(samples, model, law)
    error = samples.friction_N - mine.run(samples)
    last = error[-len(error) // 5 :]
    return [
        {
            "plant": plant,
            "schedule": schedule,
            "noise": noise,
            "rate": rate,
            "model": model,
            "seed": seed,
            "alarms": mine.health.alarmed,
            "last_fifth_N": rms(last),
        }
    ]


KINDS = {"faults": fault_rows, "changes": change_rows, "clean": clean_rows}


def jobs(parts: list[str], seeds: int, first: int, law: str, quick: bool) -> list[tuple[str, dict]]:
    out: list[tuple[str, dict]] = []
    tuned = [name for name, fault in FAULTS.items() if not fault.held_out]
    for seed in range(first, first + seeds):
        for model in MODELS:
            for rate in RATES_HZ:
                common = {"model": model, "rate": rate, "seed": seed, "law": law}
                if "faults" in parts:
                    out.append(("faults", common | {"plant": PLAIN, "names": list(FAULTS)}))
                    if rate in (200.0, 1000.0):
                        out += [("faults", common | {"plant": p, "names": tuned}) for p in HELD_OUT_PLANTS]
                if "changes" in parts:
                    out += [("changes", common | {"noise": noise}) for noise in (NOISE, 0.03)]
    if "clean" in parts:
        for k, (plant, schedule, noise) in enumerate(CLEAN):
            for model in MODELS:
                short = ",".join(":".join([*p.split(":")[:2], "60", *p.split(":")[3:]]) for p in schedule.split(","))
                out.append(
                    (
                        "clean",
                        {
                            "model": model,
                            "plant": plant,
                            "schedule": short if quick else schedule,
                            "noise": noise,
                            "rate": RATES_HZ[k % 3],
                            "seed": first + k,
                            "law": law,
                        },
                    )
                )
    return out


def one(job: tuple[str, dict]) -> tuple[str, list[dict]]:
    kind, arguments = job
    return kind, KINDS[kind](**arguments)


def number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.2f}" if value < 10 else f"{value:.3g}"


def fault_page(rows: list[dict], seeds: int) -> str:
    """Return the largest ratio over seeds, by fault and rate."""
    parts = []
    for title, mine in (
        (
            "Faults that the alarm was designed on",
            [r for r in rows if r["plant"] == PLAIN and not FAULTS[r["fault"]].held_out],
        ),
        ("Kinds held out", [r for r in rows if r["plant"] == PLAIN and FAULTS[r["fault"]].held_out]),
        ("Plants held out, faults scaled to the rms of their friction", [r for r in rows if r["plant"] != PLAIN]),
    ):
        if not mine:
            continue
        rates = sorted({r["rate"] for r in mine})
        key = "fault" if mine[0]["plant"] == PLAIN else None
        names = list(dict.fromkeys(r[key] if key else f"{r['plant']}: {r['fault']}" for r in mine))
        lines = []
        for name in names:
            for model in MODELS:
                cells = []
                for rate in rates:
                    here = [
                        r
                        for r in mine
                        if r["model"] == model
                        and r["rate"] == rate
                        and (r[key] if key else f"{r['plant']}: {r['fault']}") == name
                    ]
                    two, ten = (max(r[w] for r in here) for w in ("2 s", "10 s"))
                    mark = "**" if two > LIMIT else ""
                    cells.append(f"{mark}{number(two)}{mark} ({number(ten)})")
                lines.append([name, model, *cells])
        good = sum(r["2 s"] <= LIMIT for r in mine)
        parts.append(
            f"### {title}\n\n{good} of {len(mine)} runs within {LIMIT} at 2 s or one cycle.\n\n"
            + table(["fault", "model", *(f"{r:g} Hz" for r in rates)], lines)
        )
    head = (
        "Error over that of the same run without the fault, from 2 s (or one drive cycle, whichever is longer) after "
        f"its end, in brackets from 10 s after; over two drive cycles, the worst of {seeds} seeds. The fault begins at "
        f"a time that is drawn. At most {LIMIT} is wanted."
    )
    return "\n\n".join([head, *parts])


def change_page(rows: list[dict], seeds: int) -> str:
    lines = []
    for name in CHANGES:
        for model in MODELS:
            cells = []
            for noise in sorted({r["noise"] for r in rows}):
                for rate in sorted({r["rate"] for r in rows}):
                    here = [
                        r
                        for r in rows
                        if (r["change"], r["model"], r["rate"], r["noise"]) == (name, model, rate, noise)
                    ]
                    worst = max(r["ratio"] for r in here)
                    cells.append(f"**{number(worst)}**" if worst > LIMIT else number(worst))
            lines.append([name, model, *cells])
    heads = [
        f"{noise:.0%}, {rate:g} Hz"
        for noise in sorted({r["noise"] for r in rows})
        for rate in sorted({r["rate"] for r in rows})
    ]
    good = sum(r["ratio"] <= LIMIT for r in rows)
    return (
        "Error in the fourth and fifth cycle after an abrupt change, over that of an estimator that met the changed "
        f"law from its first sample (or the former level where that is larger); the worst of {seeds} seeds. "
        f"{good} of {len(rows)} runs within {LIMIT}.\n\n" + table(["change", "model", *heads], lines)
    )


def clean_page(rows: list[dict]) -> str:
    heads = ["plant", "schedule (period:psi:s:profile)", "noise", "rate, Hz", "model", "alarms", "error, last fifth, N"]
    lines = []
    for r in rows:
        figures = f"{r['noise']:.0%}", f"{r['rate']:g}", r["model"], str(r["alarms"]), f"{r['last_fifth_N']:.4f}"
        lines.append([r["plant"], r["schedule"], *figures])
    good = sum(r["alarms"] == 0 for r in rows)
    return f"{good} of {len(rows)} runs without any alarm.\n\n" + table(heads, lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--law", default="rls", choices=("rls", "nlms"))
    parser.add_argument("--part", choices=KINDS, action="append")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", type=Path)
    args = parser.parse_args()
    parts = args.part or list(KINDS)
    seeds = 1 if args.quick else args.seeds
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the workers are spawned and read it
    begin = time.monotonic()
    found: dict[str, list[dict]] = {part: [] for part in parts}
    todo = jobs(parts, seeds, args.first_seed, args.law, args.quick)
    with ProcessPoolExecutor(args.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for kind, rows in pool.map(one, todo):
            found[kind] += rows
    whole = not args.quick and not args.part and args.law == "rls"
    words = "".join(f" --part {part}" for part in args.part or ())
    command = (
        f"python benchmarks/recovery/run.py --seeds {seeds} --first-seed {args.first_seed} --law {args.law}{words}"
    )
    lines = [
        "# Recovery from plausible bad data",
        provenance.line(command),
        f"{(time.monotonic() - begin) / 60.0:.0f} minutes.",
    ]
    if "faults" in found:
        lines += ["## Faults", fault_page(found["faults"], seeds)]
    if "changes" in found:
        lines += ["## Lasting changes", change_page(found["changes"], seeds)]
    if "clean" in found:
        lines += ["## Nothing wrong", clean_page(found["clean"])]
    OUT.mkdir(exist_ok=True)
    (OUT / "recovery.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    page = args.page or (HERE / "README.md" if whole else OUT / "recovery.md")
    page.write_text("\n\n".join(lines) + "\n", encoding="utf-8")
    print(f"wrote {page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
