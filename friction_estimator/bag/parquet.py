"""The columns of .parquet files."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from friction_estimator.bag.budget import check_table
from friction_estimator.bag.columns import Columns

_CELLS = 1 << 20
"""Cells that are unpacked at a time."""


class ParquetFile:
    """A .parquet file. To be used by `apart`: damaged files end pyarrow's reader, and with it the process.

    Raises
    ------
    ModuleNotFoundError where pyarrow is not installed, TooLargeError, and whatever pyarrow raises for damaged files.
    """

    def __init__(self, path: Path) -> None:
        from pyarrow import parquet  # noqa: PLC0415 - optional at run time

        self._file = parquet.ParquetFile(path)
        self.names = [str(name) for name in self._file.schema_arrow.names]

    def read(self, wanted: Sequence[str]) -> Columns:
        """Return some columns."""
        about = self._file.metadata
        declared = 0
        for k in range(about.num_row_groups):
            group = about.row_group(k)
            columns = [group.column(j) for j in range(group.num_columns)]
            own = [column for column in columns if column.path_in_schema.partition(".")[0] in wanted]
            declared += sum(max(column.total_uncompressed_size, 8 * group.num_rows) for column in own)
        check_table(declared)
        parts: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
        size = 0
        for batch in self._file.iter_batches(columns=list(wanted), batch_size=_CELLS // max(1, len(wanted))):
            for name, found in parts.items():
                found.append(batch.column(name).to_numpy(zero_copy_only=False))
                size += found[-1].nbytes
            check_table(size)
        return {name: np.concatenate(found) if found else np.zeros(0) for name, found in parts.items()}
