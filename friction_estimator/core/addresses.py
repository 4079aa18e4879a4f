"""Arrays that compiled code finds by their addresses, which are taken once.

numba takes every array of a call apart, 0.1 us each: a loop over thirty of them would spend more on a single sample
than on learning from it. Here it is handed one table of addresses and sizes, made when the arrays are, and puts the
arrays together from it. Where vectors are read, rows are whole cache lines that begin on one (`placed`).
"""

import ctypes
import math
from collections import namedtuple
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats

LINE = 8
"""Floats in a cache line of 64 bytes, the widest vector of today's processors."""

LARGEST_RANK = 3


_ONES = (1,) * LARGEST_RANK


class Addresses:
    """Addresses and sizes of arrays, which live as long as this does.

    Parameters
    ----------
    arrays : what the compiled code reads and writes. Entries of the last axis lie beside each other; its rows may be
        padded (`placed`): then the size that counts is that of the padded row.
    dtypes : what it takes them for.

    Attributes
    ----------
    table : (arrays, 4) int64, address and three sizes.
    address : of the table itself, for `table_at`.

    Raises
    ------
    ValueError : an array of another type, or one that is strided.

    >>> Addresses([np.zeros((5, 3))], [np.float64]).table[0, 1:].tolist()
    [5, 3, 1]
    """

    def __init__(self, arrays: Sequence[NDArray[Any]], dtypes: Sequence[Any]) -> None:
        self._arrays, self._dtypes = arrays, [np.dtype(dtype) for dtype in dtypes]
        self.table = np.empty((len(arrays), 1 + LARGEST_RANK), np.int64)
        entries = [_entry(*pair) for pair in zip(arrays, self._dtypes, strict=True)]
        if entries:
            self.table[:] = entries
        self.address = _address(self.table) if entries else 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies, and processes that it is sent to, have arrays of their own."""
        return Addresses, (self._arrays, self._dtypes)


def _entry(array: NDArray[Any], dtype: np.dtype[Any]) -> tuple[int, ...]:
    sizes = array.shape
    if array.dtype != dtype or not 1 <= len(sizes) <= LARGEST_RANK:
        raise ValueError(f"an array of {array.dtype}{array.shape} where one of {dtype} is read")
    if not array.size:
        return (0, *sizes, *_ONES[len(sizes) :])
    # A single row counts as contiguous, padded or not.
    if not array.flags.c_contiguous or (len(sizes) > 1 and array.strides[-2] != array.itemsize * sizes[-1]):
        sizes = _padded_sizes(array)
    return (_address(array), *sizes, *_ONES[len(sizes) :])


def _address(array: NDArray[Any]) -> int:
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))  # a quarter of the time that array.ctypes takes
    except (TypeError, ValueError):  # read-only, or strided
        return array.ctypes.data


def _padded_sizes(array: NDArray[Any]) -> tuple[int, ...]:
    sizes = list(array.shape)
    if len(sizes) > 1 and (sizes[-2] > 1 or _is_placed(array)):
        sizes[-1] = max(sizes[-1], array.strides[-2] // array.itemsize)
    steps = np.cumprod([array.itemsize, *sizes[:0:-1]])[::-1]
    if any(count > 1 and step != wanted for count, step, wanted in zip(array.shape, array.strides, steps, strict=True)):
        raise ValueError(f"an array of shape {array.shape} and steps of {array.strides} bytes")
    return tuple(sizes)


class Layout:
    """Which arrays a table holds, in their order, and of which types.

    Parameters
    ----------
    dtypes : type by name.

    Attributes
    ----------
    at : place by name, for compiled code: `floats(table, LAYOUT.at.velocity)` with `LAYOUT.at` in a global.

    >>> layout = Layout(row=np.int64, value=np.float64)
    >>> layout.at.value
    1
    >>> layout.addresses(value=np.zeros(3), row=np.zeros(2, np.int64)).table[:, 1].tolist()
    [2, 3]
    """

    def __init__(self, **dtypes: Any) -> None:
        self._dtypes = {name: np.dtype(dtype) for name, dtype in dtypes.items()}
        self.at: Any = namedtuple("Places", dtypes)(*range(len(dtypes)))  # compiled code reads its fields

    def addresses(self, **arrays: NDArray[Any]) -> Addresses:
        """Return the addresses of the arrays; all of them are to be given."""
        return Addresses([arrays[name] for name in self._dtypes], list(self._dtypes.values()))


def padded(size: int) -> int:
    """Return the next multiple of `LINE`.

    >>> padded(94), padded(96)
    (96, 96)
    """
    return -(-size // LINE) * LINE


def placed(array: Floats, start: int = 0) -> Floats:
    """Return the values with every row in whole cache lines; behind them are zeros, `LINE` at least behind the last.

    Parameters
    ----------
    start : entry of a row that is to begin a line; where it is not 0, of a single row.
    """
    if not start and _is_placed(array):
        return array
    own = placed_zeros(array.shape, start)
    own[...] = array
    return own


def placed_zeros(shape: tuple[int, ...], start: int = 0) -> Floats:
    """Return zeros that are `placed`; no page of them is touched before something is written there."""
    before = -start % LINE
    row = before + padded(shape[-1])
    rows = math.prod(shape[:-1])
    room = np.zeros(rows * row + 2 * LINE)
    first = -(_address(room) // room.itemsize) % LINE
    own = room[first : first + rows * row + LINE][: rows * row].reshape(*shape[:-1], row)
    return own[..., before : before + shape[-1]]


def _is_placed(array: Floats) -> bool:
    """Return whether the rows begin lines already; one row alone does not tell what is behind it."""
    if array.ndim < 2 or not array.size:
        return False
    row = padded(array.shape[-1]) * array.itemsize
    steps = (array.shape[-2] * row, row, array.itemsize)[-array.ndim :]
    return array.__array_interface__["data"][0] % (LINE * 8) == 0 and array.strides == steps


@intrinsic
def _pointer(typingctx, address):  # type: ignore[no-untyped-def] # noqa: ARG001 - numba's signature
    """Take an integer for the address that it is."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def] # noqa: ARG001 - numba's signature
        return builder.inttoptr(args[0], cgutils.voidptr_t)

    return types.voidptr(types.int64), codegen


