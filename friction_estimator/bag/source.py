"""Recordings as files: which topics there are, and the raw messages of some of them.

Every failure ends as one InputError that names the file and what to do about it.
"""

import re
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from types import TracebackType

import numpy as np
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1.reader import decompressors as unpackers1
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS as UNPACKERS2

from friction_estimator.bag import db3, mcap
from friction_estimator.bag.batches import ANYTHING_BEHIND, NOTHING_BEHIND, DamagedError, Indexed, Timed
from friction_estimator.bag.budget import unpack
from friction_estimator.bag.lfs import check_no_pointer
from friction_estimator.bag.messages import Rows
from friction_estimator.bag.placed import Placed
from friction_estimator.bag.prepared import prepared
from friction_estimator.core.errors import FrictionEstimatorError, InputError
from friction_estimator.core.sample import Ints
from friction_estimator.core.text import counted, is_utf8

BATCH = 8192
"""Messages handed on at a time: bounds the memory of a pass over a recording."""

STORAGE_SUFFIXES = (".mcap", ".db3", ".bag")
_PARTS = (*STORAGE_SUFFIXES, ".zstd", ".yaml")
"""Endings of the files in the folder of a recording."""

TABLE_SUFFIXES = (".csv", ".mat", ".npz", ".parquet")

_INDEXED = {".mcap": mcap.indexed, ".db3": db3.indexed}
"""The fast way through a file, by its ending."""

_EXPECTED = "expected a folder with metadata.yaml, or an .mcap, .db3 or .bag file"

_REMEDIES = {
    ".mcap": "`mcap recover IN -o OUT` saves what is whole",
    ".db3": "`sqlite3 IN .recover | sqlite3 OUT` saves what is whole",
    ".bag": "`rosbag reindex` saves what is whole",
}

# rosbags looks the decompressors of chunks up in these tables; its own stop only where memory ends.
UNPACKERS2.update(
    zstd=lambda data, size: mcap.unpacked_chunk(data, "zstd", size),
    lz4=lambda data, size: mcap.unpacked_chunk(data, "lz4", size),
)
unpackers1.update(bz2=lambda data: unpack(data, "bz2"), lz4=lambda data: unpack(data, "lz4"))


@dataclass(frozen=True)
class Topic:
    """A topic of a recording: name, message type as rosbags writes it ("" where it changes), number of messages."""

    name: str
    message_type: str
    count: int

    def __str__(self) -> str:
        kind = self.message_type.replace("/msg/", "/") or "several types"
        return f"{self.name} ({kind}, {counted(self.count, 'message')})"


class Source:
    """An open recording (context manager).

    Parameters
    ----------
    path : ROS 2 recording (folder with metadata.yaml, .mcap or .db3 file) or ROS 1 .bag file.

    Raises
    ------
    InputError where it cannot be read.
    """

    def __init__(self, path: str | PurePath) -> None:
        self.path = Path(path)
        if self.path.name == "metadata.yaml":
            self.path = self.path.parent
        self.ros1 = self.path.suffix == ".bag" and not self.path.is_dir()
        with _readable(self.path):
            _check_kind(self.path)
            with ExitStack() as stack:
                self._prepared = prepared(self.path, stack)
                path = self._prepared.path
                self._reader: Reader1 | db3.RecordingReader = Reader1(path) if self.ros1 else db3.RecordingReader(path)
                self._reader.open()
                stack.callback(self._reader.close)
                self._stack = stack.pop_all()
            self.topics = tuple(
                Topic(name, str(info.msgtype or ""), info.msgcount)
                for name, info in sorted(self._reader.topics.items())
            )

    def __enter__(self) -> "Source":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the files, and of what is temporary."""
        self._stack.close()

    @staticmethod
    @contextmanager
    def opened(recording: "str | PurePath | Source") -> Iterator["Source"]:
        """Yield a recording, opened for this context where it is not open already."""
        if isinstance(recording, Source):
            yield recording
        else:
            with Source(recording) as source:
                yield source

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth telling about how it is read, a line each."""
        return self._prepared.notes

    @property
    def message_count(self) -> int:
        """Messages on all topics."""
        return sum(topic.count for topic in self.topics)

    def first(self, topic: str) -> bytes | None:
        """Return the first message of a topic, in the order of the file; None where it has none.

        Raises InputError as `batches` does.
        """
        with _readable(self.path):
            indexed = self._indexed([topic])
            if indexed is not None:
                filled = (messages for (_, _, messages), _ in indexed if len(messages))
                raw = next((each.first() if isinstance(each, Placed) else bytes(each[0]) for each in filled), None)
            else:
                chosen = [item for item in self._reader.connections if item.topic == topic]
                raw = next((raw for _, _, raw in self._reader.messages(connections=chosen)), None) if chosen else None
            return raw if raw is None else self._unpacked(raw)

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time of recording in ns, raw message) of some topics in recorded order.

        `start_ns` skips what was recorded before. Raises InputError where the recording is damaged.
        """
        with _readable(self.path):
            chosen = [item for item in self._reader.connections if item.topic in topics]
            if chosen:
                for connection, log_time, raw in self._reader.messages(connections=chosen, start=start_ns):
                    yield connection.topic, log_time, self._unpacked(raw)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of recording of the first message, and a moment after the last, ns."""
        return self._reader.start_time, self._reader.end_time

    def batches(self, topics: Collection[str]) -> Iterator[tuple[str, Ints, Rows | list[bytes]]]:
        """Yield the raw messages of some topics; those of one topic come in the order of the recording.

        Raises InputError where the recording is damaged.
        """
        for (topic, times, messages), _ in self.timed_batches(topics):
            yield topic, times, messages.rows() if isinstance(messages, Placed) else messages

    def timed_batches(self, topics: Collection[str]) -> Iterator[Timed]:
        """Yield what `batches` does, and with each a time of recording, ns, before which nothing comes behind it.

        So the recording says; where it says nothing that time is `ANYTHING_BEHIND`.
        """
        with _readable(self.path):
            for (topic, times, messages), behind_ns in self._indexed(topics) or self._stepwise(topics):
                if self._prepared.packed_messages:
                    packed = messages.rows() if isinstance(messages, Placed) else messages
                    yield (topic, times, [self._unpacked(bytes(message)) for message in packed]), behind_ns
                else:
                    yield (topic, times, messages), behind_ns

    def _unpacked(self, raw: bytes) -> bytes:
        return unpack(raw, "zstd") if self._prepared.packed_messages else raw

    def _indexed(self, topics: Collection[str]) -> Iterator[Timed] | None:
        """Return the fast way through every file of the recording, where all of them have one."""
        if any(file.suffix not in _INDEXED for file in self._prepared.files):
            return None
        parts = [_INDEXED[file.suffix](file, topics) for file in self._prepared.files]
        ways = [part for part in parts if part is not None]
        return self._all_of(_one_after_the_other(ways), topics) if ways and len(ways) == len(parts) else None

    def _all_of(self, batches: Iterator[Timed], topics: Collection[str]) -> Iterator[Timed]:
        """Yield batches; then raise DamagedError where an index of .db3 files did not lead to all messages.

        A damaged entry of an index hides what is behind it. The messages are counted without it where there are not as
        many as the recording declares.
        """
        found = 0
        for batch in batches:
            found += batch[0][1].size
            yield batch
        tables = [file for file in self._prepared.files if file.suffix == ".db3"]
        if tables and found != sum(topic.count for topic in self.topics if topic.name in topics):
            held = sum(db3.messages_held(file, topics) for file in tables)
            if found != held:
                raise DamagedError(f"its index of times leads to {found} of {held} messages")

    def _stepwise(self, topics: Collection[str]) -> Iterator[Timed]:
        """Yield what rosbags yields message by message."""
        boxes: dict[str, tuple[list[int], list[bytes]]] = {name: ([], []) for name in topics}
        chosen = [item for item in self._reader.connections if item.topic in boxes]
        if not chosen:
            return
        # What rosbags takes from one file of these kinds it takes in the order of time.
        in_order = len(self._prepared.files) == 1 and self._prepared.files[0].suffix in (".db3", ".bag")
        for connection, log_time, raw in self._reader.messages(connections=chosen):
            if not isinstance(raw, bytes):
                raise TypeError(f"a message on {connection.topic} is no bytes but {type(raw).__name__}")
            times, messages = boxes[connection.topic]
            times.append(log_time)
            messages.append(raw)
            if len(messages) == BATCH:
                yield from _emptied(boxes, log_time if in_order else ANYTHING_BEHIND)
        yield from _emptied(boxes, NOTHING_BEHIND)


