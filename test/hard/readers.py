"""Read a set of files in a loop while other processes replace it: what is missing, what is of two sets.

`python -m hard.readers N` makes N reads of a set that two processes replace as fast as they can (one at a time: the
second is refused while the first writes).
"""

import argparse
import os
import signal
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from friction_estimator.output.staging import InUseError
from friction_estimator.output.target import Target

FILES = ("summary.json", "config.yaml", "figures/map.png", "bag/data.mcap", "report.html")


@dataclass
class Found:
    """What the reads found.

    Attributes
    ----------
    reads : of the whole set, through one open folder.
    replaced : of these, begun anew since the set was replaced and removed meanwhile.
    sets : different sets seen.
    missing : names that were not there, by path or in a set that was not replaced.
    mixtures : reads through one open folder that held files of two sets.
    crossed : pairs of files opened by path one after the other, the set replaced in between.
    """

    reads: int = 0
    replaced: int = 0
    sets: int = 0
    missing: int = 0
    mixtures: int = 0
    crossed: int = 0


def put(target: Path, content: str, wait: bool = False) -> None:
    """Replace the set by one whose files all hold `content`."""
    while True:
        try:
            with Target(target, lambda _: None) as output, output.part() as part:
                for name in FILES:
                    (part / name).parent.mkdir(parents=True, exist_ok=True)
                    (part / name).write_text(content)
            return
        except InUseError:
            if not wait:
                raise


def write_for_ever(target: Path) -> None:
    """Replace the set again and again, each by another."""
    number = 0
    while True:
        number += 1
        put(target, f"{os.getpid()}.{number}", wait=True)


def read_set(target: Path, found: Found) -> str | None:
    """Read the set through one open folder; return its content, None where it was replaced and removed meanwhile."""
    try:
        folder = os.open(target, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:
        found.missing += 1
        return None
    try:
        contents = set()
        for name in FILES:
            with open(os.open(name, os.O_RDONLY, dir_fd=folder)) as file:
                contents.add(file.read())
    except FileNotFoundError:
        if os.path.samestat(os.fstat(folder), os.stat(target)):
            found.missing += 1
        else:
            found.replaced += 1
        return None
    finally:
        os.close(folder)
    found.mixtures += len(contents) != 1
    return contents.pop()


def attack(reads: int, folder: Path) -> Found:
    """Read beside two writers."""
    target = folder / "run"
    put(target, "0")
    writers = []
    for _ in range(2):
        child = os.fork()
        if child == 0:
            write_for_ever(target)
        writers.append(child)
    found, seen = Found(), set()
    try:
        while found.reads < reads:
            if (content := read_set(target, found)) is not None:
                seen.add(content)
                found.reads += 1
            try:
                found.crossed += len({(target / name).read_text() for name in FILES[:2]}) != 1
            except FileNotFoundError:
                found.missing += 1
    finally:
        for writer in writers:
            os.kill(writer, signal.SIGKILL)
            os.waitpid(writer, 0)
    found.sets = len(seen)
    put(target, "last")
    assert os.listdir(folder) == ["run"], "a killed writer's folder is left"
    return found


def command_line() -> int:
    """Read; print what was found; 1 where anything was missing or mixed, or next to nothing was replaced."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reads", type=int)
    parser.add_argument("--folder", help="where (default: the folder for temporary files)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        found = attack(args.reads, Path(folder).resolve())
    print(", ".join(f"{name} {value}" for name, value in asdict(found).items()))
    return 1 if found.missing or found.mixtures or found.sets < args.reads / 1000 else 0


if __name__ == "__main__":
    sys.exit(command_line())
