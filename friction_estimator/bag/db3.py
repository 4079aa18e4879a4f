"""Recordings of the storage sqlite3 (.db3): opened without counting their messages, and read a page of them at a time.

SQLite joins the payloads of a page and writes times, topics and lengths of its messages behind each other: one row is
handed to Python where rosbags takes one a message (docs/decisions/0147). The tables are rosbag2_storage_sqlite3's, and
apsw is what rosbags opens them with: its SQLite is newer than most Pythons', and quicker by a third.
"""

from collections.abc import Collection, Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import apsw
import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos
from rosbags.rosbag2.reader import DirectoryReader

from friction_estimator.bag.batches import NOTHING_BEHIND, DamagedError, Indexed, Timed
from friction_estimator.bag.placed import payloads
from friction_estimator.core.sample import Ints

PAGE = 8192
"""Messages of a page on all topics, but for more of one and the same time."""

PAGE_BYTES = 16 * 2**20
"""Bytes of payload that a page is meant to have, at most."""

_FIRST_PAGE = 1
"""Messages of the first page: nobody knows yet how long they are. The next ones have at most twice as many each."""

_BEHIND = "SELECT timestamp FROM messages INDEXED BY {index} WHERE timestamp >= ? ORDER BY timestamp LIMIT 1 OFFSET ?"

_LATER = "SELECT min(timestamp) FROM messages INDEXED BY {index} WHERE timestamp > ?"

_OF_PAGE = "FROM messages INDEXED BY {index} WHERE timestamp BETWEEN ? AND ? AND topic_id IN ({topics})"

_PAGE = f"""
SELECT count(*), typeof(min(data)), max(length(data)),
  CAST(group_concat(data, '') AS BLOB), group_concat(timestamp - ?), group_concat(topic_id)
{_OF_PAGE}
"""
"""To SQLite all numbers and texts are less than a blob: where the least is one, all are, and lengths are those in
bytes; what is NULL has none. Times are counted from a moment shortly before: fewer digits are quicker to write."""

_LENGTHS = f"SELECT group_concat(length(data)) {_OF_PAGE}"
"""Asked for where the messages of a page have not all one length."""

_OF_NAMES = "SELECT id FROM topics WHERE name IN ({})"

_UNKNOWN = MessageDefinition(MessageDefinitionFormat.NONE, "")


class Storage:
    """One file, as rosbags asks for the messages of its storages.

    rosbags' own counts the messages of each topic by a join when it opens a file, which takes as long as to read all
    of them here. In a folder nobody asks for these numbers: metadata.yaml has them.

    Parameters
    ----------
    path : the file.
    """

    counted = False
    """Whether opening counts the messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.metadata = ReaderMetadata(0, 2**63 - 1, 0, 0, None, None, None, None)
        self._database: apsw.Connection | None = None

    def open(self) -> None:
        """Read the topics. Raises DamagedError or apsw.Error where it is no recording."""
        self._database = _opened(self.path)
        try:
            self._read_topics(self._database)
        except BaseException:
            self.close()
            raise

    def _read_topics(self, database: apsw.Connection) -> None:
        _columns(database, "messages")
        own = _columns(database, "topics")
        # Older versions of rosbag2 have no such columns.
        optional = [name if name in own else "''" for name in ("offered_qos_profiles", "type_description_hash")]
        wanted = ", ".join(["id", "name", "type", "serialization_format", *optional])
        topics = _rows(database, f"SELECT {wanted} FROM topics ORDER BY id")
        counts: dict[int, int] = {}
        if self.counted:
            found = _rows(database, "SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id")
            counts = {int(number): count for number, count in found if number is not None}
            self.metadata = _span(database, sum(count for _, count in found))
        for number, name, kind, form, qos, digest in topics:
            about = ConnectionExtRosbag2(form, parse_qos(qos))
            count = counts.get(number, 0)
            self.connections.append(Connection(number, name, kind, _UNKNOWN, digest, count, about, self))

    def close(self) -> None:
        """Let go of the file."""
        if self._database is not None:
            self._database.close()
        self._database = None

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield connection, time of recording (ns) and payload of messages in the order of time."""
        assert self._database is not None
        own = {item.id: item for item in connections}
        conditions, values = [f"topic_id IN ({_marks(own)})"], list(own)
        for comparison, limit in (("timestamp >= ?", start), ("timestamp < ?", stop)):
            if limit is not None:
                conditions.append(comparison)
                values.append(limit)
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE {' AND '.join(conditions)} ORDER BY timestamp"
        for number, time_ns, payload in self._database.execute(query, values):
            yield own[number], time_ns, payload


