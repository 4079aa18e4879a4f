"""The terminal's side of the command line: every line that is printed, and how a run ends.

Nothing else in cli/ prints. What is said passes `core.text.shown`, so that a name in a recording can neither move the
cursor nor forge a line.
"""

import argparse
import logging
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any, NoReturn

from friction_estimator.core.errors import FAULT, exit_code, sentence
from friction_estimator.core.text import LONGEST, shown

PROGRAM = "friction_estimator"

EXIT_CODES = """exit codes: 0 done; 1 ran, but the data cannot answer (a readable recording without the topics
or without a usable sample, an undecidable diagnosis); 2 usage or unreadable input; 70 a fault of the
program (--debug shows the trace); 129, 130, 143 hung up, interrupted, terminated;
141 the reader of the output went away"""

LONGEST_LINE = 20_000
"""Characters of one line of a result: it may hold a command with many recordings, which is copied."""

CLOSED_PIPE = 141


class Parser(argparse.ArgumentParser):
    """An argument parser that reports a usage error in one line and keeps examples as they are written."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        kwargs.setdefault("allow_abbrev", False)
        super().__init__(*args, **kwargs)
        # `guarded` looks for it itself: it must know before the options can be parsed.
        self.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="print warnings, and the trace of a failure"
        )

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and exit with code 2."""
        remedy = f" (see {self.prog} --help)"
        complain(f"{self.prog}: {shown(message, LONGEST - len(self.prog) - len(remedy) - 2)}{remedy}")
        self.exit(2)


def say(text: str, *, aside: bool = False, flush: bool = False) -> None:
    """Print a line of the result on stdout, or beside a result on stderr; `flush` where somebody waits for it."""
    if aside:
        complain(text, LONGEST_LINE)
        return
    with _naming_stdout():
        print(shown(text, LONGEST_LINE), flush=flush)


def say_document(text: str) -> None:
    """Print a document (JSON, an export) on stdout as it is: whoever made it has made it safe."""
    with _naming_stdout():
        print(text)


def warn(text: str) -> None:
    """Print a warning on stderr."""
    complain(f"{PROGRAM}: warning: {text}")


def complain(text: str, limit: int = LONGEST) -> None:
    """Print a line on stderr; where that is closed too, nobody can be told."""
    try:
        print(shown(text, limit), file=sys.stderr, flush=True)
    except (OSError, ValueError):
        _into_the_void(sys.stderr)


def guarded(name: str, body: Callable[[], int], arguments: Sequence[str] = ()) -> int:
    """Run a verb; turn any failure into one line on stderr and an exit code.

    Parameters
    ----------
    name : of the program and verb, which begins the line.
    body : returns the exit code.
    arguments : of the command line; with `--debug` among them the trace is printed before the line.

    Returns
    -------
    The code of `body`, or that of its failure (`core.errors.exit_code`): 130 for an interrupt, 141 for a reader that
    went away, 143 for SIGTERM and 129 for SIGHUP after the temporary files are gone.
    """
    debug = "--debug" in arguments
    _open_standard_streams()
    try:
        with _orderly_termination(), _libraries_quiet(debug):
            try:
                code = body()
            except SystemExit:  # `--help` has printed, too
                _flush()
                raise
            _flush()
            return code
    except BrokenPipeError:
        _into_the_void(sys.stdout)
        return CLOSED_PIPE
    except (Exception, KeyboardInterrupt) as error:
        code = exit_code(error)
        if debug:
            for line in traceback.format_exc().splitlines():
                complain(line)
        hint = "" if debug or code != FAULT else "; --debug shows the trace, please report it"
        _settle()
        complain(f"{name}: {sentence(error)}{hint}")
        return code


@contextmanager
def _naming_stdout() -> Iterator[None]:
    """Say in a failure of writing what it is about; a reader that went away is told by its kind."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, "stdout") from error


def _flush() -> None:
    if sys.stdout is not None:
        with _naming_stdout():
            sys.stdout.flush()


def _settle() -> None:
    """Print what waits for stdout; where that is impossible (a full disk), it is let go."""
    try:
        _flush()
    except OSError:
        _into_the_void(sys.stdout)


def _into_the_void(stream: IO[str]) -> None:
    """Let the interpreter, which flushes once more at its end, have somewhere to flush to."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):
        return


def _open_standard_streams() -> None:
    """Put /dev/null where a standard stream is closed, so that no file that is opened gets its number.

    A library that writes to descriptor 1 or 2 would otherwise write into the user's data. What no encoding of the
    terminal holds is escaped.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


@contextmanager
def _libraries_quiet(debug: bool) -> Iterator[None]:
    """Keep warnings and logs of libraries off the terminal, unless they are asked for.

    Filters stay as they are: where a warning is to be an error (in the tests), it is one.
    """
    if debug or sys.warnoptions:
        yield
        return
    before = warnings.showwarning
    handler = logging.NullHandler()
    logging.getLogger().addHandler(handler)
    warnings.showwarning = lambda *_args, **_kwargs: None
    try:
        yield
    finally:
        warnings.showwarning = before
        logging.getLogger().removeHandler(handler)


@contextmanager
def _orderly_termination() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the stack, so that nothing temporary stays behind; `nohup` keeps its meaning."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    numbers = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, leave) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
