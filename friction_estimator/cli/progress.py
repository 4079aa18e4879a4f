"""Progress on a terminal: a bar for what is counted, and a line of its own while sample loops are compiled.

In a pipe there is neither.
"""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from friction_estimator.cli.terminal import draw
from friction_estimator.compiling import COMPILATION
from friction_estimator.core.text import shown

if TYPE_CHECKING:
    from tqdm import tqdm

LONGEST_LABEL = 60
"""Characters before a progress bar."""

REDRAW_S = 0.2

WORTH_TELLING_S = 0.3
"""What takes less is over before it is read."""

USUAL_S = 20
"""Processor time that a first `replay` spent on its loops: 22 s on a 2 GHz server core, numba 0.68. A quiet machine
takes about as long; whoever waits sees by the seconds beside it what this one makes of it."""


SETTLED_S = 0.5

UNSETTLED = "{l_bar}{bar}| {n_fmt}/{total_fmt}{unit}"
"""A bar without rate and time left."""


class Advance(Protocol):
    """Takes the amount of work just done, and the amount there is in all where that is known only now."""

    def __call__(self, done: int, total: int | None = None) -> None:
        """Advance by `done`."""


_open: "dict[tqdm[Any], float]" = {}
"""Bars on the terminal, and how much of the compilation is taken out of their time, s."""


def _unseen(done: int, total: int | None = None) -> None:
    """Advance nothing."""


@contextmanager
def progress(label: str, total: int | None = None, unit: str = "samples") -> Iterator[Advance]:
    """Yield an `Advance`; it moves a bar on a terminal and does nothing in a pipe, nor where the total is zero.

    The time that is left is told only when `SETTLED_S` of counted work have been seen: opening a file, loading code
    and compiling it say nothing of the rate.
    """
    if not sys.stderr.isatty() or total == 0:
        yield _unseen
        return
    from tqdm import tqdm  # noqa: PLC0415 - `--help` needs none

    with tqdm(
        total=total,
        desc=shown(label, LONGEST_LABEL),
        unit=f" {unit}",
        unit_scale=True,
        leave=False,
        file=sys.stderr,
        bar_format=UNSETTLED,
        miniters=1,  # by time alone: a step of minutes may follow one of milliseconds
    ) as bar:

        def advance(done: int, total: int | None = None) -> None:
            if total is not None and total != bar.total:
                bar.total = total
                bar.start_t = bar.last_print_t = time.time()  # what came before was no part of it
                bar.refresh()
            _without_compilation(bar)
            if bar.bar_format and bar.format_dict["elapsed"] > SETTLED_S:
                bar.bar_format = None
            bar.update(done)

        _open[bar] = COMPILATION.seconds
        try:
            yield advance
        finally:
            del _open[bar]


def _without_compilation(bar: "tqdm[Any]") -> None:
    """Let the bar's clock start later by what was compiled since it was last asked, so that no rate counts it."""
    seconds = COMPILATION.seconds
    lost, _open[bar] = seconds - _open[bar], seconds
    bar.start_t += lost
    bar.last_print_t += lost


@contextmanager
def compilation_told() -> Iterator[None]:
    """Say on a terminal, in place of a bar, that sample loops are being compiled, for as long as they are."""
    if not sys.stderr.isatty():
        yield
        return
    line = _Line()
    COMPILATION.on_end = line.erase
    ended = threading.Event()
    teller = threading.Thread(target=line.tell, args=(ended,), daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()
        COMPILATION.on_end = lambda: None


class _Line:
    """The line that stands where a bar stands otherwise."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._drawn = ""

    def tell(self, ended: threading.Event) -> None:
        """Draw it again and again while something is compiled; to be run beside that."""
        while not ended.wait(REDRAW_S):
            once = f"compiling once (about {USUAL_S} s, kept for later runs)" if COMPILATION.kept else "compiling"
            with self._lock:
                line = f"{once}: {COMPILATION.seconds:.0f} s"
                if COMPILATION.active and COMPILATION.seconds > WORTH_TELLING_S and line != self._drawn:
                    draw(line)
                    self._drawn = line

    def erase(self) -> None:
        """Remove it before anything else is printed; what stood there comes back."""
        with self._lock:
            if self._drawn:
                self._drawn = ""
                draw("")
                for bar in list(_open):
                    _without_compilation(bar)
                    bar.refresh()
