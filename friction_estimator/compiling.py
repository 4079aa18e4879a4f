"""What is known of compilation while it lasts: since when, and how much time it took in all.

Whatever measures or shows a duration leaves that time out. This module imports nothing, so that a verb that compiles
nothing need not load numba to ask.
"""

import threading
import time
from collections.abc import Callable


class Compilation:
    """Counts the time during which anything is being compiled.

    Attributes
    ----------
    kept : whether the next run will find what is being compiled on disk.
    on_end : called by whoever compiled when nothing is compiled any more.
    """

    def __init__(self) -> None:
        self.kept = False
        self.on_end: Callable[[], None] = lambda: None
        self._lock = threading.Lock()
        self._depth, self._since, self._before = 0, 0.0, 0.0

    def begin(self, *, kept: bool = False) -> None:
        """Note that a function is being compiled; one that it calls may begin within."""
        with self._lock:
            if self._depth == 0:
                self._since, self.kept = time.perf_counter(), kept
            self._depth += 1

    def end(self) -> None:
        """Note that the function is compiled, or could not be."""
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                self._before += time.perf_counter() - self._since
        if not self.active:
            self.on_end()

    @property
    def active(self) -> bool:
        """Whether something is being compiled now."""
        return self._depth > 0

    @property
    def seconds(self) -> float:
        """Time spent so far, s; it runs while `active`.

        >>> compilation = Compilation()
        >>> compilation.begin(); compilation.begin(); compilation.end(); compilation.active
        True
        >>> compilation.end(); compilation.active, compilation.seconds == compilation.seconds > 0.0
        (False, True)
        """
        with self._lock:
            return self._before + (time.perf_counter() - self._since if self._depth else 0.0)


COMPILATION = Compilation()
"""Of this process; `compiled` reports to it."""
