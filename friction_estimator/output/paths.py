"""Names of outputs: links resolved, streams told from files, inputs kept."""

import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from friction_estimator.core.errors import InputError

_DESCRIPTOR = re.compile(r"/dev/(?P<name>stdin|stdout|stderr)|/(?:dev/fd|proc/self/fd)/(?P<number>\d+)")
_STANDARD = {"stdin": 0, "stdout": 1, "stderr": 2}

StrPath = str | os.PathLike[str]


def resolved(path: StrPath) -> Path:
    """Return the absolute path of an output without links: a link stays one, what it leads to is replaced.

    Raises InputError where that is no path.
    """
    if not os.fspath(path):
        raise InputError("an output without a name cannot be written; give its path")
    try:
        target = Path(path).resolve()
        if target.is_symlink():
            raise OSError
    except (OSError, RuntimeError) as error:
        if isinstance(error, OSError) and error.errno not in (None, errno.ELOOP):  # a name too long, a folder shut
            raise InputError(f"{path}: {error.strerror}; choose another path") from None
        raise InputError(f"{path}: this link leads in a circle; remove it or choose another output") from None
    except ValueError as error:
        raise InputError(f"{os.fspath(path)!r} is no file name: {error}") from None
    if not target.name:
        raise InputError(f"{path} is no name for an output; choose another")
    return target


def is_stream(path: StrPath) -> bool:
    """Whether this is a device, a pipe, a socket or an open descriptor: nothing that can be replaced."""
    if descriptor_of(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def descriptor_of(path: StrPath) -> int | None:
    """Return the number of the open descriptor that a path names.

    /dev/stdout may lead to a file, which has been written to already: opened anew it would be overwritten.
    """
    found = _DESCRIPTOR.fullmatch(os.path.normpath(os.fspath(path)))
    if found is None:
        return None
    return int(found["number"]) if found["number"] else _STANDARD[found["name"]]


def refuse_inputs(option: str, output: StrPath, inputs: Iterable[StrPath]) -> None:
    """Raise InputError where an output is one of the inputs, holds one or lies in one, by whatever name."""
    target = resolved(output)
    for given in inputs:
        for path in _places(given):
            if _same(target, path):
                raise InputError(
                    f"{option} {output} is the input {given}, which would be replaced; choose another name"
                )
            if any(_same(target, parent) for parent in path.parents):
                raise InputError(
                    f"{option} {output} holds the input {given}, which would be replaced with it: choose another "
                    f"{option}, or move the input out of that folder first"
                )
            if path.is_dir() and any(_same(path, parent) for parent in target.parents):
                raise InputError(f"{option} {output} lies in the input {given}; choose a place outside of it")


def _places(path: StrPath) -> Iterator[Path]:
    """Yield where an input is: itself, and what a folder links to."""
    place = resolved(path)
    yield place
    if place.is_dir():
        yield from (resolved(item) for item in place.iterdir() if item.is_symlink())


def _same(one: Path, other: Path) -> bool:
    try:
        return one == other or one.samefile(other)
    except OSError:
        return False
