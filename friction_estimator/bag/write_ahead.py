"""Messages of a .db3 recording that stand in SQLite's journal beside it (-wal or -journal), not yet in the file.

A recorder that runs, or was killed, leaves its newest messages there, and rosbags does not look. A copy is taken of
the file and its journal, and SQLite puts them together in the copy: nothing is written beside the user's recording.
"""

import fcntl
import shutil
import sqlite3
import struct
from collections.abc import Iterable
from pathlib import Path

from friction_estimator.core.errors import InputError

_JOURNALS = ("-wal", "-journal")

_ATTEMPTS = 5
"""Copies tried while a recorder goes on to write."""

_WAL_HEAD = 32
"""Bytes at the head of a write-ahead log: they change when the log begins anew."""

_DEADMAN_SWITCH = 128
"""Byte of the -shm file on which every connection of a running process holds a lock."""

_FLOCK = "hhqqi"
"""struct flock of Linux: type, whence, start, length, process."""


def journals(files: Iterable[Path]) -> dict[Path, Path]:
    """Return the journals that hold anything, by the .db3 file that they belong to."""
    found = {}
    for file in files:
        beside = [file.with_name(file.name + suffix) for suffix in _JOURNALS if file.suffix == ".db3"]
        filled = [item for item in beside if item.is_file() and item.stat().st_size]
        if filled:
            found[file] = filled[0]
    return found


def told(file: Path, journal: Path) -> str:
    """Say that a journal is read, too, and whether a recorder has it open."""
    text = f"{journal.name} holds messages that are not yet in {file.name}: they are read, too"
    writer = _writer(file)
    if writer is None:
        return text
    return f"{text}; process {writer} has the recording open, and what it writes from now on is not read"


def complete(file: Path, journal: Path, copy: Path) -> None:
    """Copy a file with its journal as they were at one moment, and put them together.

    Raises InputError where the recorder writes too fast, sqlite3.DatabaseError where file or journal is damaged.
    """
    for _ in range(_ATTEMPTS):
        before = _state(file, journal)
        shutil.copyfile(file, copy)
        if before:
            shutil.copyfile(journal, copy.with_name(journal.name.replace(file.name, copy.name)))
        if _state(file, journal) == before:
            break
    else:
        raise InputError(f"{file} is written faster than it can be read: wait until the recorder has stopped")
    with_journal = sqlite3.connect(copy)
    try:
        with_journal.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        with_journal.execute("PRAGMA journal_mode=DELETE").fetchall()
    finally:
        with_journal.close()


def _state(file: Path, journal: Path) -> tuple[object, ...]:
    """Return what must not change while a copy is taken; () where the journal is gone.

    A write-ahead log may grow meanwhile, and what is in it may go into the file: both are in the copy's log. It must
    not begin anew. A rollback journal and its file must stand still.
    """
    try:
        if journal.name.endswith("-wal"):
            with journal.open("rb") as log:
                return (log.read(_WAL_HEAD),)
        return (journal.stat().st_mtime_ns, journal.stat().st_size, file.stat().st_mtime_ns)
    except FileNotFoundError:
        return ()


def _writer(file: Path) -> int | None:
    """Return the process that has a recording with a write-ahead log open."""
    try:
        with file.with_name(f"{file.name}-shm").open("rb") as shared:
            asked = struct.pack(_FLOCK, fcntl.F_WRLCK, 0, _DEADMAN_SWITCH, 1, 0)
            kind, _, _, _, process = struct.unpack(_FLOCK, fcntl.fcntl(shared, fcntl.F_GETLK, asked))
    except OSError:
        return None
    return None if kind == fcntl.F_UNLCK else int(process)
