"""Columns of tables: cells as numbers."""

from collections.abc import Sequence
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


_EMPTY = {"", "nan", "none", "<na>", "nat"}


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
                    "write all numbers with a decimal point or all with a comma, or leave the cell empty"
                ) from None
    return values


def empty(cell: object) -> bool:
    """Return whether a cell holds nothing: NaN, None or blank text."""
    return str(cell).strip().lower() in _EMPTY
