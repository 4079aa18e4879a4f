"""Tables as files: the names of their columns first, then the wanted columns and nothing else.

CSV, MATLAB .mat, numpy .npz and .parquet. Sizes are known by heads before anything is unpacked, and what is read of a
table at once has a budget (`budget.TABLE_BYTES`); columns that nobody wants cost nothing.
"""

import csv
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag import apart
from friction_estimator.bag.budget import TooLargeError, check_table
from friction_estimator.bag.columns import Columns, TableFile
from friction_estimator.bag.lfs import check_no_pointer
from friction_estimator.core.errors import FrictionEstimatorError, InputError

_MOST_COLUMNS = 10_000
"""Columns of a CSV table: pandas takes time in the square of them to tell equal names apart (9 s for 25,000)."""

_HEADER_BYTES = 1 << 20
"""Longest header line of a CSV file: a hundred thousand columns."""

_CELLS = 1 << 20
"""Cells of a CSV file that are taken apart at a time."""


_LOOKED_AT = 1000
"""Rows of a CSV file by which a decimal comma is known."""

_COMMA = re.compile(r"[-+]?\d{1,3}(\.\d{3})*,\d*([eE][-+]?\d+)?|[-+]?\d*,\d+([eE][-+]?\d+)?")
_POINT = re.compile(r"[-+]?(\d+\.\d*|\.\d+)([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(\.\d{3})+")


@contextmanager
def open_table(path: Path) -> Iterator[TableFile]:
    """Yield a table by the reader of its suffix.

    Of .mat and .npz, variables become columns: members of a structure as `name.member`, the columns of a matrix as
    `name[0]`, `name[1]`, ...

    Raises
    ------
    InputError, here or by `read`: the file cannot be read, or the wanted columns unpack to more than
    `budget.TABLE_BYTES`; ImportError where what reads it is not installed.
    """
    opener = _OPENERS.get(path.suffix.lower())
    if opener is None:
        raise InputError(f"{path} is no table that can be read; expected one of {', '.join(_OPENERS)}")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if not path.is_file():
        raise InputError(f"{path} is no file: give a table ({', '.join(_OPENERS)})")
    check_no_pointer(path)
    try:
        with opener(path) as table:
            yield table
    except (FrictionEstimatorError, ImportError):
        raise
    except TooLargeError as error:
        raise InputError(f"{path} unpacks to {error}") from error
    except MemoryError as error:
        raise InputError(f"{path} unpacks to more memory than there is: give it in pieces") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or _line(error)}") from error
    except Exception as error:  # parsers raise many kinds
        raise InputError(f"{path} is no readable {path.suffix[1:]} table: {_line(error)}") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


