"""One output, a folder or a file, from before the work that makes it until it stands in its place."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from friction_estimator.core.errors import InputError
from friction_estimator.output.paths import StrPath, descriptor_of, is_stream, resolved
from friction_estimator.output.staging import Refusal, Staging, refuse


class Target:
    """One output: checked and locked on entry, replaced whole, given up on exit (context manager).

    Parameters
    ----------
    path : as the user gave it. A link stays one; a device or a pipe gets the bytes of the file.
    refusal : for a folder: says why one that stands there may not be replaced. None for a file.
    resumes : for a folder: whether the journal of an unfinished run is kept, and left behind by one.

    Raises
    ------
    InputError on entry where it cannot be written or may not be replaced, InUseError where another process writes it.
    """

    def __init__(self, path: StrPath, refusal: Refusal | None = None, *, resumes: bool = False) -> None:
        self._given, self._refusal, self._resumes = path, refusal, resumes
        self._staging: Staging | None = None

    def __enter__(self) -> "Target":
        """Check, and lock."""
        if self._refusal is None and is_stream(self._given):
            return self
        path = resolved(self._given)
        if self._refusal is not None:
            refuse(path, self._refusal)
            _refuse_fixed(path)
        elif path.is_dir():
            raise InputError(f"cannot write {self._given}: a folder stands there; choose another name")
        self._staging = Staging(path, resumes=self._resumes)
        self._staging.take()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it up; what was not put in place is gone."""
        if self._staging is not None:
            self._staging.release()

    @contextmanager
    def part(self) -> Iterator[Path]:
        """Yield a path to build at; it takes its place, on disk, when the block ends without an exception."""
        if self._staging is None:
            with tempfile.TemporaryDirectory(prefix="friction_estimator-") as folder:
                part = Path(folder) / (Path(self._given).name or "part")
                yield part
                _send(part, self._given)
        elif self._refusal is None:
            with self._staging.file() as part:
                yield part
        else:
            with self._staging.replacement(self._refusal) as part:
                yield part
            self._staging.finish()

    @property
    def journal(self) -> Path:
        """The file of the journal of this run, for a folder that was entered."""
        assert self._staging is not None, "there is a journal while the output is held"
        return self._staging.journal


@contextmanager
def replacing_file(path: StrPath) -> Iterator[Path]:
    """Yield a path to write a file to; `path` is that file when the block ends without an exception.

    Whatever goes wrong, `path` is the former file or the new one, on disk, and nothing temporary stays. Missing folders
    are made. A device or a pipe gets the bytes.

    Raises InputError where it cannot be written, InUseError where another process writes it at this moment.
    """
    with Target(path) as target, target.part() as part:
        yield part


def write_text(path: StrPath, text: str) -> None:
    """Write a whole text file, or none (see `replacing_file`)."""
    with replacing_file(path) as part:
        part.write_text(text, encoding="utf-8")


def _refuse_fixed(path: Path) -> None:
    """Raise InputError where a folder cannot be exchanged as one: a mount, or where this process stands."""
    if not path.is_dir():
        return
    if path.is_mount():
        raise InputError(
            f"cannot replace {path}: it is the root of a file system, which cannot be exchanged; name a folder in it"
        )
    here = Path.cwd()
    if path in (here, *here.parents):
        raise InputError(f"cannot replace {path}: it is or holds the current folder; name a folder in it")


def _send(part: Path, path: StrPath) -> None:
    """Write a file into a stream."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # None where it was closed at the start
        stream.flush()
    number = descriptor_of(path)
    try:
        opened = os.open(path, os.O_WRONLY | os.O_CLOEXEC) if number is None else os.dup(number)
        with part.open("rb") as source, open(opened, "wb") as sink:
            shutil.copyfileobj(source, sink)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}; choose another output path") from error
