"""A recording laid out so that rosbags can read all of it, in bounded memory: plain files, complete files.

What is packed whole (.mcap.zstd, .db3.zstd) is unpacked, and what stands in SQLite's journals is put into the files
(see `write_ahead`), both in a temporary folder: nothing is written beside the user's recording.
"""

import os
import shutil
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from friction_estimator.bag import metadata, write_ahead
from friction_estimator.bag.budget import TooLargeError, megabytes, unpack_file
from friction_estimator.core.errors import InputError


@dataclass(frozen=True)
class Prepared:
    """Where and how a recording is to be read.

    Attributes
    ----------
    path : the recording, or a temporary stand-in.
    files : its storage files.
    packed_messages : every message is packed by itself, with zstd.
    notes : what is worth telling.
    """

    path: Path
    files: tuple[Path, ...]
    packed_messages: bool = False
    notes: tuple[str, ...] = ()


def prepared(path: Path, stack: ExitStack) -> Prepared:
    """Return how to read a recording; what is temporary lives as long as `stack`.

    Raises
    ------
    InputError where a file is missing, there is no room for what is unpacked, or a recorder writes too fast;
    TooLargeError for what unpacks to more than a recording can; what the readers raise for damaged files.
    """
    if not path.is_dir():
        return _with_journals(Prepared(path, (path,)), stack)
    about = metadata.information(path)
    mode = str(about.get("compression_mode", "")).lower()
    files = tuple(metadata.storage_files(path, about))
    for file in files:
        if file.exists() and not file.is_file():  # a pipe would be waited for, for ever
            raise InputError(f"{path} is damaged: {file.name} is no regular file; run `ros2 bag reindex {path}`")
    if mode in ("", "none"):
        return _with_journals(Prepared(path, files), stack)
    if about.get("compression_format") != "zstd":
        raise InputError(f"{path}: compression {about.get('compression_format')!r} is not supported; unpack it before")
    missing = [file.name for file in files if not file.exists()]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}: copy it there, or run `ros2 bag reindex {path}`")
    folder = _scratch(stack)
    plain = []
    for file in files:
        target = folder / (file.stem if mode == "file" else file.name)
        if mode == "file":
            _unpack(file, target)
        else:
            target.symlink_to(file.absolute())
        plain.append(target)
    about |= {"compression_mode": "", "compression_format": "", "relative_file_paths": [item.name for item in plain]}
    document = yaml.safe_dump({"rosbag2_bagfile_information": about})
    (folder / metadata.NAME).write_text(document, encoding="utf-8")
    whole = _with_journals(Prepared(folder, tuple(plain)), stack)
    return replace(whole, packed_messages=mode == "message")


def _with_journals(given: Prepared, stack: ExitStack) -> Prepared:
    """Return a stand-in with what SQLite's journals hold, where there are any."""
    journals = write_ahead.journals(given.files)
    if not journals:
        return given
    folder = _scratch(stack)
    needed = sum(2 * file.stat().st_size + journal.stat().st_size for file, journal in journals.items())
    _check_room(next(iter(journals)), folder, needed)
    files = []
    for file in given.files:
        target = folder / file.name
        if file in journals:
            write_ahead.complete(file, journals[file], target)
        else:
            target.symlink_to(file.absolute())
        files.append(target)
    if given.path.is_dir():
        (folder / metadata.NAME).symlink_to((given.path / metadata.NAME).absolute())
    notes = tuple(write_ahead.told(file, journal) for file, journal in journals.items())
    return Prepared(folder if given.path.is_dir() else files[0], tuple(files), notes=notes)


def _scratch(stack: ExitStack) -> Path:
    return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="friction_estimator_")))


def _unpack(file: Path, target: Path) -> None:
    """Unpack a file that is packed whole."""
    try:
        with file.open("rb") as packed, target.open("wb") as plain:
            for piece in unpack_file(packed, os.fstat(packed.fileno()).st_size):
                _check_room(file, target.parent, len(piece))
                plain.write(piece)
    except TooLargeError as error:
        raise InputError(f"{file} unpacks to {error}: no recording does") from error


def _check_room(file: Path, folder: Path, needed: int) -> None:
    if needed > shutil.disk_usage(folder).free:
        raise InputError(
            f"{file} cannot be read where it is, and a copy of it finds no room in {folder.parent} "
            f"({megabytes(needed)} are needed now); set TMPDIR to a larger disk"
        )
