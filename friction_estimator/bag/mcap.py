"""mcap at the speed of numpy, by the index that the file carries.

Each chunk is followed by the places of its messages, so what is wanted of a topic is taken in one pass over a chunk
instead of one step a message. One chunk is in memory at a time; packed ones have a budget. Files
without such an index are left to rosbags: `indexed` then returns None. Format: https://mcap.dev/spec.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO

import numpy as np

from friction_estimator.bag.batches import NOTHING_BEHIND, DamagedError, Indexed, Timed
from friction_estimator.bag.budget import TooLargeError, unpack
from friction_estimator.bag.messages import Messages, Rows
from friction_estimator.bag.placed import ASTRAY, HEAD, LONGER, OUTSIDE, heads, payloads
from friction_estimator.core.sample import Ints

MAGIC = b"\x89MCAP0\r\n"

_CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX, _STATISTICS = 0x04, 0x05, 0x06, 0x07, 0x08, 0x0B

_IN_CHUNKS = (0x03, _CHANNEL, _MESSAGE)
"""Records that stand in chunks: schemas, channels, messages."""

_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_FOOTER = struct.Struct("<BQQQI8s")
_CHUNK_HEAD = struct.Struct("<BQQQQII")  # record, times, size when unpacked, crc, length of the compression's name
_CHUNK_PLACE = struct.Struct("<QQQQ")  # times, offset, length
_BODY = _RECORD.size

_WRONG = {
    OUTSIDE: "its message index leads outside",
    ASTRAY: "its message index leads astray",
    LONGER: "a message is longer than the chunk",
}


@dataclass(frozen=True)
class _Chunk:
    """A chunk's place in the file and the places of its message indices, by channel."""

    start: int
    length: int
    index_length: int
    indices: dict[int, int]
    compression: str
    first_ns: int


@dataclass(frozen=True)
class _Summary:
    topics: dict[int, str]  # by channel
    chunks: list[_Chunk]


def indexed(path: Path, topics: Collection[str]) -> Indexed | None:
    """Return the messages of some topics chunk by chunk, in the order of the file; None where no index leads to them.

    Raises
    ------
    DamagedError, here or while iterating, where the file contradicts itself; OSError where it cannot be read.
    """
    with path.open("rb") as file:
        summary = _read_summary(file)
    if summary is None:
        return None
    wanted = {channel: topic for channel, topic in summary.topics.items() if topic in topics}
    chunks = [
        chunk
        for chunk in sorted(summary.chunks, key=lambda item: item.start)
        if not wanted.keys().isdisjoint(chunk.indices)
    ]
    first_ns = min((chunk.first_ns for chunk in chunks), default=NOTHING_BEHIND)
    return Indexed(first_ns, _read_chunks(path, chunks, wanted))


def _read_summary(file: BinaryIO) -> _Summary | None:
    """Read topics and chunk index; None where they do not lead to every message."""
    size = file.seek(0, os.SEEK_END)
    if size < _FOOTER.size + len(MAGIC):
        return None
    file.seek(size - _FOOTER.size)
    _, _, start, _, _, magic = _FOOTER.unpack(file.read())
    if magic != MAGIC or not 0 < start < size:
        return None
    file.seek(start)
    data = file.read(size - _FOOTER.size - start)
    topics: dict[int, str] = {}
    chunks: list[_Chunk] = []
    counted: dict[int, int] | None = None
    at = 0
    try:
        while at < len(data):
            code, length = _RECORD.unpack_from(data, at)
            body = data[at + _BODY : at + _BODY + length]
            at += _BODY + length
            if code == _CHANNEL:
                channel, encoding, topic = _channel(body)
                if encoding != "cdr":
                    return None
                topics[channel] = topic
            elif code == _CHUNK_INDEX:
                chunks.append(_chunk(body))
            elif code == _STATISTICS:
                counted = dict(struct.iter_unpack("<HQ", body[46:]))
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError(f"the summary is damaged ({error})") from error
    indexed: Counter[int] = Counter()
    for chunk in chunks:
        for channel, (place, end) in _index_places(chunk).items():
            indexed[channel] += (end - place - _BODY - 6) // 16
    return _Summary(topics, chunks) if counted is not None and indexed == Counter(counted) else None


def _channel(body: bytes) -> tuple[int, str, str]:
    """Return number, message encoding and topic of a Channel record."""
    (channel,) = struct.unpack_from("<H", body)
    topic, at = _string(body, 4)
    encoding, _ = _string(body, at)
    return channel, encoding, topic


