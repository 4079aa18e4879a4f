"""A replay that learns while it reads: the figures of one that reads first, to the bit, and it ends as that does."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

import friction_estimator
from friction_estimator.bag import read, samples, source
from friction_estimator.bag.ahead import ahead
from friction_estimator.bag.merge import Merge, OutOfOrderError
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import Piece, Read, sample_pieces, to_samples
from friction_estimator.bag.serialise import sample_template, typestore
from friction_estimator.bag.write import TOPICS, write_samples
from friction_estimator.cli import replay as verb
from friction_estimator.cli.main import main
from friction_estimator.cli.recorded import _read_and_learned as read_and_learned
from friction_estimator.core.online import record_figures
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import concluded, replay
from friction_estimator.core.online.run import Run
from friction_estimator.core.sample import NS_PER_S, Samples, joined
from friction_estimator.core.settings.config import Config

START = 1_700_000_000 * NS_PER_S
N = 20_003


def driven(n, seed=1, **channels):
    k = np.arange(n)
    velocity = 0.1 * np.sin(0.01 * k) * (1.0 + 0.5 * np.sin(0.0007 * k))
    noise = 0.05 * np.random.default_rng(seed).standard_normal(n)
    return Samples(START + 1_000_000 * k, velocity, 3.0 * np.tanh(50.0 * velocity) + noise, k == 0, **channels)


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch):
    monkeypatch.setattr(samples, "CHUNK", 1501)
    monkeypatch.setattr(read, "GATHERED", 1009)
    monkeypatch.setattr(source, "BATCH", 307)


# Pieces


def assert_same(one, other):
    for name in ("predicted_N", "deviation_N", "learned"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    for name in ("snapshot_index", "starts", "contact", "health"):
        assert getattr(one, name) == getattr(other, name), name
    state, again = (each.estimator.state()["arrays"] for each in (one, other))
    assert {name: values.tobytes() for name, values in state.items()} == {
        name: values.tobytes() for name, values in again.items()
    }
    for snapshot, expected in zip(one.snapshots, other.snapshots, strict=True):
        assert snapshot.theta.tobytes() == expected.theta.tobytes()


def in_pieces(parts, config, rng):
    run = Run(config)
    for part in parts:
        run.begin()
        at = 0
        while at < len(part):
            size = int(rng.integers(1, 2500))
            run.push(part[at : at + size])
            at += size
    return concluded(run, joined(parts))


@pytest.mark.parametrize("law", ["lms", "nlms", "rls"])
@pytest.mark.parametrize("seed", [0, 1])
def test_where_pieces_end_changes_no_bit(law, seed):
    parts = [
        replace(driven(700), velocity_m_s=np.zeros(700)),  # the first contact comes in the second recording
        driven(9000, 2, pressure_Pa=np.full(9000, 3e5)),
        driven(3001, 3),
    ]
    config = Config.from_mapping({"model.law": law})
    whole = replay(joined(parts), config, starts=(0, 700, 9700))
    assert whole.contact.samples > 700
    assert_same(in_pieces(parts, config, np.random.default_rng(seed)), whole)


def test_snapshots_are_few_whatever_the_length():
    result = replay(driven(40_000), Config.from_mapping({"model.law": "lms"}), starts=(0, 17_001))
    index = np.array(result.snapshot_index)
    assert 100 <= index.size <= 203
    assert {17_000, 39_999} <= set(index.tolist())
    regular = index[(index != 17_000) & (index != 39_999)]
    assert np.unique(np.diff(regular)).size == 1


# The verb


def reading_threads():
    return [thread for thread in threading.enumerate() if thread.name == "reading"]


def replayed(capsys, *words):
    assert main(["replay", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out) | {"samples_per_second": 0}


def told(capsys, *words):
    code = main(["replay", *map(str, words)])
    return code, capsys.readouterr().err


@pytest.fixture
def read_first(monkeypatch):
    """Return what makes `replay` read all before it learns."""
    return lambda: monkeypatch.setattr(verb.Learner, "begin", lambda self, _config: self.give_up())


def awaited(holds):
    """Wait until something holds."""
    for _ in range(6000):
        if holds():
            return
        time.sleep(0.01)
    raise AssertionError


@pytest.fixture
def pushed(monkeypatch):
    """Return how many samples were learned before all was known, by the piece."""
    found = []
    before = verb.Learner.push

    def push(self, piece):
        if self._run is not None:
            found.append(len(piece))
        before(self, piece)

    monkeypatch.setattr(verb.Learner, "push", push)
    return found


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("extra", [(), ("--law", "lms", "--test")])
def test_a_recording_learned_while_it_is_read(tmp_path, capsys, read_first, pushed, storage, extra):
    position = np.cumsum(1e-4 * np.sin(0.01 * np.arange(N)))
    write_samples(tmp_path / "one", driven(N, position_m=position), storage)
    write_samples(tmp_path / "two", driven(3001, 2), storage)
    words = (*extra, tmp_path / "two") if extra else ()
    found = replayed(capsys, tmp_path / "one", *words)
    assert len(pushed) > 3
    pushed.clear()
    read_first()
    assert found == replayed(capsys, tmp_path / "one", *words)
    assert not pushed


def test_several_recordings_of_several_kinds(tmp_path, capsys, read_first):
    bags = [tmp_path / name for name in ("a", "b", "c.mcap")]
    write_samples(bags[0], driven(2003), "sqlite3")
    write_samples(bags[1], driven(N, 2, pressure_Pa=np.full(N, 2e5)), "mcap")
    write_samples(bags[2], driven(901, 3), "mcap")
    found = replayed(capsys, *bags)
    read_first()
    assert found == replayed(capsys, *bags)


def test_a_recording_that_is_not_as_it_says_is_learned_anew(tmp_path, capsys, monkeypatch, read_first, pushed):
    """Some of it was learned when a message comes that was recorded before."""
    write_samples(tmp_path / "run.mcap", driven(N))
    handed_on, before = [], Merge.before

    def late(self, log_time_ns):
        handed_on.append(log_time_ns)
        if len(handed_on) == 4:
            awaited(lambda: sum(pushed) > 1000)
            raise OutOfOrderError
        return before(self, log_time_ns)

    with monkeypatch.context() as patch:
        patch.setattr(Merge, "before", late)
        patch.setattr(read, "GATHERED", 1)
        found = replayed(capsys, tmp_path / "run.mcap")
    assert len(handed_on) == 4
    assert sum(pushed) > 1000
    read_first()
    assert found == replayed(capsys, tmp_path / "run.mcap")


def damage(path):
    """Spoil the declared size of a chunk in the middle of an mcap file."""
    content = bytearray(path.read_bytes())
    chunks, at = [], 8
    while at + 9 < len(content) - 8:
        if content[at] == 0x06:
            chunks.append(at)
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    assert len(chunks) > 2
    content[chunks[len(chunks) // 2] + 9 + 16] ^= 0xFF
    path.write_bytes(content)


def test_a_damaged_file_is_told_as_before(tmp_path, capsys, read_first, pushed):
    write_samples(tmp_path / "whole", driven(5001), "mcap")
    write_samples(tmp_path / "run.mcap", driven(N))
    damage(tmp_path / "run.mcap")
    bags = (tmp_path / "whole", tmp_path / "run.mcap")
    code, text = told(capsys, *bags)
    assert sum(pushed) > 5001
    assert (code, text.count("\n")) == (2, 1)
    assert "damaged" in text
    assert not reading_threads()
    read_first()
    assert told(capsys, *bags) == (code, text)


def test_what_learning_refuses_is_told_after_what_reading_refuses(tmp_path, capsys, read_first):
    constant = replace(driven(N), friction_N=np.full(N, 2.0))
    write_samples(tmp_path / "constant", constant, "mcap")
    write_samples(tmp_path / "run.mcap", driven(N))
    damage(tmp_path / "run.mcap")
    words = [(tmp_path / "constant",), (tmp_path / "constant", tmp_path / "run.mcap")]
    found = [told(capsys, *bags) for bags in words]
    assert [code for code, _ in found] == [1, 2]
    assert "constant" in found[0][1]
    read_first()
    assert found == [told(capsys, *bags) for bags in words]


def test_a_fault_of_learning_is_raised_when_all_is_read(tmp_path, capsys, monkeypatch):
    write_samples(tmp_path / "run", driven(N), "mcap")
    monkeypatch.setattr(Run, "_note", lambda _: 1 / 0)
    code, text = told(capsys, tmp_path / "run")
    assert (code, text.count("\n")) == (70, 1)
    assert not reading_threads()


# What is formed while some are still learned


@pytest.fixture
def figures_first(monkeypatch):
    """Let a recording end when the first contact is known, and learning go on when the figures are formed."""
    formed, met, push, outline = threading.Event(), threading.Event(), Run.push, read.Reading.outline
    steps = RecordFigures.formed

    def waiting(self, piece):
        push(self, piece)
        if self.known_contact is not None and not met.is_set():
            met.set()
            assert formed.wait(60.0)

    def told(self):
        assert met.wait(60.0)
        return outline(self)

    def all_formed(self):
        try:
            yield from steps(self)
        finally:
            formed.set()

    monkeypatch.setattr(Run, "push", waiting)
    monkeypatch.setattr(read.Reading, "outline", told)
    monkeypatch.setattr(RecordFigures, "formed", all_formed)
    return formed


@pytest.fixture
def threads_of(monkeypatch):
    """Return the threads in which standstill was sought in the whole record."""
    names, before = [], record_figures.standstill

    def noted(found, top_speed):
        names.append(threading.current_thread().name)
        return before(found, top_speed)

    monkeypatch.setattr(record_figures, "standstill", noted)
    return names


def test_figures_are_formed_while_samples_are_learned(tmp_path, capsys, read_first, figures_first, threads_of):
    steady = replace(driven(N), velocity_m_s=0.1 * np.sin(0.01 * np.arange(N)))
    write_samples(tmp_path / "run", steady, "mcap")
    found = replayed(capsys, tmp_path / "run")
    assert figures_first.is_set()
    assert threads_of == ["reading"]
    read_first()
    assert found == replayed(capsys, tmp_path / "run")
    assert threads_of == ["reading", "MainThread"]


def test_figures_are_formed_anew_where_the_range_grows_after_them(
    tmp_path, capsys, read_first, figures_first, threads_of
):
    slow = driven(N)
    faster = np.where(np.arange(N) < N // 2, 0.5, 1.0)
    write_samples(tmp_path / "run", replace(slow, velocity_m_s=faster * slow.velocity_m_s), "mcap")
    found = replayed(capsys, tmp_path / "run")
    assert figures_first.is_set()
    assert found["health"]["grown"] > 0
    assert threads_of == ["reading", "MainThread"]
    read_first()
    assert found == replayed(capsys, tmp_path / "run")


@pytest.mark.usefixtures("figures_first")
def test_a_fault_of_the_figures_is_told_as_before(tmp_path, capsys, monkeypatch, read_first):
    write_samples(tmp_path / "run", driven(N), "mcap")
    monkeypatch.setattr(record_figures, "standstill", lambda *_: 1 / 0)
    found = told(capsys, tmp_path / "run")
    assert (found[0], found[1].count("\n")) == (70, 1)
    assert not reading_threads()
    read_first()
    assert found == told(capsys, tmp_path / "run")


def test_the_bar_follows_what_is_learned(tmp_path, monkeypatch, figures_first):
    """All is read, and the figures are formed, when the first contact has just been met."""
    write_samples(tmp_path / "run", driven(N), "mcap")
    at, told_so_far = [], []
    waiting = Run.push

    def push(self, piece):
        waiting(self, piece)
        at.append((self.known_contact is not None, sum(told_so_far)))

    monkeypatch.setattr(Run, "push", push)
    learner = verb.Learner(False)
    read_and_learned(tmp_path / "run", Config(), {}, lambda done, _: told_so_far.append(done), learner, alone=True)
    assert figures_first.is_set()
    first = next(told for met, told in at if met)
    assert first < N < sum(told_so_far) == 2 * N


def test_pieces_that_are_let_go_are_empty(tmp_path):
    write_samples(tmp_path / "run", driven(N), "mcap")
    pieces = [item for item in sample_pieces(tmp_path / "run", Config()) if isinstance(item, Piece)]
    admission = pieces[0].admission
    assert len(pieces[0].samples()) > 0
    admission.let_go()
    assert [len(piece.samples()) for piece in pieces] == [0] * len(pieces)


SLOW = """
import sys, time
from friction_estimator.bag import read, samples
from friction_estimator.core.online.run import Run
from friction_estimator.cli.main import main
read.GATHERED = samples.CHUNK = 1000
push = Run.push
def slow(self, piece):
    push(self, piece)
    print("learned", flush=True)
    time.sleep(0.05)
