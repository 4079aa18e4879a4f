"""The staging folder beside an output: where it is built, whose it is, and how what dead processes left is swept."""

import errno
import fcntl
import hashlib
import os
import shlex
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

from friction_estimator.core.errors import InputError
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.output.exchange import exchange, put_file, put_folder, remove_tree, restore

_HEADER = "friction_estimator/staging/1\n"
_OWNER, _NEW, _FORMER, _JOURNAL = "owner", "new", "former", "rows"

_LONGEST_NAME = 200
"""Bytes of an output's name that the name of its staging folder repeats; file systems allow 255."""

_TRIES = 1000
"""How often a folder is taken that its last owner removes at the same moment."""

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}

_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
"""Failures of a write, which name no file."""

_FIXED = {
    errno.EXDEV: "it came with the image of a container, whose file system cannot exchange it: remove it first",
    errno.EBUSY: "it is a mount, which cannot be exchanged: mount the folder that it lies in",
}
"""What cannot be renamed although it can be written to: a folder of a lower layer of overlayfs, a bind mount."""

Refusal = Callable[[Path], str | None]
"""Says why a folder may not be replaced; None where it may."""


class InUseError(InputError):
    """Another process writes this output."""


class Staging:
    """A hidden folder beside an output, which belongs to one process at a time.

    It is a lock: `owner` in it is held by `flock`, so it is free the moment its process ends, however that ends. It is
    the place where the output is built, so that a rename puts it in place. And it is all that a dead process can leave
    behind: who takes it next sweeps it, and removes it at the end. It is known by its content, not by its name alone: a
    folder of that name that lacks the header is somebody else's and is left alone.

    What an unfinished run has computed may outlive it here, as a journal (`output.journal`): whoever takes the folder
    next goes on with it, or, where it does not resume, sweeps it like the rest.

    On a file system without locks everyone gets the folder: two writers at once are then not kept apart.

    Parameters
    ----------
    target : the output's path, without links (see `output.paths.resolved`).
    resumes : whether the journal of an unfinished run is kept: found on entry, left behind until `finish`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     target = Path(folder) / "a.json"
    ...     with Staging(target) as staging:
    ...         for text in ("{}", "[]"):
    ...             with staging.file() as part:
    ...                 _ = part.write_text(text)
    ...     print(target.read_text(), os.listdir(folder))
    [] ['a.json']
    """

    def __init__(self, target: Path, *, resumes: bool = False) -> None:
        self.target = target
        self._resumes = resumes
        name = target.name
        if len(os.fsencode(name)) > _LONGEST_NAME:
            name = hashlib.sha256(os.fsencode(name)).hexdigest()
        self.folder = target.parent / f".{name}.friction_estimator"
        self._descriptor: int | None = None
        self._made: list[Path] = []

    def __enter__(self) -> "Staging":
        """Take the folder and sweep it; raises as `take`."""
        self.take()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the folder up."""
        self.release()

    def take(self) -> None:
        """Take the folder, and sweep what its last owner left in it.

        Raises InUseError where a living process holds it, InputError where it cannot be made.
        """
        try:
            for _ in range(_TRIES):
                self._make_parents()
                if self._taken():
                    self._sweep()
                    self._sign()
                    return
            raise InUseError(f"{self.target} is written by other processes all the time; choose another output")
        except OSError as error:
            self.release()
            raise InputError(f"cannot write {self.target}: {error.strerror}; choose another output path") from error
        except BaseException:
            self.release()
            raise

    @property
    def journal(self) -> Path:
        """The journal's file; whoever holds the folder writes it."""
        return self.folder / _JOURNAL

    def finish(self) -> None:
        """Remove the journal: what it was kept for is in place."""
        remove_tree(self.journal)

    def release(self) -> None:
        """Remove the folder, and the parents that were made for nothing; whoever wants it next may have it.

        A folder with the journal of an unfinished run stays.
        """
        if self._descriptor is not None:
            for name in (_NEW, _FORMER):
                remove_tree(self.folder / name)
            if not (self._resumes and self.journal.exists()):
                self.finish()
                with suppress(OSError):
                    (self.folder / _OWNER).unlink()
                with suppress(OSError):
                    self.folder.rmdir()
            os.close(self._descriptor)
            self._descriptor = None
        for parent in reversed(self._made):
            with suppress(OSError):
                parent.rmdir()  # as long as it is empty
        self._made = []

    @contextmanager
    def file(self) -> Iterator[Path]:
        """Yield a path for a file; it replaces the target when the block ends without an exception.

        Raises InputError where it cannot be written, or a folder stands there.
        """
        with self._part() as part:
            yield part
            put_file(part, self.target)

    @contextmanager
    def replacement(self, refusal: Refusal) -> Iterator[Path]:
        """Yield a path for a folder; it replaces the target when the block ends without an exception.

        The former folder goes when the staging folder is given up: until then whoever reads it can go on.

        Parameters
        ----------
        refusal : asked before and after the exchange, so that what came into the former folder meanwhile is kept.

        Raises InputError where it cannot be written, or what stands there may not be replaced.
        """
        former = self.folder / _FORMER
        with self._part() as part:
            remove_tree(former)
            yield part
            refuse(self.target, refusal)
            put_folder(part, self.target, former)
            reason = refusal(former) if former.exists() else None
            if reason is not None:
                exchange(former, self.target, part)
                raise InputError(f"cannot replace {self.target}: {reason}")

    @contextmanager
    def _part(self) -> Iterator[Path]:
        """Yield a path to build under, of the target's name; whatever is left there is removed."""
        self._keep()
        new = self.folder / _NEW
        try:
            new.mkdir()
            yield new / self.target.name
        except OSError as error:
            if error.errno in _NO_ROOM or _within(error.filename, self.folder) or error.filename == str(self.target):
                reason = _FIXED.get(error.errno or 0) or error.strerror or error
                raise InputError(f"cannot write {self.target}: {reason}; choose another output path") from error
            raise
        finally:
            remove_tree(new)

    def _keep(self) -> None:
        """Take the folder anew where somebody removed or moved it: another process may have it by now (see `take`)."""
        if self._descriptor is None or not self._is_owner(self._descriptor):
            if self._descriptor is not None:
                os.close(self._descriptor)
            self._descriptor = None
            self.take()

    def _is_owner(self, descriptor: int) -> bool:
        """Whether the file that this process has locked is still the one in the folder."""
        try:
            return os.path.samestat(os.fstat(descriptor), (self.folder / _OWNER).lstat())
        except OSError:
            return False

    def _make_parents(self) -> None:
        missing = [parent for parent in self.target.parents if not parent.exists()]
        for parent in reversed(missing):
            with suppress(FileExistsError):
                parent.mkdir()
                self._made.append(parent)

    def _taken(self) -> bool:
        """Try to become the owner; False where the last one was about to remove the folder."""
        try:
            self.folder.mkdir(stat.S_IRWXU)
        except FileExistsError:
            pass
        except FileNotFoundError:  # a parent is gone, removed by a process that had made it for nothing
            return False
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            if not stat.S_ISDIR(self.folder.lstat().st_mode):
                raise self._foreign()
            descriptor = os.open(self.folder / _OWNER, flags, 0o644)
        except FileNotFoundError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = _signature(descriptor)
            os.close(descriptor)
            raise InUseError(f"{self.target} is in use by {holder}: wait for it, or choose another output") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
        if not self._is_owner(descriptor):
            os.close(descriptor)
            return False
        content = os.pread(descriptor, len(_HEADER), 0).decode(errors="replace")
        # Signed after it was swept: an empty file stands alone.
        if content != _HEADER and (content or len(os.listdir(self.folder)) > 1):
            if not content:
                (self.folder / _OWNER).unlink()
            os.close(descriptor)
            raise self._foreign()
        self._descriptor = descriptor
        return True

    def _foreign(self) -> InputError:
        return InputError(
            f"cannot write {self.target}: it is built in {self.folder}, which stands there and is not this program's; "
            "move that away"
        )

    def _sweep(self) -> None:
        restore(self.target, self.folder / _FORMER)
        for name in os.listdir(self.folder):
            if name != _OWNER and not (self._resumes and name == _JOURNAL):
                remove_tree(self.folder / name)

    def _sign(self) -> None:
        assert self._descriptor is not None
        command = shlex.join([os.path.basename(sys.argv[0]), *sys.argv[1:]])
        text = f"{_HEADER}process {os.getpid()} ({shown(command, LONGEST_NAME)})\n"
        signed = text.encode()
        # Never empty once it was signed: beside a journal an empty one would be somebody else's.
        os.pwrite(self._descriptor, signed, 0)
        os.ftruncate(self._descriptor, len(signed))


def refuse(target: Path, refusal: Refusal) -> None:
    """Raise InputError where what stands under `target` may not be replaced by a folder."""
    reason = None
    if target.is_dir():
        reason = refusal(target)
    elif target.exists():
        reason = "a file stands there, not a folder; choose another name"
    if reason is not None:
        raise InputError(f"cannot replace {target}: {reason}")


def _signature(descriptor: int) -> str:
    """Return who has signed the owner's file."""
    lines = os.pread(descriptor, 4096, 0).decode(errors="replace").splitlines()
    return shown(lines[1]) if len(lines) > 1 else "another process"


def _within(name: object, folder: Path) -> bool:
    return isinstance(name, str | bytes | os.PathLike) and folder in Path(os.fsdecode(name)).parents
