"""Kill a verb at its n-th file operation, for every n: what then stands under the output's name, and what is hidden.

`python -m hard.kill_points VERB [--points N] [--random N] [--seed S]` prints what it found; without `--points` every
operation is tried. `--two-renames` has the verb do as on a file system that cannot exchange two names.
What a verb computes is computed once and handed to each of its runs: only what it does to files is repeated.
"""

import argparse
import functools
import hashlib
import importlib
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hard.system_calls import run
from tqdm import tqdm

from friction_estimator.cli.main import main
from friction_estimator.output import exchange
from friction_estimator.output.staging import Staging
from friction_estimator.ros.state import dumps, write_state

Signature = dict[str, str]

_TIMES = re.compile(rb'"samples_per_second": [0-9.e+]+|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC|"p\d{4,}"')
"""What differs from run to run: the speed, when it was, and bokeh's numbers, which go on within a process."""


@dataclass(frozen=True)
class Case:
    """One output: how it is written first and then anew.

    Attributes
    ----------
    name : of the output in the folder of the attack; `document` of its JSON, None for none.
    former, new : write one and the other, given the folder.
    pure : functions ("module:name") whose results are computed once.
    """

    name: str
    document: str | None
    former: Callable[[Path], int]
    new: Callable[[Path], int]
    pure: tuple[str, ...] = ()


def verb(*words: str, out: str = "run", document: str = "result.json") -> Callable[[Path], int]:
    """Return what runs a verb on the inputs of the folder."""

    def body(folder: Path) -> int:
        inputs = [str(folder.parent / "inputs" / word[1:]) if word.startswith("@") else word for word in words]
        return main([*inputs, "--out", str(folder / out), "--json", str(folder / document)])

    return body


def save(value: float) -> Callable[[Path], int]:
    """Return what saves a state."""

    def body(folder: Path) -> int:
        with Staging(folder / "state.json") as staging:
            write_state(staging, dumps({"gain": value}))
        return 0

    return body


_SHORT = ("--condition", "b", "--cycles", "3", "--rate", "200")
_TABLE = ("--time", "t", "--map", "velocity=v,friction=f")
_REPRODUCE = ("reproduce", "--seeds", "2", "--seconds", "30")

CASES = {
    "save": Case("state.json", None, save(1.0), save(2.0)),
    "import": Case("run", "result.json", verb("import", "@one.csv", *_TABLE), verb("import", "@two.csv", *_TABLE)),
    "simulate": Case("run", "result.json", verb("simulate", *_SHORT), verb("simulate", *_SHORT, "--seed", "1")),
    "simulate_mcap": Case(
        "run.mcap", "result.json", *(verb("simulate", *_SHORT, "--seed", s, out="run.mcap") for s in "12")
    ),
    "simulate_db3": Case(
        "run.db3", "result.json", *(verb("simulate", *_SHORT, "--seed", s, out="run.db3") for s in "12")
    ),
    "simulate_sqlite3": Case(
        "run", "result.json", *(verb("simulate", *_SHORT, "--seed", s, "--storage", "sqlite3") for s in "12")
    ),
    "replay": Case("run", "result.json", verb("replay", "@bag"), verb("replay", "@bag", "--law", "nlms")),
    "identify": Case(
        "run", "result.json", verb("identify", "@bag", "--fit-only"),
        verb("identify", "@bag", "--fit-only", "--model", "hammerstein"),
    ),
    "diagnose": Case(
        "run", "result.json", verb("diagnose", "@bag"), verb("diagnose", "@sprung"),
        ("friction_estimator.diagnosis.diagnose:diagnose",),
    ),
    "reproduce": Case(
        "run", "result.json", verb(*_REPRODUCE), verb(*_REPRODUCE[:-1], "31"),
        ("friction_estimator.cli.reproduce:run_tasks",),
    ),
}  # fmt: skip


def prepare(folder: Path) -> None:
    """Write the inputs of all cases."""
    folder.mkdir()
    for number, name in enumerate(("one.csv", "two.csv")):
        rows = [f"{k * 0.01:.2f},{k % 7 - 3},{k % (5 + number)}\n" for k in range(1, 200)]
        (folder / name).write_text("t,v,f\n" + "".join(rows))
    assert main(["simulate", *_SHORT, "--out", str(folder / "bag"), "--json", str(folder / "bag.json")]) == 0
    spring = ("--effect", "side_spring:size=0.3", "--plant", "clean", "--schedule", "1:50:20,2:100:20", "--rate", "200")
    assert main(["simulate", *spring, "--out", str(folder / "sprung"), "--json", str(folder / "sprung.json")]) == 0


def remember(name: str) -> None:
    """Have a pure function compute each result once, by the text of its arguments."""
    module, function = name.split(":")
    home = importlib.import_module(module)
    original, known = getattr(home, function), {}

    @functools.wraps(original)
    def remembered(*args: object, **kwargs: object) -> object:
        key = hashlib.sha256(repr([a for a in args if not callable(a)]).encode()).hexdigest() + str(kwargs.get("seed"))
        if key not in known:
            known[key] = original(*args, **kwargs)
        return known[key]

    setattr(home, function, remembered)


