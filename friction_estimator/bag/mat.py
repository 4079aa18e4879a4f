"""MATLAB's .mat files (not v7.3), read by a process of their own: scipy's reader can be crashed by a damaged file.

The process may take so much memory and time, and what it says comes back as lines of JSON: first the names of the
columns, then, after a line that names the wanted ones, that they lie in the folder that it was given, one .npy each.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.budget import TABLE_BYTES, megabytes
from friction_estimator.core.errors import InputError

_MEMORY = 3 * TABLE_BYTES
"""Address space of the reading process beside what it begins with, bytes: packed, unpacked, and a copy."""

_SECONDS, _BYTES_PER_SECOND = 8, 10_000_000
"""Processor time of the reading process, and what a large file adds to it."""


SAVE_LESS = "save what is needed of it, in columns of their own or in pieces"

_NO_COLUMNS = ("function", "object", "opaque", "sparse", "unknown")


class MatReader:
    """The columns of a .mat file by name; see `opened`.

    Attributes
    ----------
    names : variables, members of structures as `name.member`, columns of a matrix as `name[0]`, `name[1]`, ...
    """

    def __init__(self, path: Path, process: "subprocess.Popen[str]", folder: Path) -> None:
        self._path, self._process, self._folder = path, process, folder
        self.names: list[str] = self._answer()["names"]

    def read(self, wanted: Sequence[str]) -> dict[str, NDArray[Any]]:
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
        except ValueError:  # it ended before, or in the middle of, its answer
            raise InputError(f"{self._path} {self._why()}") from None
        if "error" in answer:
            raise InputError(f"{self._path} {answer['error']}")
        return answer

    def _why(self) -> str:
        """Say how the process ended without an answer."""
        again = "load it in MATLAB and save it again with save('FILE.mat', '-v7')"
        code = self._process.wait()
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            return f"takes too long to read: it is damaged, or much too large; {again}"
        return f"is damaged: the MATLAB reader ended with {f'signal {-code}' if code < 0 else f'code {code}'}; {again}"


@contextmanager
def opened(path: Path) -> Iterator[MatReader]:
    """Yield the reader of a .mat file, which lives as long as the block.

    Raises InputError where the file cannot be read, is damaged, or unpacks to more than `TABLE_BYTES`.
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
            yield MatReader(path, process, Path(folder))
        finally:
            process.kill()


def _serve(path: str, folder: str, seconds: str, answers: IO[str]) -> None:
    """Read the file with limits: the body of the process."""
    from scipy.io.matlab import loadmat, whosmat  # noqa: PLC0415 - in the process only

    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + _MEMORY, now + _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def answer(**content: object) -> None:
        print(json.dumps(content), file=answers, flush=True)

    too_large = f"unpacks to more than {megabytes(TABLE_BYTES)}: {SAVE_LESS}"
    try:
        # Numbers and words are known by their heads; what a structure holds, only when it is read.
        kinds = {
            name: (shape[:1] if kind == "char" else shape, kind)
            for name, shape, kind in whosmat(path)
            if kind not in _NO_COLUMNS
        }
        tree = {name: value for name in kinds if kinds[name][1] == "struct" for value in [_loaded(loadmat, path, name)]}
        places = _places({name: tree.get(name, kinds[name][0]) for name in kinds})
        answer(names=list(places))
        wanted = json.loads(sys.stdin.readline() or "[]")
        for name in {places[one][0] for one in wanted} - tree.keys():
            if np.prod([float(size) for size in kinds[name][0]]) * 8 > TABLE_BYTES:
                answer(error=too_large)
                return
            tree[name] = _loaded(loadmat, path, name)
        for k, one in enumerate(wanted):
            np.save(Path(folder) / f"{k}.npy", _column(tree, *places[one]), allow_pickle=False)
        answer(done=True)
    except NotImplementedError:
        answer(error=f"is a MATLAB v7.3 file; save it again with save('{Path(path).name}', '-v7')")
    except (MemoryError, OverflowError):
        answer(error=too_large)
    except Exception as error:  # parsers raise many kinds
        answer(error=f"is no readable mat table: {' '.join(str(error).split()) or type(error).__name__}")


_Place = tuple[str, tuple[str, ...], int | None]
"""Variable, members on the way into it, and the column of a matrix (None: the whole is one column)."""


def _loaded(loadmat: Any, path: str, name: str) -> Any:
    return loadmat(path, variable_names=[name], simplify_cells=True)[name]


def _places(tree: Mapping[str, Any]) -> dict[str, _Place]:
    """Return where each column is found; variables are given by their shape, structures by their content."""
    places: dict[str, _Place] = {}

    def walk(name: str, variable: str, members: tuple[str, ...], value: Any) -> None:
        if isinstance(value, Mapping):
            for member, inner in value.items():
                walk(f"{name}.{member}", variable, (*members, member), inner)
            return
        shape = value if isinstance(value, tuple) else np.shape(value)
        if len(shape) == 2 and min(shape) > 1:
            places.update({f"{name}[{k}]": (variable, members, k) for k in range(shape[1])})
        elif len(shape) <= 2:
            places[name] = (variable, members, None)

    for variable, value in tree.items():
        walk(variable, variable, (), value)
    return places


def _column(tree: Mapping[str, Any], variable: str, members: tuple[str, ...], k: int | None) -> NDArray[Any]:
    value = tree[variable]
    for member in members:
        value = value[member]
    array = np.asarray(value)
    column = array.ravel() if k is None else array[:, k]
    return np.array([str(cell) for cell in column.tolist()]) if column.dtype.hasobject else column


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)  # the library's own words are no answers
        _serve(sys.argv[1], sys.argv[2], sys.argv[3], answers)
