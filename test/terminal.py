"""A terminal of its own for a child process: what a person would see and press."""

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Callable
from typing import Any

LIMIT_S = 60.0


def _as_from_a_terminal() -> None:
    """Take the terminal, and the signals that whoever started the tests in the background ignores."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    for number in (signal.SIGINT, signal.SIGQUIT):
        signal.signal(number, signal.SIG_DFL)


class Terminal:
    """A pseudo-terminal, and what was written to it so far; use as a context manager.

    Attributes
    ----------
    process : the child, leader of the terminal's session.
    """

    def __init__(self, command: list[str], environment: dict[str, str], columns: int = 120, rows: int = 40) -> None:
        self._master, self._slave = pty.openpty()
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self.untouched = self.mode()
        self._seen = b""
        # Both would be believed before the terminal itself.
        environment = {name: value for name, value in environment.items() if name not in ("COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            command, env=environment, stdin=self._slave, stdout=self._slave, stderr=self._slave,
            start_new_session=True,
            preexec_fn=_as_from_a_terminal,  # noqa: PLW1509 - takes no lock
        )  # fmt: skip

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(LIMIT_S)
        os.close(self._master)
        os.close(self._slave)

    def mode(self) -> list[Any]:
        """Return the terminal's mode, as `stty` sets it."""
        return termios.tcgetattr(self._slave)

    def press(self, keys: bytes) -> None:
        """Type something."""
        os.write(self._master, keys)

    def screen(self) -> str:
        """Return all that was written so far."""
        while select.select([self._master], [], [], 0)[0]:
            self._seen += os.read(self._master, 65536)
        return self._seen.decode(errors="replace")

    def await_(self, condition: Callable[[str], Any], what: str) -> Any:
        """Return the first true value of a condition on what was written; fails with `what`."""
        deadline = time.monotonic() + LIMIT_S
        while not (value := condition(self.screen())):
            assert time.monotonic() < deadline, f"not within {LIMIT_S:g} s: {what}\n{self.screen()[-3000:]}"
            time.sleep(0.01)
        return value

    def ended(self) -> int:
        """Wait for the end of the child; return its exit code."""
        self.await_(lambda _: self.process.poll() is not None, "the end of the process")
        return self.process.returncode
