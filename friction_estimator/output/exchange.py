"""Put what was built aside under its name in one step, and durably."""

import ctypes
import errno
import os
import shutil
import stat
from contextlib import suppress
from pathlib import Path

_AT_FDCWD = -100
_NOREPLACE, _EXCHANGE = 1, 2  # flags of renameat2(2)

_UNSUPPORTED = {errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP}
"""What renameat2 answers where the kernel (before 3.15) or the file system (NFS, some of FUSE) cannot."""

_LIBC = ctypes.CDLL(None, use_errno=True)


def put_file(part: Path, target: Path) -> None:
    """Give the file `part` the name `target`, in place of what stands there; both are on one file system.

    Whoever opens `target` meanwhile gets the former file or the new one. On return both content and name are on disk.
    The new file has the former one's permissions. Raises OSError.
    """
    with suppress(FileNotFoundError):
        part.chmod(stat.S_IMODE(target.stat().st_mode))
    _sync(part)
    part.replace(target)
    _sync(target.parent)


def put_folder(part: Path, target: Path, former: Path) -> None:
    """Give the folder `part` the name `target`; what stood there is `former` afterwards. All are on one file system.

    On return content and name are on disk, and the new folder has the former one's permissions. Raises OSError; the
    former folder then is in its place.
    """
    sync_tree(part)
    if target.exists():
        part.chmod(stat.S_IMODE(target.stat().st_mode))
        exchange(part, target, former)
    elif not _renamed(part, target, _NOREPLACE):
        part.rename(target)
    _sync(target.parent)


def exchange(part: Path, target: Path, former: Path) -> None:
    """Give the folder `part` the name `target`, and the folder that stood there the name `former`.

    Where the system exchanges two names in one step, whoever opens `target` meanwhile gets the former folder or the new
    one. Elsewhere two renames do it: for a moment there is none, and `restore` brings the former back where a process
    died in between. Raises OSError; the former folder then is in its place.
    """
    if _renamed(part, target, _EXCHANGE):
        part.rename(former)
        return
    try:
        target.rename(former)
        part.rename(target)
    except BaseException:  # an interrupt, too
        restore(target, former)
        raise


def restore(target: Path, former: Path) -> None:
    """Bring a former folder back where nothing stands under its name."""
    if former.exists() and not target.exists():
        former.rename(target)
        _sync(target.parent)


def sync_tree(folder: Path) -> None:
    """Flush every file and folder below `folder`, and itself, to disk. Raises OSError."""
    for root, _, names in os.walk(folder, topdown=False, onerror=_raise):
        for name in names:
            _sync(Path(root) / name)
        _sync(Path(root))


def remove_tree(path: Path) -> None:
    """Remove a file or folder as far as that is possible; folders that are write-protected, too."""
    if not path.is_dir() or path.is_symlink():
        with suppress(OSError):
            path.unlink()
        return
    try:
        shutil.rmtree(path)
    except OSError:
        for root, _, _ in os.walk(path):
            with suppress(OSError):
                os.chmod(root, stat.S_IRWXU)
        shutil.rmtree(path, ignore_errors=True)


def _renamed(source: Path, target: Path, flag: int) -> bool:
    """Rename by renameat2(2); return False where that does not exist here. Raises OSError where it fails."""
    call = getattr(_LIBC, "renameat2", None)
    if call is None:
        return False
    if call(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), ctypes.c_uint(flag)) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), os.fspath(target))


def _sync(path: Path) -> None:
    """Flush a file or a folder to disk; a file system that has no way to flush a folder is not asked twice."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
            raise
    finally:
        os.close(descriptor)


def _raise(error: OSError) -> None:
    raise error