class CountedStorage(Storage):
    """A file without metadata.yaml: how many messages it holds is counted."""

    counted = True


class _Folder(DirectoryReader):
    STORAGE_PLUGINS = MappingProxyType({**DirectoryReader.STORAGE_PLUGINS, "sqlite3": Storage})


class RecordingReader(Reader):
    """rosbags' reader of ROS 2 recordings, with .db3 files opened as here."""

    STORAGE_PLUGINS = MappingProxyType({**Reader.STORAGE_PLUGINS, "dir": _Folder, ".db3": CountedStorage})


def indexed(path: Path, topics: Collection[str]) -> Indexed | None:
    """Return the messages of some topics page by page in the order of time; None where no index leads to them so.

    Raises
    ------
    DamagedError or apsw.Error, here or while iterating, where the file is damaged.
    """
    with closing(_opened(path)) as database:
        index = _index_of_times(database)
        ((encoding,),) = _rows(database, "PRAGMA encoding")
        span = _span(database, 0)
        # Joined payloads would be taken for text of another encoding; the last time is what says that nothing follows.
        if index is None or encoding != "UTF-8" or span.end_time > NOTHING_BEHIND:
            return None
        names = {number: name for number, name in _rows(database, "SELECT id, name FROM topics") if name in topics}
        return Indexed(span.start_time, _pages(path, index, names))


def messages_held(path: Path, topics: Collection[str]) -> int:
    """Return how many messages of some topics a file holds, without its index."""
    query = f"SELECT count(*) FROM messages NOT INDEXED WHERE topic_id IN ({_OF_NAMES.format(_marks(topics))})"
    with closing(_opened(path)) as database:
        return int(_rows(database, query, list(topics))[0][0])


def _opened(path: Path) -> apsw.Connection:
    """Return a file as it is: what stands in journals beside it was put into a copy before (`write_ahead`).

    It may be opened in one thread and read in another.
    """
    flags = apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    return apsw.Connection(f"file:{quote(str(path))}?immutable=1", flags=flags)


def _rows(database: apsw.Connection, query: str, values: Sequence[int | str] = ()) -> list[tuple[Any, ...]]:
    return database.execute(query, values).fetchall()


def _columns(database: apsw.Connection, table: str) -> list[str]:
    """Return the columns of a table. Raises DamagedError where there is none."""
    if _rows(database, "SELECT type FROM sqlite_master WHERE name = ?", (table,)) != [("table",)]:
        raise DamagedError(f"it has no table {table!r}")
    return [name for _, name, *_ in _rows(database, f"PRAGMA table_info({table})")]


def _index_of_times(database: apsw.Connection) -> str | None:
    """Return an index of all messages by nothing but their time, as rosbag2 makes it."""
    for _, name, _, _, partial in _rows(database, "PRAGMA index_list(messages)"):
        columns = _rows(database, f"PRAGMA index_xinfo({_quoted(name)})")
        keys = [(column, descends) for _, _, column, descends, _, is_key in columns if is_key]
        if keys == [("timestamp", 0)] and not partial:
            return str(name)
    return None


