"""Work that no sample has to wait for."""

import threading
from collections.abc import Callable


class Background:
    """Does one piece of work at a time in a thread; what comes while it is busy is refused.

    Parameters
    ----------
    name : of the thread.
    on_error : takes an exception that a piece of work met.
    """

    def __init__(self, name: str, on_error: Callable[[str, Exception], None]) -> None:
        self._name, self._on_error = name, on_error
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether a piece is under way."""
        return self._thread is not None and self._thread.is_alive()

    def begin(self, work: Callable[[], None]) -> bool:
        """Return whether the work has begun; not where the last one is still under way."""
        if self.busy:
            return False
        self._thread = threading.Thread(target=self._do, args=(work,), name=self._name, daemon=True)
        self._thread.start()
        return True

    def join(self, limit_s: float) -> bool:
        """Wait for the piece that is under way; return whether it has ended."""
        if self._thread is not None:
            self._thread.join(limit_s)
        return not self.busy

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:
            self._on_error(self._name, error)
