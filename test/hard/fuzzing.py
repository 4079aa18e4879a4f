"""Mutated files given to what reads them, in a process that may not take more than a user's patience and memory.

`attack` starts a child that keeps running, has it read input after input, and returns what each input broke. The
child has an address space of 2 GB and 10 s an input; it looks at its exit code, at every byte on its stdout and stderr
and at its memory. Where it dies or hangs, the parent notes the input and starts another child.

An input is given by kind, seed and number, and made by the child; `input_of` makes it again. With `guided`, atheris
(an optional package, coverage-guided) chooses what to change next from the branches that the former inputs reached.
"""

import argparse
import importlib
import json
import os
import random
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import BinaryIO

from hard.mutators import Mutator, mutated

LIMIT_S, LIMIT_MB, ADDRESS_SPACE = 10.0, 1024, 2 << 30
_PATIENCE_S = 3 * LIMIT_S
"""For C code that no alarm interrupts."""


@dataclass(frozen=True)
class Kind:
    """A kind of file under attack.

    Attributes
    ----------
    seeds : takes an empty folder, returns the bytes of sound files.
    place : takes an empty folder and bytes, lays them out as a user has them, returns the path that he gives.
    run : takes that path, does what the command line does with it, returns the exit code.
    own : mutators that know the format.
    """

    seeds: Callable[[Path], list[bytes]]
    place: Callable[[Path, bytes], Path]
    run: Callable[[Path], int]
    own: tuple[Mutator, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """What became of one input: `fault` is empty where all that is promised was kept."""

    number: int
    fault: str
    code: int | None
    seconds: float
    peak_mb: float
    text: str = ""


@dataclass
class Tally:
    """What became of many inputs."""

    read: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    largest_mb: float = 0.0
    faults: list[Verdict] = field(default_factory=list)

    def add(self, verdict: Verdict) -> None:
        self.read += verdict.code == 0
        self.refused += verdict.code in (1, 2)
        self.slowest_s = max(self.slowest_s, verdict.seconds)
        self.largest_mb = max(self.largest_mb, verdict.peak_mb)
        if verdict.fault:
            self.faults.append(verdict)

    def __str__(self) -> str:
        return (
            f"{self.read} read, {self.refused} refused, {len(self.faults)} faults; "
            f"slowest {self.slowest_s:.2f} s, largest {self.largest_mb:.0f} MB"
        )


def input_of(kind: Kind, seeds: list[bytes], seed: int, number: int) -> bytes:
    """Return an input; the first ones are the sound files themselves."""
    if number < len(seeds):
        return seeds[number]
    rng = random.Random(f"{seed}/{number}")
    return mutated(rng, rng.choice(seeds), kind.own)


# The parent


def attack(seed: int, cases: Iterable[tuple[str, int]], scratch: Path) -> dict[str, Tally]:
    """Give inputs, each by kind and number, to a child; keep those with a fault in `scratch`/findings."""
    tallies: dict[str, Tally] = {}
    rest = iter(cases)
    while True:
        began = False
        for name, verdict in _by_one_child(seed, rest, scratch):
            began = True
            tallies.setdefault(name, Tally()).add(verdict)
        if not began:
            return tallies


def _by_one_child(seed: int, cases: Iterator[tuple[str, int]], scratch: Path) -> Iterator[tuple[str, Verdict]]:
    """Yield the verdicts of one child, until the cases or its life end."""
    with _child("serve", str(seed), str(scratch)) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        for name, number in cases:
            child.stdin.write(f"{name} {number}\n".encode())
            child.stdin.flush()
            if not child.stdout.readline():  # the kind is ready; the time of the input begins
                raise RuntimeError(f"the child could not begin with {name}")
            ready, _, _ = select.select([child.stdout], [], [], _PATIENCE_S)
            line = child.stdout.readline() if ready else b""
            if line:
                yield name, Verdict(**json.loads(line))
                continue
            child.kill()
            fault = f"died, {child.wait()}" if ready else "hangs"
            yield name, Verdict(number, fault, None, _PATIENCE_S * (not ready), 0.0)
            return
        child.stdin.close()
        child.wait()


def guided(name: str, seed: int, runs: int, scratch: Path) -> Tally:
    """Have atheris choose the inputs."""
    tally = Tally()
    log = scratch / "guided.jsonl"
    log.unlink(missing_ok=True)
    with _child("guided", str(seed), str(scratch), name, str(runs)) as child:
        output = child.communicate()[0]
    for line in log.read_text().splitlines() if log.exists() else ():
        tally.add(Verdict(**json.loads(line)))
    if child.returncode:
        tally.add(Verdict(-1, f"died, {child.returncode}", None, 0.0, 0.0, output.decode("utf-8", "replace")[-2000:]))
    return tally


def _child(*arguments: str) -> "subprocess.Popen[bytes]":
    here = Path(__file__).parents[1]
    paths = [str(here), str(here.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONFAULTHANDLER": "", "LC_ALL": "C.UTF-8"}
    piped = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-m", "hard.fuzzing", *arguments], stdin=piped, stdout=piped, env=environment, bufsize=0
    )


# The child


class _Late(BaseException):
    """The time of an input is over."""


class _Judge:
    """Gives bytes to a kind's reader and says what became of them."""

    def __init__(self, kind: Kind, scratch: Path) -> None:
        self._kind, self._scratch = kind, scratch
        self._out, self._err = (scratch / "stdout").open("w+b"), (scratch / "stderr").open("w+b")
        self._stdout, self._stderr = os.dup(1), os.dup(2)
        made = scratch / "seeds"
        made.mkdir()
        self.seeds = kind.seeds(made)
        shutil.rmtree(made)
        signal.signal(signal.SIGALRM, self._alarm)
        warnings.simplefilter("always", RuntimeWarning)
        self(-1, self.seeds[0], limit_s=0)  # what is imported and compiled at first is no input's time

    @staticmethod
    def _alarm(_number: int, _frame: object) -> None:
        raise _Late

    def __call__(self, number: int, data: bytes, limit_s: float = LIMIT_S) -> Verdict:
        folder = Path(tempfile.mkdtemp(dir=self._scratch))
        try:
            path = self._kind.place(folder, data)
            Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
            began = time.perf_counter()
            code, fault = self._run(path, limit_s)
            seconds = time.perf_counter() - began
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        match = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
        peak_mb = int(match[1]) / 1024 if match else 0.0
        out, err = _drained(self._out), _drained(self._err)
        fault = fault or _fault(str(path), code, seconds, peak_mb, out, err)
        if fault:
            found = self._scratch / "findings"
            found.mkdir(exist_ok=True)
            (found / f"{number}").write_bytes(data)
        return Verdict(number, fault, code, seconds, peak_mb, err[-1500:] if fault else "")

    def _run(self, path: Path, limit_s: float) -> tuple[int | None, str]:
        """Return exit code and what escaped; what is printed, by C code too, goes to the files."""
        os.dup2(self._out.fileno(), 1)
        os.dup2(self._err.fileno(), 2)
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        try:
            return self._kind.run(path), ""
        except _Late:
            return None, f"longer than {LIMIT_S:g} s"
        except BaseException:
            return None, "escapes: " + traceback.format_exc()[-1500:]
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            sys.stdout.flush()
            sys.stderr.flush()
            os.dup2(self._stdout, 1)
            os.dup2(self._stderr, 2)


def _drained(file: BinaryIO) -> str:
    """Return what was written to a file, and empty it."""
    file.seek(0)
    text = file.read().decode("utf-8", "replace")
    file.seek(0)
    file.truncate()
    return text


def _fault(path: str, code: int | None, seconds: float, peak_mb: float, out: str, err: str) -> str:
    """Return what was not kept of what is promised, or ""."""
    lines = err.splitlines()
    failures = [line for line in lines if line.startswith("friction_estimator") and ": warning: " not in line]
    if "Traceback" in err or "Traceback" in out:
        return "traceback"
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if any(not line.startswith("friction_estimator") for line in lines):
        return "a line of a library on stderr"
    if len(failures) != (code != 0):
        return f"{len(failures)} lines for exit code {code}"
    if failures and path not in failures[0]:
        return "the line does not name the file"
    if re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", out + err):
        return "control characters on the terminal"
    if seconds > LIMIT_S:
        return f"{seconds:.1f} s"
    return f"{peak_mb:.0f} MB" if peak_mb > LIMIT_MB else ""


def _serve(kinds: Mapping[str, Kind], seed: int, scratch: Path) -> None:
    """Answer each kind and number on stdin by a line when it begins and a verdict when it is done."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # nothing else may write where the answers go
    judges: dict[str, _Judge] = {}
    for line in sys.stdin:
        name, number = line.split()
        if name not in judges:
            judges[name] = _Judge(kinds[name], scratch)
        judge = judges[name]
        data = input_of(kinds[name], judge.seeds, seed, int(number))
        print("begins", file=answers, flush=True)
        print(json.dumps(asdict(judge(int(number), data))), file=answers, flush=True)


def _guide(kind: Kind, seed: int, scratch: Path, runs: int) -> None:
    """Let atheris choose what comes next."""
    import atheris  # type: ignore[import-not-found]

    corpus = scratch / "corpus"
    corpus.mkdir(exist_ok=True)
    judge = _Judge(kind, scratch)
    for k, data in enumerate(judge.seeds):
        (corpus / f"seed{k}").write_bytes(data)
    log = (scratch / "guided.jsonl").open("w")
    count = iter(range(2**62))

    def one_input(data: bytes) -> None:
        print(json.dumps(asdict(judge(next(count), data))), file=log, flush=True)

    def another(data: bytes, size: int, number: int) -> bytes:
        return mutated(random.Random(number), data, kind.own)[:size]

    options = [f"-runs={runs}", f"-seed={seed or 1}", "-timeout=0", "-rss_limit_mb=0", f"-max_len={1 << 20}"]
    atheris.Setup(["fuzzing", *options, "-verbosity=0", str(corpus)], one_input, custom_mutator=another)
    atheris.Fuzz()


def _main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("mode", choices=("serve", "guided"))
    parser.add_argument("seed", type=int)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("kind", nargs="?")
    parser.add_argument("runs", type=int, nargs="?", default=0)
    args = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    if args.mode == "serve":
        from hard.fuzz_kinds import KINDS

        _serve(KINDS, args.seed, args.scratch)
        return
    import atheris

    root = Path(__file__).parents[2]
    for path in sorted((root / "friction_estimator").rglob("*.py")):
        if "njit" in path.read_text(encoding="utf-8"):  # numba cannot compile what is changed: it comes before
            importlib.import_module(".".join(path.relative_to(root).with_suffix("").parts))
    with atheris.instrument_imports(include=["friction_estimator", "rosbags", "ruamel", "yaml"]):
        from hard.fuzz_kinds import KINDS
    _guide(KINDS[args.kind], args.seed, args.scratch, args.runs)


if __name__ == "__main__":
    _main()
