"""Recordings of every form read alike; what cannot be read or is not there is said in one line."""

import os
import random
import shutil
import tracemalloc

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from friction_estimator.bag import mcap
from friction_estimator.bag.merge import recorded_order
from friction_estimator.bag.messages import EXTRACTORS, Rows
from friction_estimator.bag.placed import Placed
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.serialise import sample_template, typestore
from friction_estimator.bag.source import Source, Topic
from friction_estimator.bag.topics import assign
from friction_estimator.bag.write import TOPICS, write_samples, writing
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError
from friction_estimator.core.intake.pairing import FRICTION, PRESSURE, VELOCITY
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import InputConfig

START = 1_700_000_000 * NS_PER_S
MS = 1_000_000

TWIST, WRENCH = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/WrenchStamped"
JOINT_STATE, FLOAT = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64"


def recorded(n=100, start=START):
    rng = np.random.default_rng(3)
    return Samples(
        stamp_ns=start + MS * np.arange(n),
        velocity_m_s=rng.normal(size=n),
        friction_N=rng.normal(size=n),
        restart=np.arange(n) == 0,
    )


def assert_reads(path, truth):
    recording = read_recording(path)
    for name, value in (("velocity", truth.velocity_m_s), ("friction", truth.friction_N)):
        np.testing.assert_array_equal(recording.streams[name].value, value)
        np.testing.assert_array_equal(recording.streams[name].stamp_ns, truth.stamp_ns)
        np.testing.assert_array_equal(recording.streams[name].log_time_ns, truth.stamp_ns)


def joint_messages(path, messages, topic="/joint_states"):
    """Write JointState messages given as (names, position, velocity, effort)."""
    types = typestore().types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, JOINT_STATE, typestore=typestore())
        for k, (names, *arrays) in enumerate(messages):
            stamp = START + k * MS
            time = types["builtin_interfaces/msg/Time"](stamp // NS_PER_S, stamp % NS_PER_S)
            header = types["std_msgs/msg/Header"](time, "base")
            message = types[JOINT_STATE](header, names, *(np.array(a, float) for a in arrays))
            writer.write(connection, stamp, typestore().serialize_cdr(message, JOINT_STATE))


# Forms of a recording


def merged(folder, parts, storage, suffix):
    """Make one split recording of several whole ones."""
    folder.mkdir()
    about = None
    for part in parts:
        this = yaml.safe_load((part / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        shutil.copy(part / f"{part.name}{suffix}", folder)
        if about is None:
            about = this
        else:
            about["relative_file_paths"] += this["relative_file_paths"]
            about["message_count"] += this["message_count"]
            for old, new in zip(about["topics_with_message_count"], this["topics_with_message_count"], strict=True):
                old["message_count"] += new["message_count"]
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))


@pytest.mark.parametrize(("storage", "suffix"), [("mcap", ".mcap"), ("sqlite3", ".db3")])
def test_a_split_recording_reads_as_one(tmp_path, storage, suffix):
    truth = recorded()
    for name, part in (("one", truth[:40]), ("two", truth[40:70]), ("three", truth[70:])):
        write_samples(tmp_path / name, part, storage)
    merged(tmp_path / "all", [tmp_path / name for name in ("one", "two", "three")], storage, suffix)
    assert_reads(tmp_path / "all", truth)
    assert_reads(tmp_path / "all" / "metadata.yaml", truth)


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ],
)
def test_compressed_recordings_are_read(tmp_path, plugin, mode):
    truth = recorded()
    with compressing(tmp_path / "run", plugin, mode) as writer:
        for (topic, kind), value in zip(
            (TOPICS["velocity"], TOPICS["friction"]), (truth.velocity_m_s, truth.friction_N), strict=True
        ):
            connection = writer.add_connection(topic, kind, typestore=typestore())
            rows = sample_template(kind, (topic[1:],)).rows(truth.stamp_ns, value)
            for stamp, row in zip(truth.stamp_ns.tolist(), rows, strict=True):
                writer.write(connection, stamp, row.tobytes())
    assert_reads(tmp_path / "run", truth)