@njit(forceinline=True)
def table_at(address, arrays):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the table at an address."""
    return carray(_pointer(address), (arrays, 1 + LARGEST_RANK), np.int64)


@njit(forceinline=True)
def floats(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the float array at a place of the table, (n,)."""
    return carray(_pointer(table[place, 0]), (table[place, 1],), np.float64)


@njit(forceinline=True)
def lines(table, place, before):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the whole cache lines of a float array that was `placed`, from `before` entries in front of it.

    Where all vectors of a sum or a step lie so, none is half stored and half read, and nothing is left over.
    """
    size = -(-(before + table[place, 1]) // LINE) * LINE
    return carray(_pointer(table[place, 0] - before * 8), (size,), np.float64)


@njit(forceinline=True)
def float_rows(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the float array at a place of the table, (n, m)."""
    return carray(_pointer(table[place, 0]), (table[place, 1], table[place, 2]), np.float64)


@njit(forceinline=True)
def float_blocks(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the float array at a place of the table, (n, m, l)."""
    return carray(_pointer(table[place, 0]), (table[place, 1], table[place, 2], table[place, 3]), np.float64)


@njit(forceinline=True)
def ints(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the int64 array at a place of the table, (n,)."""
    return carray(_pointer(table[place, 0]), (table[place, 1],), np.int64)


@njit(forceinline=True)
def int_rows(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the int64 array at a place of the table, (n, m)."""
    return carray(_pointer(table[place, 0]), (table[place, 1], table[place, 2]), np.int64)


@njit(forceinline=True)
def bytes_of(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the int8 array at a place of the table, (n,)."""
    return carray(_pointer(table[place, 0]), (table[place, 1],), np.int8)


@njit(forceinline=True)
def int32_rows(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the int32 array at a place of the table, (n, m)."""
    return carray(_pointer(table[place, 0]), (table[place, 1], table[place, 2]), np.int32)


@njit(forceinline=True)
def bools(table, place):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the bool array at a place of the table, (n,)."""
    return carray(_pointer(table[place, 0]), (table[place, 1],), np.bool_)