def signature(path: Path) -> Signature | None:
    """Return the contents below a path by name, but for times; None where nothing stands there."""
    if not path.exists():
        return None
    files = [path] if path.is_file() else sorted(item for item in path.rglob("*") if not item.is_dir())
    return {str(f.relative_to(path)): hashlib.sha256(_TIMES.sub(b"", f.read_bytes())).hexdigest() for f in files}


def hidden(folder: Path) -> list[str]:
    """Return the hidden entries anywhere in a folder."""
    return sorted(str(item.relative_to(folder)) for item in folder.rglob(".*"))


def attack(case: Case, root: Path, points: int | None, seed: int, following: int = 1) -> tuple[list[str], list[str]]:
    """Kill the writing of a case at its file operations; return (operations, what was found wrong).

    After every `following`-th kill the next run is made, and judged.
    """
    place, kept = root / "place", root / "kept"

    def fresh() -> None:
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(kept, place)

    signatures = []
    place.mkdir()
    for write in (case.new, case.former):
        assert write(place) in (0, 1)
        signatures.append({n: signature(place / n) for n in (case.name, case.document) if n})
    shutil.copytree(place, kept)
    new, former = signatures
    assert new[case.name] != former[case.name]
    wrong = [f"left after a whole run: {name}" for name in hidden(place)]
    whole = run(lambda: case.new(place), str(place))
    assert whole.code in (0, 1), whole
    numbers = list(range(1, len(whole.operations) + 1))
    if points is not None:
        numbers = sorted(random.Random(seed).sample(numbers, min(points, len(numbers))))
    for turn, number in enumerate(numbers):
        fresh()
        ended = run(lambda: case.new(place), str(place), number)
        at = f"killed before operation {number}"
        if ended.code != -signal.SIGKILL:
            wrong.append(f"{at}: it ended with {ended.code}")
            continue
        at += f", {ended.operations[-1]}"
        wrong += [f"{at}: {text}" for text in judged(case, place, former, new)]
        if turn % following:
            continue
        # The next run, whole: it is not hindered, and nothing hidden is left.
        child = os.fork()
        if child == 0:
            os._exit(case.new(place))
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        after = {n: signature(place / n) for n in new}
        if code not in (0, 1) or after != new or hidden(place) or set(os.listdir(place)) != set(new):
            wrong.append(f"{at}: the next run ends with {code} and leaves {sorted(os.listdir(place))}")
    return whole.operations, wrong


def judged(case: Case, place: Path, former: dict[str, Signature | None], new: dict[str, Signature | None]) -> list[str]:
    """Return what is wrong with what stands under the output's names."""
    wrong = []
    found = {name: signature(place / name) for name in new}
    for name, content in found.items():
        if content not in (former[name], new[name]):
            wrong.append(
                f"{name} is neither the former nor the new one: {'missing' if content is None else 'a mixture'}"
            )
    if case.document and found[case.document] == new[case.document] and found[case.name] != new[case.name]:
        wrong.append("the document is of the new run, the set is not")
    return wrong


def random_kills(case: Case, root: Path, count: int, seed: int) -> list[str]:
    """Kill a run at random moments, whatever it is doing; return what was found wrong."""
    place, kept = root / "place", root / "kept"
    former = {n: signature(kept / n) for n in (case.name, case.document) if n}
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(kept, place)
    begin = time.monotonic()
    assert case.new(place) in (0, 1)
    seconds, new = time.monotonic() - begin, {n: signature(place / n) for n in former}
    wrong, draws = [], random.Random(seed)
    for _ in range(count):
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(kept, place)
        child = os.fork()
        if child == 0:
            os._exit(case.new(place))
        after = draws.uniform(0.0, 1.2 * seconds)
        time.sleep(after)  # the moment is drawn: nothing is waited for
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        wrong += [f"killed after {after:.3f} s: {text}" for text in judged(case, place, former, new)]
    assert case.new(place) in (0, 1)
    return wrong + [f"hidden after the next run: {name}" for name in hidden(place)]


def command_line() -> int:
    """Attack one case; print what was tried and what was found; 1 where anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--points", type=int, help="operations drawn (default: all)")
    parser.add_argument("--random", type=int, default=0, help="kills at random moments after that")
    parser.add_argument("--following", type=int, default=1, help="kills to each whole run after (default: 1)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--two-renames", action="store_true", help="as where two names cannot be exchanged")
    args = parser.parse_args()
    if args.two_renames:
        exchange._renamed = lambda *_: False
    # A child that is killed while it holds what all of them share would stop the next one.
    tqdm.set_lock(threading.RLock())
    tqdm.monitor_interval = 0
    case = CASES[args.case]
    for name in case.pure:
        remember(name)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder).resolve()
        terminal = os.dup(1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the verbs talk
        prepare(root / "inputs")
        operations, wrong = attack(case, root, args.points, args.seed, args.following)
        wrong += random_kills(case, root, args.random, args.seed)
        sys.stdout.flush()
        os.dup2(terminal, 1)
    tried = len(operations) if args.points is None else min(args.points, len(operations))
    print(f"{args.case}: killed at {tried} of {len(operations)} file operations, {args.random} at random moments")
    for line in wrong:
        print(f"  {line}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(command_line())
