"""`njit` as everywhere in this package: numba's, with a cache that no damage, no missing permission and no full disk
can turn into a failure (docs/decisions/0060).

numba's own cache ends the program where it finds no folder to write to, where a file in it was cut short and where
the disk is full. Here the folder is chosen once, each compiled form is one file with a checksum, and whatever cannot
be read or written is compiled anew.
"""

import contextlib
import hashlib
import os
import pickle
import stat
import tempfile
import time
from collections.abc import Callable
from functools import cache as remembered
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numba
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator, _SourceFileBackedLocatorMixin
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.np import linalg

from friction_estimator.compiling import COMPILATION

NAME = "friction_estimator"

GIVEN = "NUMBA_CACHE_DIR"

IN_TREE = "__pycache__"

CHECKSUM_BYTES = hashlib.sha256().digest_size

ABANDONED_S = 600.0
"""A file that is being written takes milliseconds; one of this age was left by a process that was killed."""


def njit(*signatures: Any, cache: bool = False, restrict: bool = False, **options: Any) -> Any:
    """Compile a function in numba's nopython mode.

    Parameters
    ----------
    signatures : one, to compile at once; none, to compile for the arguments of each first call.
    cache : keep the compiled forms on disk.
    restrict : as C's word: the arrays that it is handed overlap nowhere. Vector loops then begin at once; a caller
        that breaks the promise gets wrong results.
    options : as of `numba.njit`.

    Examples
    --------
    >>> @njit(cache=True)
    ... def doubled(x):
    ...     return 2 * x
    >>> doubled(21)
    42
    """

    def compiled(function: Callable[..., Any]) -> Any:
        # Without the wrapper for callers in C, of whom there are none: a tenth of the compilation.
        dispatcher = numba.njit(no_cfunc_wrapper=True, **options)(function)
        if restrict and hasattr(dispatcher, "_compiler"):
            dispatcher._compiler._customize_flags = _without_overlap
        # numba would search all that is installed for extensions with types of their own: no argument here has one.
        dispatcher._compilation_chain_init_hook = _nothing
        if cache and hasattr(dispatcher, "enable_caching"):  # a plain function where NUMBA_DISABLE_JIT is set
            with contextlib.suppress(RuntimeError):  # no folder for it: compiled at every start
                dispatcher._cache = _CheckedCache(function)
        for signature in signatures:
            dispatcher.compile(signature)
        if signatures and hasattr(dispatcher, "disable_compile"):
            dispatcher.disable_compile()
        return dispatcher

    return compiled


def entry(dispatcher: Any, *types: Any) -> Any:
    """Return the compiled form for arguments of these types, to be called without a look at what it is handed.

    Of a call of some ten nanoseconds of work numba spends 0.3 us on which form is the right one.

    Parameters
    ----------
    dispatcher : what `njit` returned.
    types : of numba, one an argument. Numbers that are handed over are converted to them.

    >>> half = entry(njit()(lambda x: x / 2), numba.float64)
    >>> half(3)
    1.5
    """
    return dispatcher.compile(types) if hasattr(dispatcher, "compile") else dispatcher


def _nothing() -> None:
    """Do nothing."""


def _without_overlap(flags: Any) -> Any:
    """Return numba's flags with the one that no option of `numba.njit` sets."""
    flags.noalias = True
    return flags


def cache_folder(source: Path) -> Path | None:
    """Return the folder for what is compiled from `source`; None where nothing can be written.

    The first that can be written to: NUMBA_CACHE_DIR; `__pycache__` beside the source; the user's cache; a folder in
    the temporary one that belongs to this user alone.
    """
    return _usable_folder(source.parent)


@remembered
def _usable_folder(folder: Path) -> Path | None:
    for candidate in _candidates(folder):
        try:
            candidate.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=candidate).close()
        except OSError:
            continue
        return candidate
    return None


def _candidates(folder: Path) -> list[Path]:
    inside, found = subfolder(folder), []
    if given := os.environ.get(GIVEN):
        found.append(Path(given).absolute() / inside)
    found.append(folder / IN_TREE)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.path.isabs(home):  # a user without a home leaves the tilde as it is
        found.append(Path(home) / NAME / inside)
    if temporary := private_folder():
        found.append(temporary / inside)
    return found


def subfolder(folder: Path) -> str:
    """Return the name of the cache folder that stands for a folder of sources."""
    return f"{folder.name}_{hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]}"


def private_folder() -> Path | None:
    """Return this user's own folder in the temporary one; None where there is none that nobody else can write to.

    What is read from the cache is executed, so a folder that another user made in advance must not be taken.
    """
    try:
        temporary = Path(tempfile.gettempdir())
        if temporary == Path.cwd():  # its last resort, which is no place for this
            return None
        folder = temporary / f"{NAME}-{os.getuid()}"
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own else None


# Whether there is a BLAS numba finds out by importing scipy.linalg: 0.1 s of every start. scipy is a requirement here,
# and what a compiled form calls of it is looked up when it is called.
linalg.ensure_blas = lambda: None


class _Reporter(event.Listener):  # type: ignore[misc]
    """Tells `COMPILATION` when numba compiles: not when it loads what was compiled before."""

    def on_start(self, event: Any) -> None:
        """Take the begin of one function's compilation."""
        COMPILATION.begin(kept=isinstance(event.data["dispatcher"]._cache, _CheckedCache))

    def on_end(self, event: Any) -> None:  # noqa: ARG002 - numba's signature
        """Take its end; it comes after a failure too."""
        COMPILATION.end()


