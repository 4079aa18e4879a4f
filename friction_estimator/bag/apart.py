"""Tables whose readers a damaged file can crash are read by a process of their own: .mat and .parquet.

The process may take so much memory and time. It says what it has to say as lines of JSON: first the names of the
columns, then, after a line that names the wanted ones, that they lie in the folder that it was given, one .npy each.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from friction_estimator.bag import mat, parquet
from friction_estimator.bag.budget import TABLE_BYTES, TooLargeError, megabytes
from friction_estimator.bag.columns import Columns, TableFile
from friction_estimator.core.errors import InputError

_READERS: dict[str, Callable[[Path], TableFile]] = {".mat": mat.MatFile, ".parquet": parquet.ParquetFile}

SUFFIXES = tuple(_READERS)

_MEMORY = 900 << 20
"""Address space of the reading process beside what it begins with, bytes."""

_SECONDS, _BYTES_PER_SECOND = 6, 10_000_000
"""Processor time of the reading process, and what a large file adds to it."""


class _Apart:
    """A table that another process reads."""

    def __init__(self, path: Path, process: "subprocess.Popen[str]", folder: Path) -> None:
        self._path, self._process, self._folder = path, process, folder
        self.names: list[str] = self._answer()["names"]

    def read(self, wanted: Sequence[str]) -> Columns:
        """Return some columns. Raises InputError."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(list(wanted)) + "\n")
        self._process.stdin.close()
        self._answer()
        return {name: np.load(self._folder / f"{k}.npy", allow_pickle=False) for k, name in enumerate(wanted)}

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        try:
            answer: dict[str, Any] = json.loads(line)
        except ValueError:  # it ended before its answer, or in the middle
            raise InputError(f"{self._path} {self._why()}", remedy="write the table again") from None
        if "error" in answer:
            raise InputError(answer["error"], where=self._path)
        return answer

    def _why(self) -> str:
        """Say how the process ended without an answer."""
        code = self._process.wait()
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            return "takes too long to read: it is damaged, or much too large"
        how = f"signal {-code}" if code < 0 else f"code {code}"
        return f"is damaged: the reader of {self._path.suffix} files ended with {how}"


@contextmanager
def opened(path: Path) -> Iterator[TableFile]:
    """Yield a table that a process reads, which lives as long as the block.

    Raises InputError, here or by `read`: the file is damaged, or the wanted columns unpack to more than `TABLE_BYTES`.
    """
    seconds = _SECONDS + path.stat().st_size // _BYTES_PER_SECOND
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with (
        TemporaryDirectory(prefix="friction_estimator_") as folder,
        subprocess.Popen(
            [sys.executable, "-m", __name__, str(path.absolute()), folder, str(seconds)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            encoding="utf-8",
        ) as process,
    ):
        try:
            yield _Apart(path, process, Path(folder))
        finally:
            process.kill()


def _serve(path: Path, folder: Path, seconds: int, answers: IO[str]) -> None:
    """Read the table with limits: the body of the process."""
    began_with = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = {resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0, resource.RLIMIT_AS: began_with + _MEMORY}
    for kind, wanted in limits.items():
        given = resource.getrlimit(kind)[1]  # less under `ulimit -v`, which nobody may raise
        limit = wanted if given == resource.RLIM_INFINITY else min(wanted, given)
        resource.setrlimit(kind, (limit, limit))
    try:
        table = _READERS[path.suffix.lower()](path)
        _answer(answers, names=list(table.names))
        wanted = json.loads(sys.stdin.readline() or "[]")
        columns = table.read(wanted)
        for k, name in enumerate(wanted):
            column = columns[name]
            if column.dtype.hasobject:  # words
                column = np.array(["" if cell is None else str(cell) for cell in column.tolist()])
            np.save(folder / f"{k}.npy", column, allow_pickle=False)
        _answer(answers, done=True)
    except InputError as error:
        _answer(answers, error=str(error))
    except ModuleNotFoundError as error:
        _answer(answers, error=f"reading it needs {error.name}: pip install {error.name}")
    except TooLargeError as error:
        _answer(answers, error=f"unpacks to {error}")
    except (MemoryError, OverflowError):
        _answer(answers, error=f"unpacks to more than {megabytes(TABLE_BYTES)}: save what is needed of it, in pieces")
    except Exception as error:  # parsers raise many kinds
        words = " ".join(str(error).split()) or type(error).__name__
        _answer(answers, error=f"is no readable {path.suffix[1:]} table: {words}")


def _answer(answers: IO[str], **content: object) -> None:
    answers.write(json.dumps(content) + "\n")
    answers.flush()


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)  # a library's own words are no answers
        _serve(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), answers)
