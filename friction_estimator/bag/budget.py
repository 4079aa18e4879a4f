"""How many bytes a file may unpack to, and decompressors that stop there.

A few kilobytes can be packed so that they unpack to gigabytes. What is read piece by piece (the chunks and messages
of a recording) has a budget a piece, so that a recording of any size is read; what is read whole (the columns of a
table) has one budget.
"""

import bz2
import sys
from collections.abc import Iterator
from typing import BinaryIO

import lz4.frame

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PIECE_BYTES = 256 << 20
"""Largest chunk or message of a recording, unpacked. Recorders make chunks of 1 to 10 MB."""

ANY_RATIO_BYTES = 64 << 20
"""What a piece may unpack to whatever its packed size: a large blank image packs very well."""

LARGEST_RATIO = 1000
"""Largest ratio of unpacked to packed size beyond that: recordings of numbers come to 5 to 50."""

_STEP = 4 << 20

TABLE_BYTES = 512 << 20
"""Largest total of the columns that are read of a table: 64 million numbers."""

_DECOMPRESSORS = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}


class TooLargeError(ValueError):
    """Something unpacks to more than its budget; says how much that is."""


def megabytes(size: float) -> str:
    """Return a size in words.

    >>> megabytes(512 << 20)
    '537 MB'
    """
    return f"{size / 1e6:.0f} MB"


def check_table(size: float) -> None:
    """Raise TooLargeError where the columns that are to be read of a table are beyond `TABLE_BYTES`."""
    if size > TABLE_BYTES:
        raise TooLargeError(
            f"{megabytes(size)}, where {megabytes(TABLE_BYTES)} are the most that is read at once: "
            "save what is needed of it, in columns of their own or in pieces"
        )


def unpack(data: bytes | memoryview, compression: str, limit: int = PIECE_BYTES) -> bytes:
    """Return what a piece of a recording unpacks to: all frames of it, as recorders write them.

    Parameters
    ----------
    compression : "", "zstd", "lz4" or "bz2"; "" is no compression.
    limit : bytes that may come out; where the file declares the size, that size.

    Raises
    ------
    TooLargeError where more comes out; ValueError where the data end early or the compression is not known; what the
    decompressors raise for damaged data.

    >>> unpack(zstd.compress(bytes(300)), "zstd") == bytes(300)
    True
    """
    allowed = min(PIECE_BYTES, max(ANY_RATIO_BYTES, LARGEST_RATIO * len(data)))
    if limit > PIECE_BYTES:
        raise TooLargeError(f"a piece of {megabytes(limit)}, where {megabytes(PIECE_BYTES)} are the most that is read")
    if not compression:
        return bytes(data)
    if compression not in _DECOMPRESSORS:
        raise ValueError(f"compression {compression!r} is not supported")
    found: list[bytes] = []
    size, rest = 0, bytes(data)
    room = min(limit, allowed)
    while rest:
        decompressor = _DECOMPRESSORS[compression]()
        found.append(decompressor.decompress(rest, max_length=room + 1 - size))
        size += len(found[-1])
        if size > room:
            raise TooLargeError(f"a piece of {len(data)} bytes unpacks to more than {room}")
        if not decompressor.eof:
            raise ValueError("packed data end early")
        rest = decompressor.unused_data or b""
    return found[0] if len(found) == 1 else b"".join(found)


def unpack_file(packed: BinaryIO, size: int) -> Iterator[bytes]:
    """Yield a file of `size` bytes that zstd has packed whole, piece by piece.

    Raises TooLargeError where it unpacks to more than a recording can; what zstd raises for damaged data.
    """
    limit = max(PIECE_BYTES, LARGEST_RATIO * size)
    with zstd.open(packed, "rb") as plain:
        while piece := plain.read(_STEP):
            limit -= len(piece)
            if limit < 0:
                raise TooLargeError(f"more than {LARGEST_RATIO} times its size")
            yield piece
