"""Columns of tables: CSV, MATLAB .mat, numpy .npz and .parquet as named columns of numbers or words."""

import csv
import difflib
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.errors import InputError
from friction_estimator.core.sample import Floats

Columns = dict[str, NDArray[Any]]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TERM = re.compile(
    rf"(?P<name>.+?)(?:\s*(?P<by>[*/])\s*(?P<factor>{_NUMBER}))?(?:\s*(?P<sign>[+-])\s*(?P<offset>{_NUMBER}))?"
)

_EMPTY = {"", "nan", "none", "<na>", "nat"}

_LISTED = 20


@dataclass(frozen=True)
class Term:
    """A column with scale and offset: value = scale * cell + offset.

    >>> Term.parse("v_mm_s*1e-3", ["t", "v_mm_s"])
    Term(column='v_mm_s', scale=0.001, offset=0.0)
    >>> Term.parse("p/0.5+101325", ["p"])
    Term(column='p', scale=2.0, offset=101325.0)
    >>> Term.parse("v-1", ["v", "v-1"])  # a column of that very name comes first
    Term(column='v-1', scale=1.0, offset=0.0)
    """

    column: str
    scale: float = 1.0
    offset: float = 0.0

    @classmethod
    def parse(cls, text: str, columns: Iterable[str]) -> "Term":
        """Read COLUMN[*SCALE or /DIVISOR][+OFFSET or -OFFSET].

        Raises InputError where the column is not there; it names the nearest one, or all.
        """
        names = list(columns)
        if text in names:
            return cls(text)
        match = _TERM.fullmatch(text)
        name = match["name"] if match else text
        if not match or name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"nearest: {near[0]}" if near else f"columns: {_listed(names)}"
            raise InputError(f"no column {name!r}; {hint}")
        factor = float(match["factor"] or 1.0)
        if factor == 0.0:
            raise InputError(f"{text}: a factor of zero leaves nothing of column {name}")
        offset = float(match["offset"] or 0.0) * (-1.0 if match["sign"] == "-" else 1.0)
        return cls(name, 1.0 / factor if match["by"] == "/" else factor, offset)

    def of(self, columns: Mapping[str, NDArray[Any]]) -> Floats:
        """Return the scaled column as float64, NaN for empty cells. Raises InputError for a cell that is no number."""
        return self.scale * numbers(columns[self.column], self.column) + self.offset


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (", ".join(names[:_LISTED]) + more) or "none"


def numbers(cells: NDArray[Any], name: str) -> Floats:
    """Return cells as float64, NaN for empty ones. Raises InputError naming column and first row of anything else."""
    if cells.dtype.kind in "biuf":
        return cells.astype(np.float64)
    values = np.full(cells.size, np.nan)
    for row, cell in enumerate(cells.tolist()):
        if not empty(cell):
            try:
                values[row] = float(cell)
            except (TypeError, ValueError):
                raise InputError(
                    f"column {name}: row {row + 1} (the header not counted) holds {cell!r}, no number; "
                    "write numbers with a decimal point, or leave the cell empty"
                ) from None
    return values


def empty(cell: object) -> bool:
    """Return whether a cell holds nothing: NaN, None or blank text."""
    return str(cell).strip().lower() in _EMPTY


def read_columns(path: Path) -> Columns:
    """Read all columns of a table.

    Of .mat and .npz, variables become columns: members of a structure as `name.member`, the columns of a matrix as
    `name[0]`, `name[1]`, ...

    Raises
    ------
    InputError where the file cannot be read, or what reads it is not installed.
    """
    readers = {
        ".csv": _csv,
        ".tsv": _csv,
        ".txt": _csv,
        ".npz": _npz,
        ".mat": _mat,
        ".parquet": _parquet,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path} is no table that can be read; expected one of {', '.join(readers)}")
    try:
        return reader(path)
    except InputError:
        raise
    except ImportError as error:
        missing = "pyarrow" if path.suffix == ".parquet" and error.name != "pandas" else error.name
        raise InputError(f"reading {path} needs {missing}: pip install {missing}") from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or _line(error)}") from error
    except Exception as error:  # parsers raise many kinds
        raise InputError(f"{path} is no readable {path.suffix[1:]} table: {_line(error)}") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _csv(path: Path) -> Columns:
    import pandas as pd  # noqa: PLC0415 - slow to import, optional at run time

    with path.open(encoding="utf-8-sig", newline="") as file:
        header = file.readline()
    if not header.strip():
        raise InputError(f"{path} has no header line: the first line must name the columns")
    try:
        separator = csv.Sniffer().sniff(header, ",;\t|").delimiter
    except csv.Error:
        separator = ","
    frame = pd.read_csv(path, sep=separator, skipinitialspace=True, low_memory=False, encoding="utf-8-sig")
    return {str(name).strip(): frame[name].to_numpy() for name in frame.columns}


def _parquet(path: Path) -> Columns:
    import pandas as pd  # noqa: PLC0415

    frame = pd.read_parquet(path, engine="pyarrow")
    return {str(name): frame[name].to_numpy() for name in frame.columns}


def _npz(path: Path) -> Columns:
    if not zipfile.is_zipfile(path):
        if not path.exists():
            raise FileNotFoundError(path)
        raise InputError(f"{path} is no .npz file: write it with numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        return _flat({name: archive[name] for name in archive.files})


def _mat(path: Path) -> Columns:
    from scipy.io import loadmat  # noqa: PLC0415 - slow to import

    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise InputError(f"{path} is a MATLAB v7.3 file; save it again with save('{path.name}', '-v7')") from error
    return _flat({name: value for name, value in content.items() if not name.startswith("__")})


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Columns:
    columns: Columns = {}
    for name, value in tree.items():
        full = f"{prefix}{name}"
        if isinstance(value, Mapping):
            columns |= _flat(value, f"{full}.")
            continue
        array = np.asarray(value)
        if array.ndim == 2 and min(array.shape) > 1:
            columns |= {f"{full}[{k}]": array[:, k] for k in range(array.shape[1])}
        elif array.ndim <= 2:
            columns[full] = array.ravel()
    return columns
