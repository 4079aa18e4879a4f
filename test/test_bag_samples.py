"""Samples that are admitted while a recording is read are those of the recording read whole, to the bit."""

import os
import struct
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from own_peak import PEAK
from rosbags.rosbag2 import StoragePlugin, Writer

from friction_estimator.bag import read, samples, source
from friction_estimator.bag.merge import Merge, OutOfOrderError, Part, merged
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.recording import Outline, Recording
from friction_estimator.bag.samples import read_samples, to_samples
from friction_estimator.bag.serialise import sample_template, typestore
from friction_estimator.bag.write import TOPICS, write_samples
from friction_estimator.core import growing
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.sample import NS_PER_S, Samples, in_sequence
from friction_estimator.core.settings.config import Config

pytestmark = pytest.mark.xdist_group("bag_samples")

START = 1_700_000_000 * NS_PER_S


def driven(n, **channels):
    k = np.arange(n)
    velocity = 0.1 * np.sin(0.01 * k)
    return Samples(START + 1_000_000 * k, velocity, np.tanh(50.0 * velocity), k == 0, **channels)


def assert_alike(path, config=None, kind=Outline):
    config = config or Config()
    whole = read_recording(path, config.input)
    expected = to_samples(whole, config)
    outline, found = read_samples(path, config)
    assert isinstance(outline, kind)
    for field in fields(Samples):
        one, other = (getattr(each.samples, field.name) for each in (expected, found))
        assert (one is None) == (other is None), field.name
        assert one is None or (one.dtype == other.dtype and one.tobytes() == other.tobytes()), field.name
    for name in ("read", "rejected", "gaps", "jumps", "wraps"):
        assert getattr(found, name) == getattr(expected, name)
    assert (outline.notes, outline.motion, outline.topics) == (whole.notes, whole.motion, whole.topics)
    assert {name: len(stream) for name, stream in outline.streams.items()} == {
        name: len(stream) for name, stream in whole.streams.items()
    }
    again = outline.whole()
    assert {name: stream.value.tobytes() for name, stream in again.streams.items()} == {
        name: stream.value.tobytes() for name, stream in whole.streams.items()
    }


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("n", [1, 2, 8191, 30_011])
def test_blocks_that_do_not_divide_the_length_change_no_bit(tmp_path, storage, n, monkeypatch):
    monkeypatch.setattr(growing, "SMALLEST", 11)
    monkeypatch.setattr(growing, "LARGEST_BYTES", 8101)
    monkeypatch.setattr(samples, "CHUNK", 977)
    monkeypatch.setattr(read, "GATHERED", 1009)
    monkeypatch.setattr(source, "BATCH", 211)
    rng = np.random.default_rng(n)
    pressure = np.where(rng.random(n) < 0.02, 2e5 + rng.random(n), np.nan)
    pressure[0] = 2e5
    position = np.cumsum(1e-4 * np.sin(0.01 * np.arange(n))) % 0.003  # an encoder that wraps
    write_samples(tmp_path / "run", driven(n, pressure_Pa=pressure, position_m=position), storage)
    assert_alike(tmp_path / "run")
    loaded = Config.from_mapping({"load.terms": ["inertia"], "input.velocity_from": "position"})
    if n > 2:
        assert_alike(tmp_path / "run", loaded)


def test_what_is_known_of_an_acceleration_is_that_of_the_intake(tmp_path):
    """Noise and doubt of it too: what they say is learned from has to be the same live and in a recording."""
    t = np.arange(2000) / 500.0
    velocity = np.clip(30.0 * (np.abs(t % 1.0 - 0.5) - 0.25), -0.5, 0.5) + 1e-3 * np.sin(1e4 * t)
    stamp = 10**18 + np.round(t * 1e9).astype(np.int64)
    write_samples(tmp_path / "run", Samples(stamp, velocity, np.sign(velocity), np.arange(t.size) == 0))
    config = Config.from_mapping({"load.terms": ["inertia"]})
    samples = read_samples(tmp_path / "run", config)[1].samples
    intake = Intake(config, capacity=t.size + 1)
    first = intake.push(
        np.tile([VELOCITY, FRICTION], t.size),
        np.repeat(stamp, 2),
        np.column_stack([velocity, np.sign(velocity)]).ravel(),
    )
    whole = in_sequence([first, intake.drain()])
    assert whole.acceleration_doubt.any()
    for name in ("acceleration_m_s2", "acceleration_variance", "acceleration_doubt"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(whole, name), err_msg=name)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(data=st.data())
