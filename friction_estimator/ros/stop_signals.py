"""SIGINT, SIGTERM and SIGHUP as a wish to stop (docs/decisions/0031).

While the node starts there is nothing to save, and it is ended at once, wherever it is: in the middle of a compilation
too, during which Python itself does not look at signals for seconds. Once it stands the wish is only noted.
"""

import contextlib
import os
import signal
import threading
from types import FrameType

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Signal handlers of a process whose start can be cut short.

    Attributes
    ----------
    stopping : whether a signal has come.
    scratch : a folder to remove if the start is cut short; empty: none.
    """

    def __init__(self) -> None:
        self.stopping = False
        self.scratch = ""
        self._starting = True
        self._deciding = threading.Lock()
        # The interpreter's C handler writes to this pipe at once, whatever the main thread is doing.
        reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(reading,), daemon=True, name="stop signals").start()
        for number in NUMBERS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup
                signal.signal(number, self._received)

    def started(self) -> None:
        """From now on, only note the wish."""
        with self._deciding:
            self._starting = False
        signal.set_wakeup_fd(-1)
        os.close(self._writing)  # which ends the watching thread

    def _received(self, _number: int, _frame: FrameType | None) -> None:
        self.stopping = True

    def _watch(self, reading: int) -> None:
        with contextlib.suppress(OSError), open(reading, "rb", buffering=0) as signals:
            while signals.read(1):
                with self._deciding:
                    if self._starting:
                        if self.scratch:
                            import shutil  # noqa: PLC0415 - a slow one, and the handlers come first

                            shutil.rmtree(self.scratch, ignore_errors=True)
                        os._exit(0)
