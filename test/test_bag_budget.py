"""What is damaged, packed or still being written: read whole, or refused in one line, in bounded memory."""

import bz2
import ctypes
import os
import shlex
import signal
import sqlite3
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml
from hard import bombs
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from scipy.io import savemat

from friction_estimator.bag.budget import TooLargeError, unpack
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.serialise import typestore
from friction_estimator.bag.source import Source
from friction_estimator.bag.table import TableSpec, read_table
from friction_estimator.bag.write import write_samples
from friction_estimator.core.errors import InputError, UnanswerableError
from friction_estimator.core.memory import give_back
from friction_estimator.core.sample import NS_PER_S, Samples

START = 1_700_000_000 * NS_PER_S
SPEC = TableSpec("t", {"velocity": "v", "friction": "f"})


def recorded(n):
    k = np.arange(n)
    return Samples(START + 1_000_000 * k, np.sin(0.01 * k), np.cos(0.01 * k), k == 0)


def refused(path, read=read_recording):
    """Return the line that refuses a file, after a look at the memory it took."""
    tracemalloc.start()
    with pytest.raises((InputError, UnanswerableError)) as caught:
        read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# Messages in SQLite's journal

RECORDER = """
import sqlite3, sys, time
connection = sqlite3.connect(sys.argv[1])
connection.execute("PRAGMA journal_mode=WAL")
connection.execute("PRAGMA wal_autocheckpoint=0")
with connection:
    last = connection.execute("SELECT max(id) FROM messages").fetchone()[0]
    for k in range(2000):
        connection.execute(
            "INSERT INTO messages(id, topic_id, timestamp, data) SELECT ?, topic_id, timestamp + ?, data "
            "FROM messages WHERE id = ?", (last + 1 + k, 1_000_000_000 * (1 + k), 1 + k % 54))
print("written", flush=True)
time.sleep(600)
"""


