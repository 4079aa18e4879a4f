"""End a run at its n-th file operation: every system call that changes files below a folder is a point to be killed at.

A forked child runs under ptrace(2) and is killed on entry to the call, which then never happens. So the states between
any two changes are seen, whoever makes them: Python, SQLite, a library's C code. x86-64 Linux.
"""

import ctypes
import os
import platform
import signal
import struct
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field

AVAILABLE = sys.platform == "linux" and platform.machine() == "x86_64"

_TRACEME, _SYSCALL, _SETOPTIONS, _GET_SYSCALL_INFO = 0, 24, 0x4200, 0x420E
_SYSGOOD, _TRACECLONE, _EXITKILL = 0x1, 0x8, 0x100000
_WALL = 0x40000000
_ENTRY = 1
_INFO_BYTES = 88

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC

# number: (name, kind of its arguments: descriptor, path, path after a folder's descriptor, or open flags after that)
_CALLS = {
    1: ("write", "fd"), 18: ("pwrite64", "fd"), 20: ("writev", "fd"), 296: ("pwritev", "fd"), 77: ("ftruncate", "fd"),
    74: ("fsync", "fd"), 75: ("fdatasync", "fd"), 73: ("flock", "fd"), 91: ("fchmod", "fd"), 285: ("fallocate", "fd"),
    326: ("copy_file_range", "fd 2"), 40: ("sendfile", "fd"),
    2: ("open", "open"), 257: ("openat", "openat"), 85: ("creat", "path"),
    76: ("truncate", "path"), 82: ("rename", "path"), 83: ("mkdir", "path"), 84: ("rmdir", "path"),
    87: ("unlink", "path"), 86: ("link", "path"), 88: ("symlink", "path 1"), 90: ("chmod", "path"),
    264: ("renameat", "at"), 316: ("renameat2", "at"), 258: ("mkdirat", "at"), 263: ("unlinkat", "at"),
    265: ("linkat", "at"), 268: ("fchmodat", "at"), 280: ("utimensat", "at"),
}  # fmt: skip

_LIBC = ctypes.CDLL(None, use_errno=True)
_LIBC.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_LIBC.ptrace.restype = ctypes.c_long


@dataclass
class Ending:
    """How a run ended.

    Attributes
    ----------
    operations : the calls that it made or was about to make, in order: "name path".
    code : its exit code, or -SIGKILL.
    """

    operations: list[str] = field(default_factory=list)
    code: int | None = None


def run(body: Callable[[], int], folder: str, kill_at: int | None = None) -> Ending:
    """Run `body` in a forked child; kill it on entry to its call number `kill_at` (from 1) below `folder`.

    This process must have no other children. The child's own threads are followed, the processes it starts are not.
    """
    child = os.fork()
    if child == 0:
        _become_traced(body)
    os.waitpid(child, 0)  # its SIGSTOP
    _ptrace(_SETOPTIONS, child, 0, _SYSGOOD | _TRACECLONE | _EXITKILL)
    _ptrace(_SYSCALL, child, 0, 0)
    ending = Ending()
    while True:
        thread, status = os.waitpid(-1, _WALL)
        if os.WIFEXITED(status) or os.WIFSIGNALED(status):
            if thread == child:
                ending.code = os.waitstatus_to_exitcode(status)
                return ending
            continue
        pending = os.WSTOPSIG(status)
        if pending == signal.SIGTRAP | 0x80:
            operation = _operation(thread, folder)
            if operation is not None:
                ending.operations.append(operation)
                if len(ending.operations) == kill_at:
                    os.kill(child, signal.SIGKILL)
                    continue
            pending = 0
        elif pending in (signal.SIGTRAP, signal.SIGSTOP):
            pending = 0  # of the tracing itself
        _ptrace(_SYSCALL, thread, 0, pending)


def _become_traced(body: Callable[[], int]) -> None:
    code = 1
    try:
        _ptrace(_TRACEME, 0, 0, 0)
        os.kill(os.getpid(), signal.SIGSTOP)
        code = body()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _ptrace(request: int, process: int, address: int, data: int) -> None:
    if _LIBC.ptrace(request, process, address, data) < 0:
        number = ctypes.get_errno()
        if number != 3:  # ESRCH: it was killed meanwhile
            raise OSError(number, os.strerror(number), "ptrace")


def _operation(thread: int, folder: str) -> str | None:
    """Return what a thread is about to do, where that changes something below the folder."""
    buffer = ctypes.create_string_buffer(_INFO_BYTES)
    if _LIBC.ptrace(_GET_SYSCALL_INFO, thread, _INFO_BYTES, ctypes.addressof(buffer)) < 0:
        return None
    if buffer.raw[0] != _ENTRY:
        return None
    number, *arguments = struct.unpack_from("<7Q", buffer.raw, 24)
    if number not in _CALLS:
        return None
    name, kind = _CALLS[number]
    if kind.startswith("fd"):
        path = _of_descriptor(thread, arguments[2 if kind == "fd 2" else 0])
    elif kind in ("at", "openat"):
        path = os.path.join(_of_descriptor(thread, arguments[0]), _text(thread, arguments[1]))
    else:
        path = _text(thread, arguments[1 if kind == "path 1" else 0])
    if kind in ("open", "openat") and not arguments[1 if kind == "open" else 2] & _WRITES:
        return None
    inside = path == folder or path.startswith(folder + os.sep)
    return f"{name} {os.path.relpath(path, folder)}" if inside else None


def _of_descriptor(thread: int, number: int) -> str:
    """Return the path of an open descriptor; of AT_FDCWD the current folder."""
    signed = ctypes.c_int(number & 0xFFFFFFFF).value
    try:
        return os.readlink(f"/proc/{thread}/cwd" if signed == -100 else f"/proc/{thread}/fd/{signed}")
    except OSError:
        return ""


def _text(thread: int, address: int) -> str:
    """Return the string that stands at an address of another process."""
    with open(f"/proc/{thread}/mem", "rb", buffering=0) as memory:
        memory.seek(address)
        return os.fsdecode(memory.read(4096).partition(b"\0")[0])