class _Csv:
    def __init__(self, path: Path) -> None:
        import pandas as pd  # noqa: PLC0415 - slow to import, optional at run time

        encoding = _encoding(path)
        with path.open(encoding=encoding, newline="") as file:
            header = file.readline(_HEADER_BYTES)
            lines = [line for _ in range(_LOOKED_AT) if (line := file.readline(_HEADER_BYTES))]
        if not header.strip():
            raise InputError(f"{path} has no header line: the first line must name the columns")
        if len(header) == _HEADER_BYTES:
            raise InputError(f"{path} has a first line of more than {_HEADER_BYTES} characters: is it a CSV table?")
        separator = _separator(header, lines[:1])
        # Where the first row has more cells than the header, pandas would take the first ones for the names of rows.
        named, *found = (len(row) for row in csv.reader([header, *lines[:1]], delimiter=separator))
        if named > _MOST_COLUMNS:
            raise InputError(f"{path} names {named} columns; at most {_MOST_COLUMNS} are read: is it a CSV table?")
        if found and found[0] > named:
            raise InputError(f"{path}: its rows hold {found[0]} cells and the header names {named}: name every column")
        self._read: Callable[..., Any] = pd.read_csv
        self._options: dict[str, Any] = {"filepath_or_buffer": path, "sep": separator, "skipinitialspace": True}
        self._options |= {"encoding": encoding, "compression": None, **_decimal_comma(lines, separator)}
        self._columns = list(self._read(**self._options, nrows=0).columns)
        self.names = [str(name).strip() for name in self._columns]

    def read(self, wanted: Sequence[str]) -> Columns:
        places = {name: self.names.index(name) for name in wanted}
        parts: list[Any] = []
        size = 0
        rows = max(1000, _CELLS // len(self.names))
        # Not by pandas' own choice of columns: with that it passes over rows that are too long.
        with self._read(chunksize=rows, low_memory=False, **self._options) as chunks:
            for whole in chunks:
                chunk = whole.iloc[:, list(places.values())].copy()
                size += int(chunk.memory_usage(index=False).sum())
                check_table(size)
                parts.append(chunk)
        return {name: _joined([part[self._columns[k]].to_numpy() for part in parts]) for name, k in places.items()}


def _encoding(path: Path) -> str:
    """Return the encoding of a table, by its header: UTF-8, else what spreadsheets on Windows write."""
    with path.open("rb") as file:
        header = file.readline(_HEADER_BYTES)
    if header.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        header.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _separator(header: str, rows: Sequence[str]) -> str:
    """Return what separates the cells: what gives the first row as many as the header."""
    for separator in ";\t|,":
        named, *found = (len(row) for row in csv.reader([header, *rows], delimiter=separator))
        if named > 1 and all(count == named for count in found):
            return separator
    try:
        return csv.Sniffer().sniff(header, ",;\t|").delimiter
    except csv.Error:
        return ","


def _decimal_comma(lines: Sequence[str], separator: str) -> dict[str, str]:
    """Return pandas' options for numbers such as 0,5 or 1.234,5; none where a point stands for the comma anywhere."""
    if separator == ",":
        return {}
    cells = [cell.strip() for row in csv.reader(lines, delimiter=separator) for cell in row]
    comma = [cell for cell in cells if _COMMA.fullmatch(cell)]
    point = [cell for cell in cells if _POINT.fullmatch(cell) and not _THOUSANDS.fullmatch(cell)]
    if not comma or point:
        return {}
    return {"decimal": ",", "thousands": "."} if any("." in cell for cell in comma) else {"decimal": ","}


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return the parts of a column as one; where one part holds words, so does the column."""
    if any(part.dtype.hasobject for part in parts):
        parts = [part.astype(object) for part in parts]
    return np.concatenate(parts)


@dataclass(frozen=True)
class _Member:
    """An array of an .npz file, known by its head."""

    file: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class _Npz:
    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._members: dict[str, _Member] = {}
        self._places: dict[str, tuple[str, int | None]] = {}
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            with archive.open(info) as file:
                shape, dtype = _head(file)
            self._members[name] = _Member(info.filename, shape, dtype)
            if len(shape) == 2 and min(shape) > 1:
                self._places |= {f"{name}[{k}]": (name, k) for k in range(shape[1])}
            elif len(shape) <= 2:
                self._places[name] = (name, None)
        self.names = list(self._places)

    def read(self, wanted: Sequence[str]) -> Columns:
        needed = {self._places[name][0] for name in wanted}
        for name in needed:
            if self._members[name].dtype.hasobject:
                raise InputError(
                    f"{self._path}: {name} holds Python objects, not numbers: save it as an array of numbers"
                )
        check_table(sum(self._size(name) for name in needed))
        arrays = {name: self._array(name) for name in needed}
        columns = {}
        for name in wanted:
            member, k = self._places[name]
            columns[name] = arrays[member].ravel() if k is None else arrays[member][:, k]
        return columns

    def _size(self, name: str) -> int:
        member = self._members[name]
        return math.prod(member.shape) * member.dtype.itemsize

    def _array(self, name: str) -> NDArray[Any]:
        with self._archive.open(self._members[name].file) as file:
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
            return array


def _head(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape and type of an array in the .npy format. Raises ValueError where the file holds none."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    if any(size < 0 for size in shape):
        raise ValueError(f"an array of shape {shape}")
    return shape, dtype


@contextmanager
def _npz(path: Path) -> Iterator[TableFile]:
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path} is no .npz file: write it with numpy.savez")
    with zipfile.ZipFile(path) as archive:
        yield _Npz(path, archive)


@contextmanager
def _csv(path: Path) -> Iterator[TableFile]:
    yield _Csv(path)


_OPENERS: dict[str, Callable[[Path], AbstractContextManager[TableFile]]] = {
    ".csv": _csv,
    ".tsv": _csv,
    ".txt": _csv,
    ".npz": _npz,
    **dict.fromkeys(apart.SUFFIXES, apart.opened),
}