def _span(database: apsw.Connection, count: int) -> ReaderMetadata:
    """Return what rosbags keeps of times: the first, and a moment after the last, ns. Raises DamagedError."""
    ((first,),) = _rows(database, "SELECT min(timestamp) FROM messages")
    ((last,),) = _rows(database, "SELECT max(timestamp) FROM messages")
    if first is None:
        return ReaderMetadata(0, NOTHING_BEHIND, 0, count, None, None, None, None)
    if not isinstance(first, int) or not isinstance(last, int):  # text is behind all numbers
        raise DamagedError("a message has a time that is no integer")
    return ReaderMetadata(last + 1 - first, first, last + 1, count, None, None, None, None)


def _pages(path: Path, index: str, topics: dict[int, str]) -> Iterator[Timed]:
    """Yield the messages of topics by number, a batch for each topic of a page."""
    asked = list(topics)
    parts = {"index": _quoted(index), "topics": _marks(asked)}
    behind_of, later_than, page_of, lengths_of = (q.format(**parts) for q in (_BEHIND, _LATER, _PAGE, _LENGTHS))
    rows, from_ns = _FIRST_PAGE, -(2**63)
    with closing(_opened(path)) as database:
        while from_ns != NOTHING_BEHIND:
            ((behind_ns,),) = _rows(database, behind_of, (from_ns, rows)) or [(None,)]
            if behind_ns == from_ns:
                ((behind_ns,),) = _rows(database, later_than, (from_ns,))
            behind_ns = NOTHING_BEHIND if behind_ns is None else behind_ns
            if behind_ns <= from_ns:
                raise DamagedError("its index of times is wrong")
            place, before_ns = (from_ns, behind_ns - 1, *asked), max(int(from_ns), 0)
            try:
                ((count, kind, longest, joined, *page),) = _rows(database, page_of, (before_ns, *place))
            except apsw.TooBigError:  # longer than a value of SQLite may be
                if rows == 1:
                    raise
                rows //= 2
                continue
            if count:
                if kind != "blob":
                    raise DamagedError("a message is no sequence of bytes")
                lengths = np.full(count, longest)
                if lengths.sum() != len(joined):  # not all of them are as long as the longest
                    lengths = _integers(_rows(database, lengths_of, place)[0][0], count)
                times, numbers = (_integers(column, count) for column in page)
                yield from _batches(joined, lengths, times + before_ns, numbers, topics, behind_ns)
            rows = max(1, min(PAGE, 2 * rows, PAGE_BYTES // max(1, longest or 0)))
            from_ns = behind_ns


def _batches(
    joined: bytes, lengths: Ints, times: Ints, numbers: Ints, topics: dict[int, str], behind_ns: int
) -> Iterator[Timed]:
    """Yield the batches of a page: joined payloads; of each message its length, time and topic's number."""
    if lengths.sum() != len(joined):
        raise DamagedError("a message is no sequence of bytes")
    if np.any(times[1:] < times[:-1]):
        raise DamagedError("its index of times is wrong")
    records, starts = np.frombuffer(joined, np.uint8), np.cumsum(lengths) - lengths
    by_name: dict[str, list[int]] = {}
    for number in np.unique(numbers).tolist():
        by_name.setdefault(topics[number], []).append(number)
    for left, (name, own_numbers) in zip(range(len(by_name) - 1, -1, -1), by_name.items(), strict=True):
        own = numbers == own_numbers[0] if len(own_numbers) == 1 else np.isin(numbers, own_numbers)
        batch = name, times[own], payloads(records, starts[own], lengths[own])
        yield batch, int(times[0]) if left else behind_ns


def _integers(column: str | None, count: int) -> Ints:
    """Return the numbers of a column of a page, (count,). Raises DamagedError where they are not so many integers."""
    values = np.zeros(0, np.int64)
    if column is not None and not column.encode().translate(None, b"0123456789-,"):
        values = np.fromstring(column, np.int64, sep=",")
    if values.size != count:
        raise DamagedError("a message lacks its time, topic or payload")
    return values


def _marks(values: Collection[object]) -> str:
    return ", ".join("?" * len(values))


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
