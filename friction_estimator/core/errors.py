"""Failures, and the one place that turns any of them into a sentence and an exit code.

A failure that a user can cause is a `FrictionEstimatorError`: it says what is wrong, where, and what to do.
"""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from friction_estimator.core.text import shown

PACKAGE = "friction_estimator"

_HOME = Path(__file__).parents[1]

EXTRAS = {
    "rclpy": "ros",
    "bokeh": "page",
    "jinja2": "page",
    "rich": "terminal",
    "pyarrow": "parquet",
    "distributed": "cluster",
}
"""Modules that not every installation has -> extra of setup.py that brings them."""

FAULT = 70
"""Exit code of what should not happen: a fault of the program (EX_SOFTWARE of sysexits.h)."""


class FrictionEstimatorError(Exception):
    """Base of all expected failures: one sentence for the user, and the exit code of the command line.

    Parameters
    ----------
    what : what is wrong; may name file and remedy itself.
    where : file, topic or parameter that it is about, where `what` does not name it.
    remedy : what to do, where `what` does not say it.

    Examples
    --------
    >>> print(InputError("no column v", where="rig.csv", remedy="choose one of t, f"))
    rig.csv: no column v; choose one of t, f
    """

    exit_code = 2

    def __init__(self, what: str = "", *, where: object = "", remedy: str = "") -> None:
        super().__init__(what)
        self.what, self.where, self.remedy = what, str(where), remedy

    def __str__(self) -> str:
        named = not self.where or self.where in self.what or shown(self.where) in self.what
        place = "" if named else f"{self.where}: "
        return f"{place}{self.what}" + (f"; {self.remedy}" if self.remedy else "")


class InputError(FrictionEstimatorError):
    """Usage or unreadable input (exit code 2)."""


class ConfigError(InputError):
    """A configuration value that cannot be used; names the parameter and the reason (exit code 2)."""


class UnanswerableError(FrictionEstimatorError):
    """Readable data that cannot answer: no such topic, no usable sample (exit code 1)."""

    exit_code = 1


@contextmanager
def about(where: object) -> Iterator[None]:
    """Name what was worked on in every failure that passes and does not name it itself.

    >>> try:
    ...     with about("a.mcap"):
    ...         raise UnanswerableError("no usable sample")
    ... except UnanswerableError as error:
    ...     print(error)
    a.mcap: no usable sample
    """
    try:
        yield
    except FrictionEstimatorError as error:
        error.where = error.where or str(where)
        raise
    except Exception as error:
        if not hasattr(error, "__notes__"):
            error.add_note(str(where))
        raise


def sentence(error: BaseException) -> str:
    """Return a failure of any kind as one safe line: where, what, and what to do where that is known.

    >>> sentence(PermissionError(13, "Permission denied", "/etc/x"))
    'cannot use /etc/x: Permission denied'
    """
    return shown(_words(error))


def exit_code(error: BaseException) -> int:
    """Return how a failure ends a program: 1, 2, `FAULT`, or 130 for an interrupt."""
    if isinstance(error, FrictionEstimatorError):
        return error.exit_code
    if isinstance(error, KeyboardInterrupt):
        return 130
    return FAULT if is_fault(error) else 2


def is_fault(error: BaseException) -> bool:
    """Return True where an exception is nothing that a user or the machine has caused, but a fault of the program."""
    if isinstance(error, ModuleNotFoundError):
        return _missing(error) == PACKAGE
    if isinstance(error, OSError):
        return error.strerror is None
    return not isinstance(error, FrictionEstimatorError | KeyboardInterrupt | MemoryError)


def _words(error: BaseException) -> str:
    if isinstance(error, FrictionEstimatorError):
        return str(error)
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    place = "".join(f"{note}: " for note in getattr(error, "__notes__", ())[:1])
    if is_fault(error):
        text = str(error)
        return f"{place}a fault of the program{_line(error)}: {type(error).__name__}{f': {text}' if text else ''}"
    if isinstance(error, MemoryError):
        return f"{place}not enough memory: give a shorter recording or a smaller table"
    if isinstance(error, ModuleNotFoundError):
        return f"needs the Python module {_missing(error)}, which is not installed: {how_to_install(_missing(error))}"
    name = getattr(error, "filename", None)
    # A file name given as bytes is shown as the text that it stands for.
    file = f" {name.decode(errors='surrogateescape') if isinstance(name, bytes) else name}" if name else " a file"
    return f"{place}cannot use{file}: {getattr(error, 'strerror', '')}"


def how_to_install(module: str) -> str:
    """Return what to do where a module is missing.

    >>> how_to_install("bokeh")
    "pip install 'friction_estimator[page]'"
    """
    extra = EXTRAS.get(module)
    if extra is None:
        return "see README.md"
    told = f"pip install '{PACKAGE}[{extra}]'"
    return f"source a ROS 2 setup, or {told}" if module == "rclpy" else told


def _missing(error: ModuleNotFoundError) -> str:
    return str(error.name).partition(".")[0]


def _line(error: BaseException) -> str:
    """Return where in this package an exception came from, in brackets."""
    frames = traceback.extract_tb(error.__traceback__)
    for frame in reversed(frames):
        file = Path(frame.filename)
        if file.is_relative_to(_HOME):
            return f" ({file.relative_to(_HOME).as_posix()} line {frame.lineno})"
    return ""
