"""Single keys from a terminal, which gets its mode back however the reading ends."""

import os
import re
import select
import signal
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

ARROWS = {b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left"}
ARROWS |= {sequence.replace(b"[", b"O"): name for sequence, name in ARROWS.items()}

KEY = re.compile(rb"\x1b[\[O][0-9;]*[@-~]|.", re.DOTALL)
"""One key: what a terminal sends for those that are no character (ECMA-48), or a byte."""

LEAVING = (signal.SIGTSTP, signal.SIGQUIT)
"""Ctrl-Z and Ctrl-\\, which end or suspend the process where no `finally` is passed."""


class Keys:
    """Reads keys as they are pressed; Ctrl-C and its like stay signals.

    A process in the background neither reads nor changes the terminal, which belongs to another one then.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._lock = threading.RLock()  # a signal handler may come upon its own thread
        self._before: list[Any] | None = None
        self._wanted = True
        self._pending = b""

    def read(self, timeout_s: float) -> str:
        """Return the next key as its character or its arrow's name; "" where none was pressed in time."""
        if not self._pending and self._take():
            with suppress(OSError):  # the terminal went away
                if select.select([self._descriptor], [], [], timeout_s)[0]:
                    self._pending = os.read(self._descriptor, 64)
                timeout_s = 0.0
        if not self._pending:
            time.sleep(timeout_s)
        return self._next()

    def _next(self) -> str:
        found = KEY.match(self._pending)
        if found is None:
            return ""
        self._pending = self._pending[found.end() :]
        return ARROWS.get(found[0]) or found[0][:1].decode("ascii", "replace")

    @property
    def _foreground(self) -> bool:
        try:
            return os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:
            return False

    def _take(self) -> bool:
        """Let keys come one by one, unheard by the echo; again where a shell has changed the mode meanwhile."""
        with self._lock, suppress(termios.error):
            if not (self._wanted and self._foreground):
                return False
            mode = termios.tcgetattr(self._descriptor)
            if mode[tty.LFLAG] & termios.ICANON:
                self._before = mode
                tty.setcbreak(self._descriptor, termios.TCSANOW)
            return True
        return False

    def give_back(self) -> None:
        """Restore the terminal as it was, until `want`."""
        with self._lock, suppress(termios.error):
            self._wanted = False
            if self._before is not None and self._foreground:
                termios.tcsetattr(self._descriptor, termios.TCSANOW, self._before)
            self._before = None

    def want(self) -> None:
        """Let `read` take the terminal again."""
        self._wanted = True


@contextmanager
def keys() -> Iterator[Keys | None]:
    """Yield the keys of the terminal at stdin; None where it is none. To be used by the main thread."""
    if sys.stdin is None or not sys.stdin.isatty():
        yield None
        return
    made = Keys(sys.stdin.fileno())
    try:
        with _given_back_before_leaving(made):
            yield made
    finally:
        made.give_back()


@contextmanager
def _given_back_before_leaving(made: Keys) -> Iterator[None]:
    def leave(number: int, _frame: object) -> None:
        made.give_back()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, leave)  # it was suspended, and goes on
        made.want()

    before = {number: signal.signal(number, leave) for number in LEAVING if signal.getsignal(number) != signal.SIG_IGN}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