event.register("numba:compile", _Reporter())


class _Locator(_SourceFileBackedLocatorMixin, _CacheLocator):  # type: ignore[misc]
    """Where the compiled forms of one function are; what tells functions of one name apart is numba's."""

    def __init__(self, function: Callable[..., Any], source: str, folder: Path) -> None:
        self._py_file = source
        self._lineno = function.__code__.co_firstlineno
        self._folder = folder
        # An installation that was warmed before it became read-only, unless the user wants another place.
        self.readable = [folder] if os.environ.get(GIVEN) else [folder, Path(source).parent / IN_TREE]

    def get_cache_path(self) -> str:
        return str(self._folder)

    @classmethod
    def from_function(cls, function: Callable[..., Any], source: str) -> "_Locator | None":
        folder = cache_folder(Path(source)) if os.path.exists(source) else None
        return None if folder is None else cls(function, source, folder)


class _Located(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _CheckedCache(FunctionCache):  # type: ignore[misc]
    """Compiled forms of one function, each in a file of its own; see `_Files`."""

    _impl_class = _Located

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._impl.locator.readable, self._impl.filename_base, _stamp(function))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return a compiled form, None where there is none that can be used.

        numba's own method first makes ready what a compiler needs, a quarter of every start; whatever is compiled makes
        that ready itself, and what was compiled needs no more than numba's memory management.
        """
        try:
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # whatever numba or pickle say of it: compiling anew is always possible
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled form where that is possible."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def _stamp(function: Callable[..., Any]) -> str:
    """Return a digest of all that the compiled form of a function follows from.

    These are the source files of the function, of all compiled ones that it calls and of the modules whose names it
    reads, and the constants that it reads, wherever they were imported from. numba looks at the function's own file
    only, and so runs old code where a function that it calls, or a constant that it reads, has changed.
    """
    files: set[str] = set()
    constants: set[str] = set()
    seen: set[object] = set()
    package = function.__module__.partition(".")[0]
    waiting: list[Any] = [function]
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        files.add(one.__code__.co_filename)
        read = _names(one.__code__)
        spaces = [one.__globals__]
        while spaces:
            space = spaces.pop()
            for name in read & space.keys():
                value = space[name]
                if isinstance(value, Dispatcher):
                    waiting.append(value.py_func)
                elif isinstance(value, ModuleType):
                    if value.__name__.partition(".")[0] == package and value.__file__ and (one, value) not in seen:
                        seen.add((one, value))
                        files.add(value.__file__)
                        spaces.append(vars(value))
                elif _is_constant(value):
                    constants.add(f"{name} = {value!r}")
    parts = [*map(_digest, sorted(files)), *(constant.encode() for constant in sorted(constants))]
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def _names(code: CodeType) -> set[str]:
    """Return the global names and attributes that code reads, and those of functions within it."""
    inner = (part for part in code.co_consts if isinstance(part, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _is_constant(value: object) -> bool:
    return isinstance(value, int | float | str) or (isinstance(value, tuple) and all(map(_is_constant, value)))


@remembered
def _digest(file: str) -> bytes:
    return hashlib.sha256(Path(file).read_bytes()).digest()


class _Files:
    """The compiled forms of one function on disk.

    A file holds the checksum of all that follows, a line that says what it was compiled from and for, and numba's
    pickle. There is no index that two starting programs could overwrite for each other.

    Parameters
    ----------
    folders, name : the files are `folder/name.*.nbc`; written to the first folder, read from all.
    stamp : tells versions of the source apart.
    """

    def __init__(self, folders: list[Path], name: str, stamp: str) -> None:
        self._folder, self._readable, self._name, self._stamp = folders[0], folders, name, stamp

    def _place(self, key: tuple[Any, ...]) -> tuple[str, bytes]:
        """Return the file's name for a key of numba (signature, processor, code), and the line that it must hold."""
        signature, processor, code = key
        place = repr((str(signature), processor))
        digest = hashlib.sha256(place.encode()).hexdigest()[:16]
        line = repr((numba.__version__, self._stamp, place, code)).encode() + b"\n"
        return f"{self._name}.{digest}.nbc", line

    def load(self, key: tuple[Any, ...]) -> Any:
        """Return what was saved under this key; None where it is missing, of another source, or damaged."""
        name, line = self._place(key)
        for folder in self._readable:
            try:
                content = (folder / name).read_bytes()
            except OSError:
                continue
            checksum, body = content[:CHECKSUM_BYTES], content[CHECKSUM_BYTES:]
            if hashlib.sha256(body).digest() == checksum and body.startswith(line):
                return pickle.loads(body[len(line) :])
        return None

    def save(self, key: tuple[Any, ...], data: Any) -> None:
        """Write a compiled form, whole or not at all; raises OSError."""
        name, line = self._place(key)
        self._sweep()
        body = line + dumps(data)
        part = self._folder / f"{name}.{os.getpid()}.part"
        try:
            part.write_bytes(hashlib.sha256(body).digest() + body)
            part.replace(self._folder / name)
        except OSError:
            with contextlib.suppress(OSError):
                part.unlink()
            raise

    def flush(self) -> None:
        """Remove all compiled forms of this function."""
        for path in self._folder.glob(f"{self._name}.*.nbc"):
            path.unlink(missing_ok=True)

    def _sweep(self) -> None:
        for path in self._folder.glob(f"{self._name}.*.part"):
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > ABANDONED_S:
                    path.unlink()
