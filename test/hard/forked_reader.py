"""The process that reads a .mat or .parquet table apart, forked from one that has its libraries already.

As it is (`bag.apart`) each file waits half a second for an interpreter and scipy: a long attack would measure nothing
else. The body of the process, its limits and its pipes are the same here; a tenth of the inputs goes the usual way.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from friction_estimator.bag import apart


class ForkedReader:
    """What `apart` uses of `subprocess.Popen`."""

    def __init__(self, command: Sequence[str], **_: Any) -> None:
        path, folder, seconds = command[-3:]
        question, ask = os.pipe()
        hear, answer = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            code = 1
            try:
                os.dup2(question, 0)
                for end in (ask, hear):
                    os.close(end)
                silence = os.open(os.devnull, os.O_WRONLY)
                os.dup2(silence, 1)
                os.dup2(silence, 2)
                with os.fdopen(answer, "w", encoding="utf-8") as answers, os.fdopen(0, encoding="utf-8") as questions:
                    apart.sys.stdin = questions
                    apart._serve(Path(path), Path(folder), int(seconds), answers)
                code = 0
            finally:
                os._exit(code)
        os.close(question)
        os.close(answer)
        self.stdin, self.stdout = os.fdopen(ask, "w", encoding="utf-8"), os.fdopen(hear, encoding="utf-8")
        self._code: int | None = None

    def wait(self) -> int:
        """Return the exit code, negative for a signal."""
        if self._code is None:
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code

    def kill(self) -> None:
        """End it, if it runs."""
        if self._code is None:
            os.kill(self.pid, 9)

    def __enter__(self) -> "ForkedReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.stdout.close()
        if not self.stdin.closed:
            self.stdin.close()
        self.wait()


def by_forked_reader(run: Callable[[Path], int]) -> Callable[[Path], int]:
    """Return `run` with the libraries of the readers at hand."""

    def warm(path: Path) -> int:
        import pyarrow.parquet  # noqa: F401 - forked with the reader
        import scipy.io.matlab  # noqa: F401

        with patch.object(apart.subprocess, "Popen", ForkedReader):
            return run(path)

    return warm