def _one_after_the_other(files: list[Indexed]) -> Iterator[Timed]:
    """Yield the batches of files."""
    behind = NOTHING_BEHIND
    waiting: list[tuple[Indexed, int]] = []
    for file in reversed(files):
        waiting.append((file, behind))
        behind = min(behind, file.first_ns)
    for file, later in reversed(waiting):
        for batch, behind_ns in file.batches:
            yield batch, min(behind_ns, later)


def _emptied(boxes: dict[str, tuple[list[int], list[bytes]]], behind_ns: int) -> Iterator[Timed]:
    """Yield what waits on each topic, and empty its box; behind the last one nothing comes from before `behind_ns`."""
    filled = [name for name, (times, _) in boxes.items() if times]
    for number, name in enumerate(filled, start=1):
        times, messages = boxes[name]
        boxes[name] = ([], [])
        last = number == len(filled)
        yield (name, np.array(times, np.int64), messages), behind_ns if last else ANYTHING_BEHIND


def _check_kind(path: Path) -> None:
    """Raise InputError where `path` cannot be a recording."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; {_EXPECTED}")
    for file in (item for item in path.iterdir() if item.suffix in _PARTS) if path.is_dir() else (path,):
        check_no_pointer(file)
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            parts = sorted(item.name for item in path.iterdir() if item.suffix in STORAGE_SUFFIXES)
            if not parts:
                raise InputError(f"{path} is no recording; {_EXPECTED}")
            raise InputError(
                f"{path} has no metadata.yaml; run `ros2 bag reindex {path}`, or give its file {path / parts[0]}"
            )
    elif path.suffix in TABLE_SUFFIXES:
        raise InputError(f"{path} is a table, no recording; turn it into one with `friction_estimator import`")
    elif path.suffix not in STORAGE_SUFFIXES:
        raise InputError(f"{path} is no recording; {_EXPECTED}")
    elif not path.is_file():
        raise InputError(f"{path} is a pipe, device or socket, and no recording; {_EXPECTED}")
    elif path.suffix == ".db3" and not is_utf8(str(path)):
        raise InputError(f"{path}: sqlite opens no file whose path is no UTF-8; rename it")
    elif not path.stat().st_size:
        raise InputError(f"{path} is empty (0 bytes): nothing was recorded, or the recorder was killed")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn whatever reading a damaged file raises into one InputError."""
    try:
        yield
    except FrictionEstimatorError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # rosbags and its decompressors raise many kinds, MemoryError for absurd lengths
        reason = re.sub(r"^Cannot open database \S+: ", "", " ".join(str(error).split()))
        remedy = _REMEDIES.get(path.suffix, "check its metadata.yaml, or run `ros2 bag reindex` on it")
        raise InputError(f"{path} is damaged: {reason.rstrip('.') or type(error).__name__}; {remedy}") from error
