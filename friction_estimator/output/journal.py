"""What a long run has computed, row by row as it is computed: an unfinished run leaves it to the next one."""

import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from friction_estimator.core.errors import InputError


class Journal:
    """Rows by key, in a file of one JSON object a line (context manager for writing).

    A process may be killed at any moment: what it added is there, but for the line that it was writing. After a loss
    of power the last lines may be missing or damaged; those are not read.

    Parameters
    ----------
    path : the file; made with the first row.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "rows"
    ...     with Journal(path) as journal:
    ...         journal.add("a", {"x": 1.5})
    ...     with path.open("a") as file:
    ...         _ = file.write('{"key": "b", "ro')
    ...     with Journal(path) as journal:
    ...         journal.add("c", None)
    ...     Journal(path).rows()
    {'a': {'x': 1.5}, 'c': None}
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def rows(self) -> dict[str, Any]:
        """Return the rows that are there, by key."""
        found: dict[str, Any] = {}
        try:
            lines = self._path.read_bytes().splitlines()
        except FileNotFoundError:
            return found
        for line in lines:
            try:
                entry = json.loads(line)
                found[entry["key"]] = entry["row"]
            except (ValueError, KeyError, TypeError, RecursionError):
                continue  # was being written, or is damaged, or is none of ours
        return found

    def __enter__(self) -> "Journal":
        """Write nothing yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def add(self, key: str, row: Any) -> None:
        """Add a row, which JSON can hold. Raises InputError where it cannot be written."""
        try:
            if self._descriptor is None:
                flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
                self._descriptor = os.open(self._path, flags, 0o644)
                end = os.lseek(self._descriptor, 0, os.SEEK_END)
                if end and os.pread(self._descriptor, 1, end - 1) != b"\n":
                    self._write(b"\n")  # ends the line that a killed process was writing
            self._write(line(key, row).encode())
        except OSError as error:
            raise InputError(f"cannot write {self._path}: {error.strerror}; choose another --out") from error

    def _write(self, data: bytes) -> None:
        assert self._descriptor is not None
        while data:
            data = data[os.write(self._descriptor, data) :]


def line(key: str, row: Any) -> str:
    """Return the line of a row."""
    return json.dumps({"key": key, "row": row}, separators=(",", ":"), allow_nan=False) + "\n"