def recorder(path):
    """Start a process that writes 2000 messages into a recording's write-ahead log, and does not end."""
    process = subprocess.Popen([sys.executable, "-c", RECORDER, str(path)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"written\n"
    return process


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("killed", [False, True])
def test_what_stands_in_the_write_ahead_log_is_read(tmp_path, folder, killed):
    write_samples(tmp_path / "run", recorded(27), "sqlite3")
    file = tmp_path / "run" / "run.db3"
    process = recorder(file)
    try:
        if killed:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        before = {item.name: item.read_bytes() for item in file.parent.iterdir()}
        with Source(file) as source:
            assert source.message_count == 2054
        recording = read_recording(file.parent if folder else file)
        assert sum(len(recording.streams[name]) for name in ("velocity", "friction")) == 2054
        told = [note for note in recording.notes if "run.db3-wal holds messages" in note]
        assert len(told) == 1
        assert (f"process {process.pid} has the recording open" in told[0]) != killed
        assert {item.name: item.read_bytes() for item in file.parent.iterdir()} == before  # nothing was written there
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_half_of_a_transaction_is_rolled_back(tmp_path):
    write_samples(tmp_path / "run.db3", recorded(3000), "sqlite3")
    whole = (tmp_path / "run.db3").read_bytes()
    connection = sqlite3.connect(tmp_path / "run.db3", isolation_level=None)
    connection.execute("PRAGMA cache_size=2")  # so that pages go into the file before the end
    connection.execute("PRAGMA cache_spill=1")
    connection.execute("BEGIN")
    connection.execute("DELETE FROM messages WHERE id > 100")
    journal = (tmp_path / "run.db3-journal").read_bytes()
    torn = (tmp_path / "run.db3").read_bytes()
    connection.close()
    assert torn != whole
    (tmp_path / "torn.db3").write_bytes(torn)
    (tmp_path / "torn.db3-journal").write_bytes(journal)
    assert len(read_recording(tmp_path / "torn.db3").streams["velocity"]) == 3000


def test_a_damaged_write_ahead_log_is_refused_or_read_without_it(tmp_path):
    write_samples(tmp_path / "run.db3", recorded(27), "sqlite3")
    (tmp_path / "run.db3-wal").write_bytes(b"noise" * 1000)
    assert len(read_recording(tmp_path / "run.db3").streams["velocity"]) == 27


# What unpacks to far more than it is


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared", [None, 100])
@pytest.mark.parametrize("indexed", [True, False])
def test_a_chunk_that_unpacks_to_far_more_is_refused(tmp_path, compression, declared, indexed):
    bombs.mcap_chunk(tmp_path / "run.mcap", 1 << 29, compression, declared=declared, indexed=indexed)
    assert (tmp_path / "run.mcap").stat().st_size < 3e6
    assert "are the most that is read" in refused(tmp_path / "run.mcap") or declared


def test_a_message_that_unpacks_to_far_more_is_refused(tmp_path):
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        for topic, kind in (("/velocity", "TwistStamped"), ("/friction", "WrenchStamped")):
            connection = writer.add_connection(topic, f"geometry_msgs/msg/{kind}", typestore=typestore())
            writer.write(connection, START, bytes(100 << 20))
    assert "unpacks to more than" in refused(tmp_path / "run")


def test_a_chunk_of_ros_1_that_unpacks_to_far_more_is_refused(tmp_path):
    writer = Ros1Writer(tmp_path / "run.bag")
    writer.set_compression(Ros1Writer.CompressionFormat.BZ2)
    with writer:
        for topic, kind in (("/velocity", "TwistStamped"), ("/friction", "WrenchStamped")):
            connection = writer.add_connection(topic, f"geometry_msgs/msg/{kind}", typestore=typestore())
            writer.write(connection, START, bytes(80 << 20))
    assert "unpacks to more than" in refused(tmp_path / "run.bag")


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_pieces_unpack_up_to_their_size_and_no_further(compression):
    plain = np.random.default_rng(0).integers(0, 4, 300_000, np.uint8).tobytes()
    if compression == "bz2":
        packed = bz2.compress(plain)
    else:
        packer = bombs.zstd if compression == "zstd" else bombs.lz4.frame
        packed = packer.compress(plain)
    assert unpack(packed, compression, len(plain)) == plain
    assert unpack(packed + packed, compression) == plain + plain
    with pytest.raises(TooLargeError):
        unpack(packed, compression, len(plain) - 1)
    with pytest.raises(ValueError, match="end early"):
        unpack(packed[:-20], compression)


def test_a_large_column_that_nobody_mapped_costs_nothing(tmp_path):
    bombs.table(tmp_path / "run.npz", 1 << 24, mapped=False)  # 134 MB
    tracemalloc.start()
    samples, _ = read_table(tmp_path / "run.npz", SPEC)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(samples) == 9
    assert peak < 20e6


def test_a_mapped_column_beyond_the_budget_is_refused_before_it_is_read(tmp_path):
    bombs.table(tmp_path / "run.npz", 9 << 23, mapped=True)  # 604 MB
    assert "unpacks to 604 MB, where 537 MB" in refused(tmp_path / "run.npz", lambda path: read_table(path, SPEC))


def test_an_array_of_objects_is_refused(tmp_path):
    np.savez(tmp_path / "run.npz", t=np.arange(3.0), v=np.array([1.0, None, 2.0], dtype=object), f=np.arange(3.0))
    with pytest.raises(InputError, match=r"run\.npz: v holds Python objects, not numbers"):
        read_table(tmp_path / "run.npz", SPEC)


# A reader that a file crashes


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (28, 0, "no column 't'"),  # a size of the shape: the name is lost
        (48, 0, "is damaged: the reader of .mat files ended with signal 11"),  # the kind of the numbers
        (48, 14, "is damaged: the reader of .mat files ended with signal 11"),
    ],
)
def test_a_mat_file_that_crashes_its_reader_ends_in_one_line(tmp_path, place, value, words):
    path = tmp_path / "run.mat"
    savemat(path, {"t": np.arange(10.0)})
    data = bytearray(path.read_bytes())
    data[128 + place] = value
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_table(path, TableSpec("t", {"velocity": "t", "friction": "t"}))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert words in str(caught.value)


def test_a_list_of_files_that_is_a_word_is_refused(tmp_path):
    write_samples(tmp_path / "run", recorded(27))
    about = tmp_path / "run" / "metadata.yaml"
    tree = yaml.safe_load(about.read_text())
    tree["rosbag2_bagfile_information"]["files"] = "run.mcap"
    about.write_text(yaml.safe_dump(tree))
    with pytest.raises(InputError, match=r"files is \S+, expected a list of files"):
        read_recording(tmp_path / "run")


def test_a_table_is_read_where_less_memory_is_allowed_than_its_reader_would_take(tmp_path):
    """`ulimit -v` of 900 MB: nobody may raise it, and the reader's own limit would lie above."""
    t = 0.01 * np.arange(100)
    savemat(tmp_path / "run.mat", {"t": t, "v": np.sin(t), "f": np.cos(t)})
    words = ["import", "run.mat", "--out", "out", "--time", "t", "--map", "velocity=v,friction=f"]
    limited = f"ulimit -v {900 << 10} && exec {shlex.quote(sys.executable)} -m friction_estimator {' '.join(words)}"
    run = subprocess.run(["/bin/sh", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def resident_MB() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the C library is not glibc")
def test_what_was_freed_between_what_is_kept_is_given_back():
    before = resident_MB()
    blocks = [bytes(1000) for _ in range(100_000)]
    kept = blocks[-1]
    blocks.clear()
    give_back()
    assert resident_MB() - before < 50.0
    assert len(kept) == 1000