def compressing(path, plugin, mode):
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    return writer


def batches(source, way, topics):
    """Return (log time, payload) by topic, from one of a source's two ways through a file."""
    found = {name: [] for name in topics}
    ahead = -(2**63)
    for (name, times, messages), behind_ns in getattr(source, way)(topics):
        assert (times >= ahead).all()  # what was promised with the batches before
        ahead = max(ahead, behind_ns)
        rows = messages.rows() if isinstance(messages, Placed) else messages
        found[name] += zip(times.tolist(), (bytes(m) for m in rows), strict=True)
    return {name: sorted(items, key=lambda item: item[0]) for name, items in found.items()}


@settings(max_examples=15, deadline=None, derandomize=True)
@given(data=st.data())
def test_the_fast_way_through_an_mcap_file_finds_what_rosbags_finds(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bag") / "run"
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    names = data.draw(st.lists(st.sampled_from(["/a", "/b", "/c"]), min_size=1, unique=True))
    n = data.draw(st.integers(0, 200))
    large = data.draw(st.sampled_from([0, 40, 30_000]))  # the last makes several chunks of a megabyte
    constant = data.draw(st.booleans())
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [writer.add_connection(name, FLOAT, typestore=typestore()) for name in names]
        for _ in range(n):
            size = large if constant else int(rng.integers(0, large + 1))
            own = connections[int(rng.integers(len(names)))]
            writer.write(own, int(rng.integers(0, 40)), rng.bytes(size))
    wanted = names[: data.draw(st.integers(1, len(names)))]
    with Source(path) as source:
        assert batches(source, "_indexed", wanted) == batches(source, "_stepwise", wanted)


def test_an_mcap_file_without_index_is_left_to_rosbags(tmp_path):
    truth = recorded()
    write_samples(tmp_path / "run.mcap", truth)
    whole = bytearray((tmp_path / "run.mcap").read_bytes())
    footer = len(whole) - 37
    whole[footer + 9 : footer + 17] = bytes(8)  # no summary
    (tmp_path / "run.mcap").write_bytes(whole)
    assert mcap.indexed(tmp_path / "run.mcap", ["/velocity"]) is None
    assert_reads(tmp_path / "run.mcap", truth)


def test_memory_stays_small_beside_the_numbers(tmp_path):
    truth = recorded(60_000)
    write_samples(tmp_path / "run", truth)
    tracemalloc.start()
    read_recording(tmp_path / "run")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Three numbers of 8 bytes a message, twice while they are joined, and one chunk of the file.
    assert peak < 2 * len(truth) * 3 * 8 * 2 + 8e6


# What cannot be read


def damaged(whole, rng):
    kind = rng.randrange(3)
    data = bytearray(whole)
    if kind == 0:
        del data[rng.randrange(len(data)) :]
    elif kind == 1:
        start = rng.randrange(len(data))
        data[start : start + 64] = rng.randbytes(len(data[start : start + 64]))
    else:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


@pytest.mark.parametrize("name", ["run.mcap", "run.db3"])
def test_a_damaged_file_is_read_or_refused_in_one_line(tmp_path, name):
    write_samples(tmp_path / name, recorded(40))
    whole = (tmp_path / name).read_bytes()
    rng = random.Random(8)
    refused = 0
    for k in range(100):
        path = tmp_path / f"{k}{name}"
        path.write_bytes(damaged(whole, rng))
        message = f"{path}"
        try:
            read_recording(path)
        except FrictionEstimatorError as error:
            refused += 1
            message = str(error)
        assert str(path) in message
        assert "\n" not in message
        path.unlink()
    assert refused > 30


def make(path, how):
    """Lay out something that is no sound recording."""
    good = path.parent / "good"
    write_samples(good, recorded(2000))
    whole = (good / "good.mcap").read_bytes()
    if how == "truncated":
        path.write_bytes(whole[: len(whole) // 2])
    elif how == "checksum":
        data = bytearray(whole)
        place = data.index(b"\x06", 8)  # the first chunk; its checksum stands 24 bytes into it
        data[place + 33 : place + 37] = b"abcd"
        path.write_bytes(data)
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "folder":
        path.mkdir()
        (path / "notes.txt").write_text("")
    elif how == "unindexed":
        path.mkdir()
        shutil.copy(good / "good.mcap", path / "part_0.mcap")
    elif how == "half":
        shutil.copytree(good, path)
        (path / "good.mcap").unlink()
    elif how == "pipe":
        os.mkfifo(path)
    elif how == "pipe within":
        shutil.copytree(good, path)
        (storage,) = path.glob("*.mcap")
        storage.unlink()
        os.mkfifo(storage)
    elif how == "no yaml":
        shutil.copytree(good, path)
        (path / "metadata.yaml").write_bytes(b"\xff\xfe{{{")
    elif how == "text":
        path.write_text("t,v\n0,1\n")


@pytest.mark.parametrize(
    ("name", "how", "words"),
    [
        ("gone", "", "no such file or folder"),
        ("run.mcap", "truncated", "is damaged: File end magic is invalid; `mcap recover"),
        ("run.mcap", "checksum", "checksum"),
        ("run.mcap", "empty", "is empty (0 bytes)"),
        ("run.db3", "empty", "is empty (0 bytes)"),
        ("run.bag", "empty", "is empty (0 bytes)"),
        ("run.bag", "text", "is damaged"),
        ("run.db3", "text", "is damaged"),
        ("run.mcap", "pipe", "is a pipe, device or socket, and no recording"),
        ("run", "pipe within", "good.mcap is no regular file"),
        ("run", "folder", "is no recording; expected a folder with metadata.yaml"),
        ("run", "unindexed", "has no metadata.yaml; run `ros2 bag reindex"),
        ("run", "half", "good.mcap"),
        ("run", "no yaml", "is damaged"),
        ("run", "text", "is no recording"),
        ("run.csv", "text", "is a table, no recording; turn it into one with `friction_estimator import`"),
    ],
)
def test_what_is_no_sound_recording_is_refused_with_a_remedy(tmp_path, name, how, words):
    make(tmp_path / name, how)
    with pytest.raises(InputError) as caught:
        read_recording(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_message_of_another_layout_names_topic_and_type(tmp_path):
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind in (TOPICS["velocity"], TOPICS["friction"]):
            connection = writer.add_connection(topic, kind, typestore=typestore())
            writer.write(connection, START, b"\0\1\0\0" + bytes(7))
    with pytest.raises(InputError, match=r"a message on /\w+ is no geometry_msgs/\w+Stamped: .* ends early"):
        read_recording(tmp_path / "run")


# Which topic is which

V, F = Topic("/velocity", TWIST, 9), Topic("/friction", WRENCH, 9)
JOINTS = Topic("/joint_states", JOINT_STATE, 9)


def chosen(topics, named=None, mode="stamped", hollow=()):
    def probe(_, topic):
        return "it is hollow" if topic.name in hollow else ""

    return {k: t.name for k, t in assign("BAG", topics, named or {}, mode, probe=probe).topics.items()}


BOTH = {"velocity": "/velocity", "friction": "/friction"}
FROM_JOINTS = {"velocity": "/joint_states", "friction": "/joint_states", "position": "/joint_states"}


@pytest.mark.parametrize(
    ("topics", "options", "expected"),
    [
        ([V, F], {}, BOTH),
        # the last name part, before the type
        (
            [Topic("/a/velocity", TWIST, 9), Topic("/cmd", TWIST, 9), F],
            {},
            {"velocity": "/a/velocity", "friction": "/friction"},
        ),
        # the only topic of a fitting type
        ([Topic("/speed", TWIST, 9), Topic("/cell", WRENCH, 9)], {}, {"velocity": "/speed", "friction": "/cell"}),
        # a name of an unreadable type does not count
        (
            [Topic("/velocity", "nav_msgs/msg/Odometry", 9), Topic("/speed", TWIST, 9), F],
            {},
            BOTH | {"velocity": "/speed"},
        ),
        # neither does an empty topic
        ([Topic("/velocity", TWIST, 0), Topic("/speed", TWIST, 9), F], {}, BOTH | {"velocity": "/speed"}),
        # the user's word
        ([V, F, Topic("/x", TWIST, 9)], {"named": {"velocity": "/x"}}, BOTH | {"velocity": "/x"}),
        ([V, F, Topic("/x", TWIST, 9)], {"named": {"velocity": "x"}}, BOTH | {"velocity": "/x"}),
        # a Float64 is an input by name only
        ([Topic("/velocity", FLOAT, 9), Topic("/friction", FLOAT, 9), Topic("/cpu", FLOAT, 9)], {}, BOTH),
        # one JointState for both
        ([JOINTS], {}, FROM_JOINTS),
        ([JOINTS, Topic("/cmd", TWIST, 9)], {}, FROM_JOINTS),
        ([JOINTS, V, F], {"mode": "joint_state"}, FROM_JOINTS),
        ([JOINTS, V, F], {"named": {"joint_states": "/joint_states"}}, FROM_JOINTS),
        ([JOINTS, V, F], {}, BOTH | {"position": "/joint_states"}),
        # several could be meant, one of them holds the value
        (
            [Topic("/ref", JOINT_STATE, 9), Topic("/out", JOINT_STATE, 9)],
            {"hollow": ["/ref"]},
            dict.fromkeys(FROM_JOINTS, "/out"),
        ),
        # held channels
        (
            [V, F, Topic("/p", "sensor_msgs/msg/FluidPressure", 9), Topic("/oil", "sensor_msgs/msg/Temperature", 9)],
            {},
            BOTH | {"pressure": "/p", "temperature": "/oil"},
        ),
        ([V, F, Topic("/position", JOINT_STATE, 9)], {}, BOTH | {"position": "/position"}),
        # what the estimator itself wrote is no input
        (
            [V, Topic("/cell", WRENCH, 9), Topic("/friction_estimator/residual", WRENCH, 9)],
            {},
            BOTH | {"friction": "/cell"},
        ),
    ],
)
def test_topics_are_found(topics, options, expected):
    assert chosen(topics, **options) == expected


@pytest.mark.parametrize(
    ("topics", "options", "kind", "words"),
    [
        ([], {}, UnanswerableError, "BAG has no topic for velocity or friction: it has no topics at all"),
        (
            [V],
            {},
            UnanswerableError,
            "no topic for friction: it has /velocity (geometry_msgs/TwistStamped, 9 messages)",
        ),
        ([Topic("/velocity", TWIST, 0), F], {}, UnanswerableError, "(geometry_msgs/TwistStamped, 0 messages)"),
        (
            [Topic("/a/velocity", TWIST, 9), Topic("/b/velocity", TWIST, 9), F],
            {},
            InputError,
            "velocity could be /a/velocity (geometry_msgs/TwistStamped, 9 messages) or /b/velocity",
        ),
        (
            [Topic("/ref", JOINT_STATE, 9), Topic("/out", JOINT_STATE, 9)],
            {"hollow": ["/ref", "/out"]},
            UnanswerableError,
            "/out (sensor_msgs/JointState, 9 messages): it is hollow",
        ),
        (
            [V, F],
            {"named": {"velocity": "/velocty"}},
            InputError,
            "no topic /velocty (--topic velocity=/velocty); nearest: /velocity",
        ),
        (
            [V, F],
            {"named": {"velocity": "/friction"}},
            InputError,
            "cannot be read as velocity; geometry_msgs/TwistStamped",
        ),
        ([V, F], {"mode": "joint_state"}, UnanswerableError, "no JointState topic for input.mode joint_state"),
    ],
)
def test_what_is_not_found_or_not_clear_is_said(topics, options, kind, words):
    with pytest.raises(kind) as caught:
        chosen(topics, **options)
    assert words in str(caught.value)


def test_an_ambiguous_channel_is_left_out_with_a_note():
    topics = [V, F, *(Topic(f"/p{k}", "sensor_msgs/msg/FluidPressure", 9) for k in range(2))]
    found = assign("BAG", topics, {})
    assert "pressure" not in found.topics
    assert "no pressure is used: pressure could be /p0" in found.notes[0]
    with pytest.raises(InputError, match="no topic /p7"):
        assign("BAG", topics, {"pressure": "/p7"})


# JointState and Float64 sources


def test_a_joint_state_gives_velocity_effort_and_position_of_one_joint(tmp_path):
    joint_messages(tmp_path / "run", [(["a", "b"], [k, 10 + k], [2 * k, 0], [3 * k, 5]) for k in range(6)])
    recording = read_recording(tmp_path / "run", InputConfig(joint="b"))
    assert recording.streams["friction"].joint == "b"
    np.testing.assert_array_equal(recording.streams["position"].value, 10.0 + np.arange(6))
    np.testing.assert_array_equal(recording.streams["velocity"].value, np.zeros(6))
    assert any("inertia and gravity" in note for note in recording.notes)
    admitted = to_samples(recording, Config())
    assert (len(admitted.samples), admitted.rejected) == (6, {})
    with pytest.raises(InputError, match=r"several joints \(a, b\): choose one with --joint"):
        read_recording(tmp_path / "run")
    with pytest.raises(InputError, match=r"no joint 'c' among a, b: choose one with --joint"):
        read_recording(tmp_path / "run", InputConfig(joint="c"))


def test_messages_of_other_publishers_on_the_topic_are_counted_as_missing(tmp_path):
    arm, gripper = (["a"], [], [1.0], [2.0]), (["g"], [], [5.0], [6.0])
    joint_messages(tmp_path / "run", [arm, gripper, arm, gripper, gripper])
    stream = read_recording(tmp_path / "run", InputConfig(joint="a")).streams["velocity"]
    assert (len(stream), stream.missing) == (2, 3)
    with pytest.raises(InputError, match=r"several joints \(a, g\): choose one with --joint"):
        read_recording(tmp_path / "run")


def test_a_joint_state_without_efforts_says_so(tmp_path):
    joint_messages(tmp_path / "run", [(["a"], [1.0], [2.0], [])] * 3)
    with pytest.raises(UnanswerableError, match="3 messages\\) gives no friction: effort is empty"):
        read_recording(tmp_path / "run")


def test_an_unstamped_input_is_stamped_by_its_time_of_recording(tmp_path):
    times = START + MS * np.arange(5)
    with writing(tmp_path / "run") as writer:
        for name in ("velocity", "friction"):
            writer.add_stream(f"/{name}", FLOAT, times, np.arange(5.0), quantity=name)
    recording = read_recording(tmp_path / "run")
    for stream in recording.streams.values():
        assert not stream.stamped
        np.testing.assert_array_equal(stream.stamp_ns, times)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_axis_is_the_configured_one(tmp_path, axis):
    times, value = START + MS * np.arange(5), np.arange(1.0, 6.0)
    with writing(tmp_path / "run") as writer:
        for name in ("velocity", "friction"):
            writer.add_stream(*TOPICS[name], times, value, quantity=name, axis=axis)
    for other in "xyz":
        streams = read_recording(tmp_path / "run", InputConfig(axis=other)).streams
        np.testing.assert_array_equal(streams["velocity"].value, value if axis == other else np.zeros(5))


# Order and pairing


@settings(deadline=None, derandomize=True)
@given(st.lists(st.lists(st.integers(0, 9)), min_size=1, max_size=4))
def test_recorded_order_is_a_stable_merge(lists):
    order = recorded_order(*(np.array(sorted(times), np.int64) for times in lists))
    keys = [(time, own, k) for own, times in enumerate(lists) for k, time in enumerate(sorted(times))]
    assert [keys[k] for k in order] == sorted(keys)


def test_events_come_in_recorded_order_and_channels_before_the_sample_that_needs_them(tmp_path):
    times = START + MS * np.arange(3)
    with writing(tmp_path / "run") as writer:
        for name in ("friction", "velocity", "pressure"):  # the order of writing means nothing
            writer.add_stream(*TOPICS[name], times, np.arange(3.0), quantity=name)
    recording = read_recording(tmp_path / "run")
    events = recording.events()
    assert events.stream.tolist() == [PRESSURE, VELOCITY, FRICTION] * 3
    assert np.all(np.diff(events.stamp_ns) >= 0)
    np.testing.assert_array_equal(to_samples(recording, Config()).samples.pressure_Pa, np.arange(3.0))


def test_streams_that_never_meet_name_the_offset_and_the_remedy(tmp_path):
    times = START + MS * np.arange(50)
    with writing(tmp_path / "run") as writer:
        writer.add_stream(*TOPICS["velocity"], times, np.ones(50), quantity="velocity")
        writer.add_stream(*TOPICS["friction"], times + 200_000, np.ones(50), quantity="friction")
    recording = read_recording(tmp_path / "run")
    with pytest.raises(UnanswerableError, match=r"100 unmatched; stamps .* differ by about 0.0002 s, set sync.slop"):
        to_samples(recording, Config())
    config = Config.from_mapping({"sync.slop": 0.0004})
    assert len(to_samples(recording, config).samples) == 50


# Recordings that others wrote


@pytest.mark.parametrize(
    ("name", "topics", "words"),
    [
        ("servo_ros2_sqlite3", {}, "no joint_states that can be used"),
        ("servo_ros2_sqlite3", {"joint_states": "/servo/out/state"}, "joint names are empty and effort is empty"),
        ("rosbag2_split_sqlite3", {}, "AAA (std_msgs/String, 804 messages)"),
        ("rosbag2_split_mcap", {}, "AAA (std_msgs/String, 804 messages)"),
    ],
)
def test_recordings_of_others_are_refused_with_the_reason(shared_data, name, topics, words):
    with pytest.raises(UnanswerableError) as caught:
        read_recording(shared_data / "bags" / name, topics=topics)
    assert words in str(caught.value)
    with Source(shared_data / "bags" / name) as source:
        count = sum(len(part) for _, _, part in source.batches([t.name for t in source.topics]))
        assert count == source.message_count > 0


def test_every_message_type_is_read_from_a_recording(tmp_path):
    """A new row of EXTRACTORS needs no test of its own here."""
    times, value = START + MS * np.arange(4), np.arange(4.0)
    for number, (kind, entry) in enumerate(EXTRACTORS.items()):
        for name in sorted(entry.feeds):
            path = tmp_path / f"{number}{name}"
            others = {"velocity", "friction"} - {name}
            with writing(path) as writer:
                writer.add_stream("/it", kind, times, value, quantity=name)
                for other in others:
                    writer.add_stream(*TOPICS[other], times, value, quantity=other)
            stream = read_recording(path, topics={name: "/it"}).streams[name]
            np.testing.assert_array_equal(stream.value, value)
            assert (stream.message_type, stream.stamped) == (kind, entry.stamped)


def test_rows_and_bytes_are_both_handed_on(tmp_path):
    write_samples(tmp_path / "run.mcap", recorded(5))
    joint_messages(tmp_path / "joints", [([name], [0.0], [], []) for name in ("a", "of another length")])
    kinds = []
    for name, topic in (("run.mcap", "/velocity"), ("joints", "/joint_states")):
        with Source(tmp_path / name) as source:
            kinds.append({type(part) for _, _, part in source.batches([topic])})
    assert kinds == [{np.ndarray}, {list}]
    assert Rows is not None