def _chunk(body: bytes) -> _Chunk:
    """Read a ChunkIndex record."""
    first_ns, _, start, length = _CHUNK_PLACE.unpack_from(body)
    (size,) = struct.unpack_from("<I", body, 32)
    indices = dict(struct.iter_unpack("<HQ", body[36 : 36 + size]))
    (index_length,) = struct.unpack_from("<Q", body, 36 + size)
    compression, _ = _string(body, 44 + size)
    return _Chunk(start, length, index_length, indices, compression, min(first_ns, NOTHING_BEHIND))


def _string(body: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    return body[at + 4 : at + 4 + size].decode(), at + 4 + size


def _index_places(chunk: _Chunk) -> dict[int, tuple[int, int]]:
    """Return where each channel's message index begins and ends in the file."""
    ordered = sorted(chunk.indices.items(), key=lambda item: item[1])
    places = [place for _, place in ordered] + [chunk.start + chunk.length + chunk.index_length]
    return {channel: (place, end) for (channel, place), end in zip(ordered, places[1:], strict=True)}


def _read_chunks(path: Path, chunks: list[_Chunk], wanted: dict[int, str]) -> Iterator[Timed]:
    """Yield the batches of chunks that are in the order of the file."""
    behind = [*accumulate((chunk.first_ns for chunk in reversed(chunks)), min, initial=NOTHING_BEHIND)][::-1]
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        for number, chunk in enumerate(chunks):
            if chunk.length + chunk.index_length > size or chunk.start > size:
                raise DamagedError(f"the chunk at byte {chunk.start} is damaged (the file ends in it)")
            file.seek(chunk.start)
            block = file.read(chunk.length + chunk.index_length)
            try:
                records = _records(block, chunk)
                places = {channel: at for channel, at in _index_places(chunk).items() if channel in wanted}
                for left, (channel, (place, end)) in zip(range(len(places) - 1, -1, -1), places.items(), strict=True):
                    index = block[place - chunk.start : end - chunk.start]
                    batch = (wanted[channel], *_messages(records, index, channel))
                    yield batch, behind[number if left else number + 1]
            except TooLargeError as error:
                raise DamagedError(f"the chunk at byte {chunk.start} is too large ({error})") from error
            except Exception as error:  # decompressors raise many kinds
                raise DamagedError(f"the chunk at byte {chunk.start} is damaged ({error})") from error


def _records(block: bytes, chunk: _Chunk) -> Rows:
    """Return the records inside a chunk, checked by its checksum where it has one."""
    code, _, _, _, size, checksum, letters = _CHUNK_HEAD.unpack_from(block)
    start = _CHUNK_HEAD.size + letters + 8
    compression, _ = _string(block, _CHUNK_HEAD.size - 4)
    (stored,) = struct.unpack_from("<Q", block, start - 8)
    if code != _CHUNK or compression != chunk.compression or start + stored != chunk.length:
        raise ValueError("its head does not agree with the index")
    if len(block) != chunk.length + chunk.index_length:
        raise ValueError("the file ends in it")
    packed = memoryview(block)[start : start + stored]
    records = unpacked_chunk(packed, compression, size) if compression else packed
    if len(records) != size:
        raise ValueError("its size is not the declared one")
    if checksum and zlib.crc32(records) != checksum:
        raise ValueError("its checksum is wrong")
    return np.frombuffer(records, np.uint8)


def unpacked_chunk(data: bytes | memoryview, compression: str, size: int) -> bytes:
    """Return the records that a chunk unpacks to, `size` bytes as it declares.

    Raises ValueError (TooLargeError) where it cannot be, and what the decompressors raise for damaged data.
    """
    records = unpack(data, compression, size)
    if records and records[0] not in _IN_CHUNKS:
        raise ValueError(f"a chunk begins with a record of kind {records[0]}")
    return records


def _messages(records: Rows, index: bytes, channel: int) -> tuple[Ints, Messages]:
    """Return times and payloads of the messages that an index record lists, in the order of the file."""
    code, _, number, size = struct.unpack_from("<BQHI", index)
    if code != _MESSAGE_INDEX or number != channel:
        raise ValueError("its message index is wrong")
    entries = np.frombuffer(index, "<u8", size // 8, offset=15)
    places = entries[1::2].astype(np.int64)
    if not places.size:
        return np.zeros(0, np.int64), []
    if np.any(places[1:] < places[:-1]):  # by time, where messages were not recorded in its order
        places.sort()
    times, lengths = np.empty_like(places), np.empty_like(places)
    wrong = heads(records, places, channel, times, lengths)
    if wrong:
        raise ValueError(_WRONG[wrong])
    return times, payloads(records, places + HEAD, lengths)
