"""Reading files whose path comes from outside: regular files only, never more of them than asked for.

A path in a configuration may name anything. Opening a named pipe waits for a writer for ever, and /dev/zero has no end.
"""

import os
import stat
from typing import BinaryIO

from friction_estimator.core.errors import InputError
from friction_estimator.core.text import shown

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file, or a link to one, for reading; never waits, and touches nothing that is no file.

    Raises
    ------
    InputError : the path names nothing, something else than a regular file, or a file that may not be read; one line
        that begins with "cannot read" and the path. Its cause is the system's error, where there is one.
    """
    where = f"cannot read {shown(path)}"
    try:
        _check_kind(os.stat(path).st_mode, where)  # before it is opened: to open a device may already act on it
        # What stands there may have changed meanwhile: nothing that is opened this way waits.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        handle = os.fdopen(descriptor, "rb")
    except OSError as error:
        raise InputError(f"{where}: {error.strerror}") from error
    except ValueError as error:  # a NUL, or a character that no file name can hold
        raise InputError(f"{where}: this is no file name") from error
    try:
        _check_kind(os.fstat(handle.fileno()).st_mode, where)
    except InputError:
        handle.close()
        raise
    return handle


def read_regular(path: str | os.PathLike[str], most_bytes: int) -> bytes:
    """Return the content of a regular file of at most `most_bytes`.

    Raises
    ------
    InputError : as `open_regular`, and where the file is larger.
    """
    try:
        with open_regular(path) as handle:
            if os.fstat(handle.fileno()).st_size <= most_bytes:
                content = handle.read(most_bytes + 1)  # it may be growing, and files of /proc have no size
                if len(content) <= most_bytes:
                    return content
    except OSError as error:
        raise InputError(f"cannot read {shown(path)}: {error.strerror}") from error
    raise InputError(f"cannot read {shown(path)}: it is larger than {most_bytes / 2**20:g} MiB")


def _check_kind(mode: int, where: str) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in _KINDS if test(mode)), "no file")
        raise InputError(f"{where}: it is {kind}, and no file")
