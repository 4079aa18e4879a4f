"""Columns of tables: a column with scale and offset, and cells as numbers."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.errors import InputError
from friction_estimator.core.sample import Floats

Columns = dict[str, NDArray[Any]]


class TableFile(Protocol):
    """An open table."""

    @property
    def names(self) -> Sequence[str]:
        """Its columns."""

    def read(self, wanted: Sequence[str]) -> Columns:
        """Return some of its columns, each (n,)."""


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
