"""The terminal's side of the command line: every line that is printed, and how a run ends.

Nothing else in cli/ prints. What is said passes `core.text.shown`, so that a name in a recording can neither move the
cursor nor forge a line.
"""

import argparse
import logging
import shutil
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from friction_estimator.core.text import LONGEST, LONGEST_PARAGRAPH, shown
from friction_estimator.streams import complain, into_the_void, open_standard_streams, told

PROGRAM = "friction_estimator"

EXIT_CODES = (
    "exit codes: 0 done; 1 ran, but the data cannot answer (a readable recording without the topics or without a "
    "usable sample, an undecidable diagnosis); 2 usage or unreadable input; 70 a fault of the program (--debug shows "
    "the trace); 129, 130, 143 hung up, interrupted, terminated; 141 the reader of the output went away"
)

CLOSED_PIPE = 141


WIDEST_HELP = 100
"""Columns of `--help` at the most: longer lines are hard to read, and a terminal beside another window is no wider."""


class HelpFormatter(argparse.HelpFormatter):
    """Wraps help to the terminal, `WIDEST_HELP` at the most; what is indented stays as it
    is written."""

    def __init__(self, prog: str, **options: Any) -> None:
        columns = min(shutil.get_terminal_size().columns, WIDEST_HELP)
        super().__init__(prog, **{"width": columns - 2, "max_help_position": 28} | options)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs: list[str] = []
        as_written = True
        for line in text.splitlines():
            if line.strip() and not line.startswith(" ") and not as_written:
                paragraphs[-1] += f" {line}"
            else:
                paragraphs.append(line)
            as_written = not line.strip() or line.startswith(" ")
        folded = (
            [one] if one.startswith(" ") or not one else textwrap.wrap(one, width, break_on_hyphens=False)
            for one in paragraphs
        )
        return "\n".join(indent + line for lines in folded for line in lines)


class Parser(argparse.ArgumentParser):
    """An argument parser that reports a usage error in one line and keeps examples as they are written."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("formatter_class", HelpFormatter)
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
        complain(text, LONGEST_PARAGRAPH)
        return
    with _naming_stdout():
        print(shown(text, LONGEST_PARAGRAPH), flush=flush)


def say_document(text: str) -> None:
    """Print a document (JSON, an export) on stdout as it is: whoever made it has made it safe."""
    with _naming_stdout():
        print(text)


def draw(text: str) -> None:
    """Put this in place of the line where the cursor is, on a terminal's stderr; "" empties it."""
    with suppress(OSError, ValueError):  # it was closed: nobody can be told
        sys.stderr.write(f"\r\x1b[2K{shown(text)}")
        sys.stderr.flush()


def warn(text: str) -> None:
    """Print a warning on stderr."""
    complain(f"{PROGRAM}: warning: {text}")


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
    open_standard_streams()
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
        into_the_void(sys.stdout)
        return CLOSED_PIPE
    except (Exception, KeyboardInterrupt) as error:
        _settle()
        return told(name, error, debug=debug)


@contextmanager
def stopped_by_signals(stop: Callable[[], object]) -> Iterator[None]:
    """Turn SIGINT and SIGTERM into a call of `stop` for as long as the block lasts: so a view or a playback ends."""
    with _answered((signal.SIGINT, signal.SIGTERM), lambda *_: stop()):
        yield


@contextmanager
def _answered(numbers: Sequence[signal.Signals], handler: Callable[[int, object], object]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


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
        into_the_void(sys.stdout)


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
    with _answered(numbers, leave):
        yield
