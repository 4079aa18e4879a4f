"""Tables as Parquet, where pyarrow is installed."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def is_available() -> bool:
    """Return whether what writes Parquet is installed."""
    return find_spec("pyarrow") is not None


def write_parquet(path: Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write columns of equal length; None is null, and a column that holds more than one type is text.

    The same columns give the same bytes.
    """
    import pyarrow  # noqa: PLC0415 - optional at run time
    from pyarrow import parquet  # noqa: PLC0415

    parquet.write_table(pyarrow.table({name: _alike(values) for name, values in columns.items()}), path)


def _alike(values: Sequence[Any]) -> list[Any]:
    """Return values of one type, as a column needs them; tuples become lists."""
    plain = [list(value) if isinstance(value, tuple) else value for value in values]
    kinds = {type(value) for value in plain if value is not None}
    lists = [value for value in plain if isinstance(value, list)]
    inside = {type(item) for value in lists for item in value}
    if kinds <= {int, float} or (len(kinds) <= 1 and len(inside) <= 1):
        return plain
    return [None if value is None else str(value) for value in plain]
