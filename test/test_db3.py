"""Recordings of the storage sqlite3: the same messages as by rosbags, in the same order, by pages of any content."""

import random
import sqlite3
import struct
from functools import partial

import apsw
import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from friction_estimator.bag import db3
from friction_estimator.bag.batches import NOTHING_BEHIND
from friction_estimator.bag.placed import Placed
from friction_estimator.bag.source import Source
from friction_estimator.core.errors import InputError

TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
"""
INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
TOPICS = ("/velocity", "/friction", "/camera")
LEAF_OF_AN_INDEX = 0x0A
"""First byte of such a page of SQLite."""

KIND = "std_msgs/msg/Float64"


def database(path, messages, *, tables=TABLES + INDEX, before="", topics=TOPICS):
    """Write (topic, time, payload) as rosbag2 does."""
    file = sqlite3.connect(path)
    file.executescript(before + tables)
    for number, name in enumerate(topics, start=1):
        file.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, name, KIND))
    file.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(topics.index(name) + 1, time, payload) for name, time, payload in messages],
    )
    file.commit()
    file.close()


def by_rosbags(path, topics):
    with Reader(path) as reader:
        chosen = [item for item in reader.connections if item.topic in topics]
        found = {name: [] for name in topics}
        for connection, time, payload in reader.messages(connections=chosen):
            found[connection.topic].append((time, payload))
        return found, {name: info.msgcount for name, info in reader.topics.items()}


def by_pages(path, topics):
    """Return the messages, after looking at what is said of those behind each batch."""
    found = {name: [] for name in topics}
    earlier = []
    with Source(path) as source:
        for (name, times, messages), behind in source.timed_batches(topics):
            assert all(limit <= times.min() for limit in earlier)
            earlier.append(behind)
            payloads = [row.tobytes() for row in messages.rows()] if isinstance(messages, Placed) else messages
            found[name] += zip(times.tolist(), payloads, strict=True)
        assert earlier[-1] == NOTHING_BEHIND
        return found, {topic.name: topic.count for topic in source.topics}


def stream(n, seed=0, *, lengths=(12,), ties=1, shuffled=0):
    """Return messages of both topics in turn and now and then an image; `ties` of one time, `shuffled` by so many."""
    rng = random.Random(seed)
    made = [
        (TOPICS[k % 2] if k % 97 else "/camera", 1_000_000 * (k // ties), rng.randbytes(rng.choice(lengths)))
        for k in range(n)
    ]
    if shuffled:
        made.sort(key=lambda item: item[1] + rng.randrange(shuffled * 1_000_000))
    return made


@pytest.mark.parametrize(
    "messages",
    [
        partial(stream, 30_000),
        partial(stream, 3000, lengths=(12, 13, 400)),
        partial(stream, 1000, lengths=(0, 1)),
        partial(stream, 20_000, shuffled=50),
        partial(stream, 20_000, ties=3),
        partial(stream, 40_000, ties=19_000),
        partial(stream, 300, lengths=(4, 3_000_000)),
        partial(list, [("/velocity", 5, bytes(range(256)))]),
        partial(list, [("/velocity", 5, b"")]),
        partial(list, [("/velocity", -7, b"before 1970"), ("/velocity", 2**62, b"2116")]),
    ],
    ids=["long", "lengths", "empty", "shuffled", "ties", "one time", "large", "one", "one empty", "far"],
)  # fmt: skip
def test_pages_hold_what_rosbags_reads(tmp_path, messages):
    path = tmp_path / "run.db3"
    database(path, messages())
    for topics in (TOPICS[:2], TOPICS[:1]):
        found, counts = by_pages(path, topics)
        theirs, their_counts = by_rosbags(path, topics)
        assert found == theirs
        assert counts == their_counts


def test_a_recording_without_messages_has_topics(tmp_path):
    database(tmp_path / "run.db3", [])
    with Source(tmp_path / "run.db3") as source:
        assert [topic.count for topic in source.topics] == [0, 0, 0]
        assert list(source.timed_batches(TOPICS)) == []


@pytest.mark.parametrize(
    "how",
    [
        {"tables": TABLES},
        {"tables": TABLES + "CREATE INDEX timestamp_idx ON messages (timestamp) WHERE topic_id = 1;"},
        {"tables": TABLES + "CREATE INDEX timestamp_idx ON messages (timestamp DESC);"},
        {"tables": TABLES + "CREATE INDEX timestamp_idx ON messages (timestamp, data);"},
        {"before": "PRAGMA encoding = 'UTF-16le';"},
    ],
    ids=["no index", "an index of some", "a falling index", "an index of more", "another encoding"],
)
def test_without_an_index_of_times_rosbags_reads(tmp_path, how):
    path = tmp_path / "run.db3"
    database(path, stream(500), **how)
    assert db3.indexed(path, TOPICS) is None
    with Source(path) as source:
        found = {name: [] for name in TOPICS}
        for (name, times, messages), _ in source.timed_batches(TOPICS):
            found[name] += zip(times.tolist(), messages, strict=True)
    assert found == by_rosbags(path, TOPICS)[0]


def test_a_topic_of_two_numbers_is_one_topic(tmp_path):
    path = tmp_path / "run.db3"
    database(path, stream(3000))
    file = sqlite3.connect(path)
    file.execute(f"INSERT INTO topics VALUES (9, '/velocity', '{KIND}', 'cdr', '')")
    file.execute("UPDATE messages SET topic_id = 9 WHERE topic_id = 1 AND id % 3 = 0")
    file.commit()
    file.close()
    assert by_pages(path, TOPICS[:2])[0] == by_rosbags(path, TOPICS[:2])[0]


def test_an_index_that_does_not_lead_to_all_messages_is_no_silent_loss(tmp_path):
    """One bit of one of its entries hides what stands behind it."""
    path, time = tmp_path / "run.db3", 10**18
    database(path, [("/velocity", time + 1000 * k, bytes(12)) for k in range(20_000)])
    content, entry = bytearray(path.read_bytes()), struct.pack(">q", time + 9_000_000)
    (place,) = (
        at
        for at in range(len(content))
        if content.startswith(entry, at) and content[at // 4096 * 4096] == LEAF_OF_AN_INDEX
    )
    content[place] ^= 0x20
    path.write_bytes(content)
    with Source(path) as source, pytest.raises(InputError, match=r"leads to \d+ of 20000 messages"):
        list(source.timed_batches(["/velocity"]))


def test_the_last_time_of_all_is_read(tmp_path):
    path = tmp_path / "run.db3"
    messages = [("/velocity", 5, b"a"), ("/velocity", NOTHING_BEHIND, b"b")]
    database(path, messages)
    assert by_pages(path, TOPICS[:1])[0]["/velocity"] == [(time, payload) for _, time, payload in messages]


def test_a_page_too_long_for_sqlite_is_halved(tmp_path, monkeypatch):
    path = tmp_path / "run.db3"
    messages = [("/velocity", k, b"x" * (10 if k < 200 else 9000)) for k in range(400)]
    database(path, messages)
    open_file, asked = db3._opened, []

    def opened(path):
        file = open_file(path)
        file.limit(apsw.SQLITE_LIMIT_LENGTH, 100_000)
        file.exec_trace = lambda _, query, values: asked.append((query, values)) or True
        return file

    monkeypatch.setattr(db3, "_opened", opened)
    assert by_pages(path, TOPICS[:1])[0]["/velocity"] == [(time, payload) for _, time, payload in messages]
    pages = [asking for asking in asked if "group_concat" in asking[0]]
    assert len(pages) > len(set(pages)) - 1 > 10


def test_characters_of_a_uri_in_the_path(tmp_path):
    folder = tmp_path / "50 % #1?mode=rwc&x"
    folder.mkdir()
    database(folder / "run?.db3", stream(10))
    assert by_pages(folder / "run?.db3", TOPICS)[1]["/velocity"] > 0
    assert [item.name for item in folder.iterdir()] == ["run?.db3"]


OLD = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("DROP TABLE messages", "it has no table 'messages'"),
        ("DROP TABLE topics", "it has no table 'topics'"),
        ("DROP TABLE messages; CREATE VIEW messages AS SELECT 1 AS topic_id, 2 AS timestamp, 3 AS data", "no table"),
        ("UPDATE messages SET timestamp = 1.5 WHERE id = 7", "a message lacks its time, topic or payload"),
        ("UPDATE messages SET timestamp = 'now' WHERE id = 90", "a message has a time that is no integer"),
        ("UPDATE messages SET data = 'über' WHERE id = 7", "a message is no sequence of bytes"),
    ],
)
def test_what_is_no_recording_is_said_in_one_line(tmp_path, change, words):
    path = tmp_path / "run.db3"
    database(path, stream(100))
    file = sqlite3.connect(path)
    file.executescript(change)
    file.close()
    with pytest.raises(InputError, match=words) as raised, Source(path) as source:
        list(source.timed_batches(TOPICS))
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE messages SET data = NULL WHERE id = 7",
        "UPDATE messages SET data = NULL",
        "UPDATE messages SET data = 'twelve chars' WHERE id = 7",
        # Sixteen bytes that count as eight, beside eight where twelve are usual: together as long as two messages.
        "UPDATE messages SET data = 'éééééééé' WHERE id = 20; UPDATE messages SET data = x'3132333435363738' "
        "WHERE id = 21",
        "UPDATE messages SET data = NULL WHERE id = 20; UPDATE messages SET data = 'éééééééééééé' WHERE id = 21",
    ],
)
def test_a_payload_that_is_none_is_said(tmp_path, change):
    path = tmp_path / "run.db3"
    database(path, stream(60), tables=(TABLES + INDEX).replace("data BLOB NOT NULL", "data BLOB"))
    file = sqlite3.connect(path)
    file.executescript(change)
    file.close()
    words = r"a message (is no sequence of bytes|lacks its time, topic or payload)"
    with pytest.raises(InputError, match=words), Source(path) as source:
        list(source.timed_batches(TOPICS))


def test_odd_rows_of_other_topics_are_no_matter(tmp_path):
    """A topic without a number, and a time between two nanoseconds where a page begins."""
    path = tmp_path / "run.db3"
    tables = TABLES.replace("id INTEGER PRIMARY KEY, name", "id, name").replace(
        "timestamp INTEGER NOT NULL", "timestamp"
    )
    database(path, [(TOPICS[2 * (k == 3)], 1000 + 10 * k, b"twelve bytes") for k in range(60)], tables=tables + INDEX)
    file = sqlite3.connect(path)
    file.executescript(
        f"INSERT INTO topics VALUES (NULL, '/velocity', '{KIND}', 'cdr', '');"
        "UPDATE messages SET timestamp = timestamp - 0.5 WHERE topic_id = 3"
    )
    file.close()
    found, _ = by_pages(path, TOPICS[:1])
    assert found["/velocity"] == [(1000 + 10 * k, b"twelve bytes") for k in range(60) if k != 3]


def test_tables_of_the_first_rosbag2(tmp_path):
    path = tmp_path / "run.db3"
    file = sqlite3.connect(path)
    file.executescript(
        OLD + TABLES[TABLES.index("CREATE TABLE messages") :] + INDEX + "INSERT INTO topics VALUES (1, '/velocity', "
        f"'{KIND}', 'cdr'); INSERT INTO messages VALUES (1, 1, 5, x'00010000');"
    )
    file.close()
    assert by_pages(path, ["/velocity"]) == ({"/velocity": [(5, b"\0\1\0\0")]}, {"/velocity": 1})


def test_a_page_is_bounded_in_bytes(tmp_path):
    path = tmp_path / "run.db3"
    database(path, [("/velocity", k, bytes(200_000)) for k in range(600)])
    indexed = db3.indexed(path, ["/velocity"])
    sizes = [len(messages) * messages.length for (_, _, messages), _ in indexed.batches]
    assert max(sizes) <= db3.PAGE_BYTES
    assert np.sum(sizes) == 600 * 200_000
