"""Hide effects in simulated recordings, diagnose them, and write the page of figures beside this file.

    python benchmarks/diagnosis/study.py                               about 1000 records, seeds 11000 and up
    python benchmarks/diagnosis/study.py --first-seed 0 --seeds 1      a quarter of it, on seeds that may be tuned on
    python benchmarks/diagnosis/study.py --row nothing --row "abba 4 %"      some rows
    python benchmarks/diagnosis/study.py --workers 2                   the same in two processes
    python benchmarks/diagnosis/study.py --share 0/2                   every other record and no page
    python benchmarks/diagnosis/table.py LINES.jsonl... [--list]       the page again, or every miss

Seeds 0 to 999 are for tuning, those below 11000 were looked at. Seeds from there on are for the final judgement and are
looked at once. One JSON line a record goes to benchmarks/out/; a run that was interrupted goes on where it stopped. Set
OPENBLAS_NUM_THREADS=1.
"""

import argparse
import inspect
import json
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from design import ROWS, Case, cases
from draws import hidden, physical
from drives import BY_NAME
from judge import told
from records import Made, make
from table import page
from truth import expected

from friction_estimator.core.errors import ConfigError
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.effects import EFFECTS, Effect
from friction_estimator.output.target import write_text

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out"

FINAL_SEED = 11000
QUIET = 0.01
"""Share of the noise that stays in the record which counts as free of noise."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="a quarter of a row each (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=FINAL_SEED)
    parser.add_argument("--row", choices=ROWS, action="append", help="this row only; may be repeated")
    parser.add_argument("--effect", action="append", help="only records that hide this effect; may be repeated")
    parser.add_argument("--plant", action="append", help="only records of this plant; may be repeated")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--share", metavar="K/N", help="every N-th record from the K-th on, and no page")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the lines (default: benchmarks/out)")
    parser.add_argument("--page", type=Path, help="where the page goes (default: README.md for the whole final study)")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.share:
        part, parts = map(int, given.share.split("/"))
        _work(given, part, parts)
        return 0
    if given.workers > 1:
        if _spawned(given.workers):
            return 1
    else:
        _work(given, 0, 1)
    chosen = {_key(case) for case in _cases(given)}
    lines = [line for path in sorted(given.out.glob(_file(given, "*"))) for line in _read(path)]
    lines = list({_key(line): line for line in lines if _key(line) in chosen}.values())
    whole = not (given.row or given.effect or given.plant) and given.first_seed >= FINAL_SEED
    target = given.page or (HERE / "README.md" if whole else given.out / f"diagnosis_{given.first_seed}.md")
    words = f"python benchmarks/diagnosis/study.py --first-seed {given.first_seed} --seeds {given.seeds}"
    write_text(target, page(lines, words))
    print(f"wrote {target}: {len(lines)} of {len(chosen)} records")
    return 0


def _cases(given: argparse.Namespace) -> Iterator[Case]:
    for case in cases(given.row or list(ROWS), range(given.first_seed, given.first_seed + given.seeds)):
        if given.effect and not set(given.effect) & set(case["truth"]):
            continue
        if given.plant and case["plant"] not in given.plant:
            continue
        yield case


def _work(given: argparse.Namespace, part: int, parts: int) -> None:
    """Answer the cases of one share that no file of this study holds yet."""
    done = {_key(line) for path in given.out.glob(_file(given, "*")) for line in _read(path)}
    out = given.out / _file(given, str(part))
    for number, case in enumerate(_cases(given)):
        if number % parts == part and _key(case) not in done:
            with out.open("a") as handle:
                handle.write(json.dumps(case | answered(case)) + "\n")


def _spawned(workers: int) -> bool:
    """Run the shares in processes of their own; return whether one failed."""
    command = [sys.executable, __file__, *sys.argv[1:], "--share"]
    running = [subprocess.Popen([*command, f"{k}/{workers}"]) for k in range(workers)]
    return max(process.wait() for process in running) != 0


def _file(given: argparse.Namespace, part: str) -> str:
    return f"diagnosis_{given.first_seed}_{part}.jsonl"


def _read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def answered(case: Case) -> dict[str, Any]:
    """Return what the diagnosis says of one case; a failure is a line, too."""
    try:
        made = make_case(case)
    except ConfigError as error:
        return {"unreachable": str(error)}
    try:
        started, cpu = time.perf_counter(), time.process_time()
        result = told(_diagnosed(made, case))
        line = {"seconds": time.perf_counter() - started, "cpu_s": time.process_time() - cpu}
        return line | truth(case, made, result) | result
    except Exception:
        return {"error": traceback.format_exc()}


def hidden_in(case: Case) -> list[Effect]:
    """Return the effects of a case, sizes not yet resolved."""
    drive, seed = BY_NAME[case["drive"]], case["seed"]
    if case["form"] == "physical":
        return [physical(name, drive, seed, case["place"]) for name in case["truth"]]
    return [hidden(name, drive, seed, case["size"], case["form"] == "third") for name in case["truth"]]


def make_case(case: Case, effects: list[Effect] | None = None, quiet: float = 1.0) -> Made:
    """Simulate a case."""
    return make(
        BY_NAME[case["drive"]],
        case["plant"],
        hidden_in(case) if effects is None else effects,
        quiet * case["noise"],
        case["seed"],
        coloured=case["coloured"],
        theory=case["theory"],
    )


def truth(case: Case, made: Made, result: dict[str, Any]) -> dict[str, Any]:
    """Return what the judge holds against the answer."""
    named = {e["name"] for e in (*result["effects"], *result["faults"])}
    values, problems = {}, []
    for index, effect in enumerate(made.effects):
        if effect.name in named and not case["out"]:
            try:
                values[effect.name] = expected(effect, made, index, case["plant"])
            except Exception:
                problems.append(traceback.format_exc())
    line: dict[str, Any] = {
        "spec": [effect.spec for effect in made.effects],
        "sizes": made.sizes,
        "forms": [effect.values.get("form", 0.0) for effect in made.effects],
        "friction_std_N": float(made.samples.friction_N.std()),
        "noise_std_N": float(made.noise_N.std()),
        "samples": len(made.samples),
        "rate_hz": BY_NAME[case["drive"]].rate_hz,
        "expected": values,
    }
    if case["form"] == "physical":
        line["place_s"] = made.effects[0].values[made.effects[0].size_key]
    if problems:
        line["truth_error"] = problems
    if case["gain"] and case["truth"][0] in named:
        quiet = make_case(case, list(made.effects), QUIET)
        line["quiet"] = told(_diagnosed(quiet, case)) | {"friction_std_N": float(quiet.samples.friction_N.std())}
    return line


def _diagnosed(made: Made, case: Case) -> Any:
    left = {name: cls for name, cls in EFFECTS.items() if not (case["out"] and name in case["truth"])}
    if "catalogue" in inspect.signature(diagnose).parameters:
        return diagnose([made.samples], made.config, catalogue=left)
    with _registry(left):
        return diagnose([made.samples], made.config)


@contextmanager
def _registry(left: dict[str, type[Effect]]) -> Iterator[None]:
    """Let the registry hold these effects only."""
    whole = dict(EFFECTS._entries)
    try:
        for name in set(whole) - set(left):
            del EFFECTS._entries[name]
        yield
    finally:
        EFFECTS._entries.clear()
        EFFECTS._entries.update(whole)


def _key(case: Case) -> str:
    names = ("row", "truth", "plant", "drive", "seed", "size", "noise", "form", "place", "coloured", "theory", "out")
    return json.dumps([case[name] for name in names])


if __name__ == "__main__":
    sys.exit(main())