Run.push = slow
sys.exit(main(["replay", sys.argv[1], "--law", "lms"]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_ends_it_in_the_middle(tmp_path, number, code):
    write_samples(tmp_path / "run", driven(60_000), "mcap")
    environment = {**os.environ, "PYTHONPATH": str(Path(friction_estimator.__file__).parents[1])}
    command = [sys.executable, "-c", SLOW, str(tmp_path / "run")]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        for _ in range(5):
            assert child.stdout.readline() == "learned\n"
        child.send_signal(number)
        rest, text = child.communicate(timeout=60)
    assert child.returncode == code
    assert rest.count("learned") < 50  # of 120: it did not go on to the end
    assert text.count("\n") <= 1
    assert "Traceback" not in text


FORMING = """
import sys, time
from friction_estimator.bag import read, samples
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.cli.main import main
read.GATHERED = samples.CHUNK = 1000
def formed(self):
    for _ in range(500):
        print("formed", flush=True)
        time.sleep(0.02)
        yield
RecordFigures.formed = formed
known = read.Reading.outline
def outline(self):
    time.sleep(2.0)  # the first contact is met
    return known(self)
read.Reading.outline = outline
sys.exit(main(["replay", sys.argv[1], "--law", "lms"]))
"""


def test_an_interrupt_ends_the_figures(tmp_path):
    write_samples(tmp_path / "run", driven(20_000), "mcap")
    environment = {**os.environ, "PYTHONPATH": str(Path(friction_estimator.__file__).parents[1])}
    command = [sys.executable, "-c", FORMING, str(tmp_path / "run")]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "formed\n"
        child.send_signal(signal.SIGINT)
        rest, text = child.communicate(timeout=60)
    assert child.returncode == 130
    assert rest.count("formed") < 100
    assert text.count("\n") <= 1
    assert "Traceback" not in text


# The thread


def counting(made, n, error=None):
    for k in range(n):
        made.append(k)
        yield k
    if error is not None:
        raise error


def test_an_error_comes_behind_the_items_before_it():
    with ahead(counting([], 4, KeyError("late"))) as items:
        assert [next(items) for _ in range(4)] == [0, 1, 2, 3]
        with pytest.raises(KeyError, match="late"):
            next(items)
    assert not reading_threads()


def test_a_block_that_fails_ends_the_thread_which_closes_what_it_reads():
    closed = []

    def numbers():
        try:
            yield from range(10**9)
        finally:
            closed.append(threading.current_thread().name)

    def until_seven():
        with ahead(numbers()) as items:
            for number in items:
                if number == 7:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        until_seven()
    assert closed == ["reading"]
    assert not reading_threads()


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_all_of_a_recording_is_read_in_the_thread(tmp_path, storage):
    """SQLite's connections belong to the thread that opened them."""
    write_samples(tmp_path / "run", driven(5000), storage)
    with ahead(sample_pieces(tmp_path / "run", Config())) as items:
        (_, *pieces, last) = items
    assert isinstance(last, Read)
    expected = to_samples(read_recording(tmp_path / "run"), Config()).samples
    for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart"):
        of_pieces = np.concatenate([getattr(piece.samples(), name) for piece in pieces])
        assert getattr(last.admitted.samples, name).tobytes() == getattr(expected, name).tobytes()
        assert of_pieces.tobytes() == getattr(expected, name).tobytes()


# What is left at the end


@pytest.mark.parametrize("count", [306, 307, 308, 614])
def test_a_last_batch_that_is_full_is_paired(tmp_path, count):
    """The last message of all fills the batch of its topic, and nothing follows."""
    stamps = START + 1_000_000 * np.arange(count)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for name, first in (("velocity", 1), ("friction", 0)):
            topic, kind = TOPICS[name]
            connection = writer.add_connection(topic, kind, typestore=typestore())
            rows = sample_template(kind, (name,)).rows(stamps, np.cos(0.1 * np.arange(count)))
            for time_ns, row in list(zip(stamps.tolist(), rows, strict=True))[first:]:
                writer.write(connection, time_ns, row.tobytes())
    _, admitted = samples.read_samples(tmp_path / "run", Config())
    assert (admitted.read, len(admitted.samples)) == (count, count - 1)
