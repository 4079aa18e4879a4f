"""Does what was learned hold elsewhere? Every figure of issue 9 that a benchmark can show, on one page.

    python benchmarks/transfer/run.py                   10 seeds, writes README.md beside this file
    python benchmarks/transfer/run.py --quick           2 seeds, writes benchmarks/out/transfer.md
    python benchmarks/transfer/run.py --part pairs      one part, writes benchmarks/out/transfer_pairs.md
    python benchmarks/transfer/run.py --render RAW.json --page PAGE.md      the page of a former run again

The raw figures go to benchmarks/out/ as JSON. Needs ../shared/data for the measured records; what is not there is left
out and said so.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib import import_module
from pathlib import Path

from page import target_table
from tqdm import tqdm

from friction_estimator.output.target import write_text

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
OUT = ROOT / "benchmarks" / "out"

PARTS = {
    "pairs": "Another drive",
    "extrapolation": "Faster than learned",
    "curves": "The curve",
    "change": "The drive changes while it learns",
    "same_drive": "The same drive",
    "measured": "Measured records",
    "first_contact": "First contact",
}
WORKERS = 2

HELD_OUT = """Tuned on: plants rig and clean, seeds 0 (learned from) and 9 (judged by), sine 1 s at 50 psi to triangle,
speed_steps, sine 2.9 s, multisine, crank and dwell, and EMPS' first half. Held out from tuning: all seeds here (100
and up to learn from, 600 and up to judge by), every pair that the table of pairs calls held out (other drives to learn
from, other pressures, other strokes), the standstill and the growing stroke, EMPS' second half, bam and zillen."""


def one(part: str, job: dict) -> list[dict]:
    """Return the rows of one job; a failure is a row, too, so that one record does not lose the others."""
    try:
        return import_module(part).rows(**job)
    except Exception:
        return [{"failed": {key: str(value) for key, value in job.items()}, "trace": traceback.format_exc()}]


def measured(parts: list[str], seeds: int, workers: int) -> dict[str, list[dict]]:
    """Return the rows of each part, in the order of its jobs."""
    jobs = [(part, k, job) for part in parts for k, job in enumerate(import_module(part).jobs(seeds))]
    found: dict[str, dict[int, list[dict]]] = {part: {} for part in parts}
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the workers are spawned and read it
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool, tqdm(total=len(jobs), mininterval=5.0) as bar:
        waiting = {pool.submit(one, part, job): (part, k) for part, k, job in jobs}
        for done in as_completed(waiting):
            part, k = waiting[done]
            found[part][k] = done.result()
            bar.update()
    return {part: [row for k in sorted(found[part]) for row in found[part][k]] for part in parts}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def commit() -> str:
    """Return the commit, and, where the package differs from it, a hash of the difference."""
    code = ("friction_estimator", "benchmarks/transfer/*.py")
    changes = _git("diff", "HEAD", "--", *code) + _git("ls-files", "-o", "--exclude-standard", "--", *code)
    name = _git("rev-parse", "--short", "HEAD").strip()
    return f"{name} with changes {hashlib.sha256(changes.encode()).hexdigest()[:8]}" if changes else name


def rendered(rows: dict[str, list[dict]], head: str) -> str:
    """Return the page."""
    failed = {part: [row for row in mine if "failed" in row] for part, mine in rows.items()}
    good = {part: [row for row in mine if "failed" not in row] for part, mine in rows.items()}
    modules = {part: import_module(part) for part in rows}
    targets = {part: modules[part].targets(good[part]) for part in rows if good[part]}
    judged = [t for part in targets.values() for t in part if t.judged]
    missed = [t for t in judged if not t.passed]
    lines = ["# Transfer: does what was learned hold elsewhere?", head, HELD_OUT]
    lines += [f"{len(judged) - len(missed)} of {len(judged)} bounds of the issue are met; {len(missed)} are not:"]
    lines += [target_table(missed)] if missed else []
    lines += ["Verdicts in brackets below are of figures that the issue sets no bound for."]
    for part, title in PARTS.items():
        if part not in rows:
            continue
        lines += [f"## {title}"]
        if failed[part]:
            last = failed[part][0]["trace"].strip().splitlines()[-1]
            lines += [f"**{len(failed[part])} records failed**, the first {failed[part][0]['failed']}: {last}"]
        lines += [modules[part].report(good[part])] if good[part] else ["Nothing was measured."]
    return "\n\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="two seeds")
    parser.add_argument("--part", choices=PARTS, action="append", help="this part only; may be repeated")
    parser.add_argument("--workers", type=int, default=WORKERS)
    parser.add_argument("--page", type=Path, help="where the page goes")
    parser.add_argument("--render", type=Path, metavar="JSON", help="raw figures of a former run: measure nothing")
    args = parser.parse_args()
    if args.render:
        raw = json.loads(args.render.read_text())
        write_text(args.page or args.render.with_suffix(".md"), rendered(raw["parts"], raw["head"]))
        return 0
    seeds = 2 if args.quick else args.seeds
    parts = [part for part in PARTS if not args.part or part in args.part]
    suffix = "_" + "_".join(parts) if args.part else ""
    whole = not args.part and not args.quick
    page = args.page or (HERE / "README.md" if whole else OUT / f"transfer{suffix}.md")
    words = ["python benchmarks/transfer/run.py", f"--seeds {seeds}", *(f"--part {part}" for part in args.part or ())]
    for path in sorted({path for part in parts for path in getattr(import_module(part), "missing", list)()}):
        print(f"left out: {path} is not here (measured data are kept outside the project)", file=sys.stderr)
    before, begin = commit(), time.monotonic()
    rows = measured(parts, seeds, args.workers)
    command = " ".join(words)
    head = f"Commit {before}, `{command}`, {seeds} seeds, {(time.monotonic() - begin) / 60.0:.0f} minutes."
    head += "" if commit() == before else " **The code changed while this ran.**"
    raw = {"commit": before, "command": command, "seeds": seeds, "head": head, "parts": rows}
    OUT.mkdir(exist_ok=True)
    write_text(OUT / f"transfer{suffix}.json", json.dumps(raw, indent=1, default=str) + "\n")
    write_text(page, rendered(rows, head))
    print(f"wrote {page}")
    return int(any("failed" in row for mine in rows.values() for row in mine))


if __name__ == "__main__":
    sys.exit(main())
