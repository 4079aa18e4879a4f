"""What a process shows on stderr, and how it tells a failure: shared by the command line and the node."""

import errno
import io
import os
import sys
import traceback
from typing import IO

from friction_estimator.core.errors import FAULT, exit_code, sentence
from friction_estimator.core.text import LONGEST, shown


class ClosedStdout(io.TextIOBase):
    """Stands for a stdout that was closed before the start: takes what is printed, and says once that it is lost."""

    _lost = False

    def write(self, text: str) -> int:
        """Lose it."""
        self._lost = self._lost or bool(text)
        return len(text)

    def flush(self) -> None:
        """Raise OSError where something was lost since the last time."""
        lost, self._lost = self._lost, False
        if lost:
            raise OSError(errno.EBADF, "it is closed", "stdout")


def open_standard_streams() -> None:
    """Put /dev/null where a standard stream is closed, so that no file that is opened gets its number.

    A library that writes to descriptor 1 or 2 (rcutils logs there) would otherwise write into the user's data. What no
    encoding of the terminal holds is escaped. What the program itself prints on a closed stdout is a failure, as on a
    full disk; a closed stderr can be told nowhere.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    if sys.stdout is None:
        sys.stdout = ClosedStdout()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def complain(text: str, limit: int = LONGEST) -> None:
    """Print a line on stderr; where that is closed too, nobody can be told."""
    try:
        print(shown(text, limit), file=sys.stderr, flush=True)
    except (OSError, ValueError):
        into_the_void(sys.stderr)


def told(name: str, error: BaseException, *, debug: bool) -> int:
    """Tell a failure in one line, which begins with `name`, on stderr; return its exit code.

    With `debug` the trace comes before it.
    """
    code = exit_code(error)
    if debug:
        for line in "".join(traceback.format_exception(error)).splitlines():
            complain(line)
    hint = "" if debug or code != FAULT else "; --debug shows the trace, please report it"
    complain(f"{name}: {sentence(error)}{hint}")
    return code


def into_the_void(stream: IO[str]) -> None:
    """Let the interpreter, which flushes once more at its end, have somewhere to flush to."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):
        return
