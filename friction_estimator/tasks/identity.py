"""What a result follows from, as one digest: the code, the content of recordings and the settings.

A result is taken over from an earlier run where its digest is the same: then computing it again gives the same bits.
"""

import hashlib
import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import friction_estimator
from friction_estimator.core.errors import InputError

LIBRARIES = ("numpy", "scipy", "numba", "PyWavelets", "rosbags")
"""What the last bits may depend on beside this package."""

_JOURNALS = ("-wal", "-journal")
"""What SQLite keeps beside a .db3 file; its messages are read too."""

_PIECE = 1 << 20


@dataclass(frozen=True)
class File:
    """A recording: its path, the digest of its content, and what of it would show that it was changed since."""

    path: str
    content: str
    changed_ns: int

    def check_unchanged(self) -> None:
        """Raise InputError where the recording was changed since its digest was taken."""
        if changed_ns(Path(self.path)) != self.changed_ns:
            raise InputError(f"{self.path} was changed while the run went on: run it again")


def digest(facts: Mapping[str, Any]) -> str:
    """Return the digest of facts that JSON can hold; the order of the names does not matter.

    >>> digest({"a": 1, "b": [2.5]}) == digest({"b": [2.5], "a": 1}) != digest({"a": 1, "b": [2.5000001]})
    True
    """
    return hashlib.sha256(json.dumps(facts, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@cache
def code() -> str:
    """Return the digest of this package's version and modules, of Python and of the libraries below."""
    whole = hashlib.sha256()
    home = Path(friction_estimator.__file__).parent
    for path in sorted(home.rglob("*.py")):
        whole.update(path.relative_to(home).as_posix().encode() + b"\0")
        whole.update(hashlib.sha256(path.read_bytes()).digest())
    versions = {name: _version(name) for name in LIBRARIES}
    return digest({"modules": whole.hexdigest(), "version": friction_estimator.__version__, "libraries": versions}
                  | {"python": platform.python_version()})  # fmt: skip


def content(path: Path, advance: Callable[[int], None] = lambda _: None) -> str:
    """Return the digest of a file, or of all files of a folder with their names.

    Parameters
    ----------
    path : a recording: its folder, or its only file, with what SQLite keeps beside that.
    advance : told the bytes just read.

    Raises InputError where it cannot be read.
    """
    try:
        if path.is_dir():
            return digest({item.name: _file(item, advance) for item in sorted(path.iterdir()) if item.is_file()})
        beside = [path.with_name(path.name + end) for end in _JOURNALS]
        return digest({str(k): _file(item, advance) for k, item in enumerate([path, *beside]) if item.is_file()})
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error


def changed_ns(path: Path) -> int:
    """Return when the files of a recording were changed last; 0 where there are none."""
    try:
        items = list(path.iterdir()) if path.is_dir() else [path]
        return max((item.stat().st_mtime_ns for item in items), default=0)
    except OSError:
        return 0


def size(path: Path) -> int:
    """Return the bytes that `content` will read; 0 for what is not there."""
    try:
        items = list(path.iterdir()) if path.is_dir() else [path]
        return sum(item.stat().st_size for item in items if item.is_file())
    except OSError:
        return 0


def _file(path: Path, advance: Callable[[int], None]) -> str:
    whole = hashlib.sha256()
    with path.open("rb") as opened:
        while piece := opened.read(_PIECE):
            whole.update(piece)
            advance(len(piece))
    return whole.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