def test_messages_in_any_order_are_handed_on_in_recorded_order(tmp_path_factory, data):
    """Of random times, with many equal ones; several chunks, whose times overlap."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(read, "GATHERED", data.draw(st.sampled_from([1, 50, 10**9])))
        patch.setattr(source, "BATCH", data.draw(st.sampled_from([7, 8192])))
        in_any_order(tmp_path_factory, data)


def in_any_order(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bag") / "run"
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    n, reach = data.draw(st.integers(2, 400)), data.draw(st.sampled_from([3, 40, 4000]))
    padding = data.draw(st.sampled_from([0, 20_000]))  # the last makes several chunks of a megabyte
    storage = data.draw(st.sampled_from([StoragePlugin.MCAP, StoragePlugin.SQLITE3]))
    stamps = START + np.arange(n)  # each is met by its partner, whatever the order
    with Writer(path, version=9, storage_plugin=storage) as writer:
        other = writer.add_connection("/words", "std_msgs/msg/String", typestore=typestore())
        for name in ("velocity", "friction"):
            topic, kind = TOPICS[name]
            connection = writer.add_connection(topic, kind, typestore=typestore())
            rows = sample_template(kind, (name,)).rows(stamps, rng.standard_normal(n))
            times = START + (stamps - START + rng.integers(0, reach, n)) // 2
            for time, row in zip(times.tolist(), rows, strict=True):
                writer.write(connection, time, row.tobytes())
                if padding:
                    writer.write(other, time, bytes(padding))
    assert_alike(path, Config.from_mapping({"sync.queue": 1000}))


def test_a_chunk_that_holds_earlier_messages_than_it_says_is_read_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(read, "GATHERED", 1)
    write_samples(tmp_path / "run.mcap", driven(30_000))
    content = bytearray((tmp_path / "run.mcap").read_bytes())
    (at,) = struct.unpack_from("<Q", content, len(content) - 28)  # the summary
    late = 0
    while content[at] != 0x02:  # the footer
        code, length = struct.unpack_from("<BQ", content, at)
        if code == 0x08:  # ChunkIndex: time of its first message
            struct.pack_into("<Q", content, at + 9, START + 10**15)
            late += 1
        at += 9 + length
    assert late > 1
    (tmp_path / "run.mcap").write_bytes(content)
    assert_alike(tmp_path / "run.mcap", kind=Recording)


def test_an_input_that_turns_out_to_hold_nothing_is_left_out_as_ever(tmp_path):
    """The JointState has positions and efforts, its velocities are empty: they are made of the positions."""
    n = 3000
    k = np.arange(n)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=typestore())
        template = sample_template("sensor_msgs/msg/JointState", ("position", "friction"), joint="a")
        rows = template.rows(START + 1_000_000 * k, 0.1 * np.sin(0.01 * k), np.cos(0.01 * k))
        for time, row in zip((START + 1_000_000 * k).tolist(), rows, strict=True):
            writer.write(connection, time, row.tobytes())
    assert_alike(tmp_path / "run", kind=(Outline, Recording))


def test_what_is_handed_on_is_not_taken_back():
    def part(*times):
        return Part(np.array(times), np.array(times), np.array(times, float))

    merge = Merge(["velocity", "friction"])
    merge.add("velocity", part(5, 3, 9))
    assert merge.before(6).value.tolist() == [3.0, 5.0]
    merge.add("friction", part(6, 9))
    assert merge.before(10).value.tolist() == merged({"velocity": part(9), "friction": part(6, 9)}).value.tolist()
    with pytest.raises(OutOfOrderError):
        merge.add("friction", part(12, 9))


MEASURE = """
import sys
from friction_estimator.cli.main import main

for bag in sys.argv[-2:]:
    assert main([*sys.argv[1:-2], bag]) == 0
    print(peak())
"""

SHORT, LONG = 30_000, 200_000
BLOCKS = 2e7
"""Samples, and bytes that blocks take which grow no more from some 300,000 samples on: at 1e7 samples the verbs take 34
to 63 bytes a sample (benchmarks/README.md), and messages would take hundreds."""


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """Return a short recording and a long one of the same drive."""
    folder = tmp_path_factory.mktemp("lengths")
    write_samples(folder / "short", driven(SHORT))
    write_samples(folder / "long", driven(LONG))
    return str(folder / "short"), str(folder / "long")


# Bytes a sample: samples are 25, what was predicted is 8.
@pytest.mark.parametrize(
    ("words", "most"),
    [
        (["replay", "--law", "lms"], 70),
        (["replay", "--law", "lms", "--out", "OUT"], 130),
        (["identify", "--fit-only"], 70),
        (["identify", "--law", "lms"], 70),
    ],
)
def test_what_a_verb_holds_of_a_long_recording(lengths, tmp_path, words, most):
    words = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    environment = {**os.environ, "PYTHONPATH": str(Path(samples.__file__).parents[2])}
    command = [sys.executable, "-c", PEAK + MEASURE, *words, *lengths]
    run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    short, long = (int(line) for line in run.stdout.split() if line.isdigit() and len(line) > 6)
    assert long - short < most * (LONG - SHORT) + BLOCKS
