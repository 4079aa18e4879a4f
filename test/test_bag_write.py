"""What is written is what rosbags would write, reads back bit for bit, and is there whole or not at all."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from friction_estimator.bag.messages import EXTRACTORS
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.serialise import array_template, sample_template, typestore
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import STORAGES, TOPICS, add_results, write_samples, writing
from friction_estimator.core.errors import InputError
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config

START = 1_700_000_000 * NS_PER_S
MS = 1_000_000

numbers = st.floats(width=64)
stamps = st.integers(0, (2**31 - 1) * NS_PER_S)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)


def recorded(n=50, **channels):
    rng = np.random.default_rng(7)
    values = {"velocity_m_s": rng.normal(size=n), "friction_N": rng.normal(size=n)} | channels
    restart = np.arange(n) == 0
    return Samples(stamp_ns=START + MS * np.arange(n), restart=restart, **values)


def assert_same(got, truth):
    for name in ("stamp_ns", "velocity_m_s", "friction_N", "pressure_Pa", "temperature_degC", "position_m"):
        one, other = getattr(got, name), getattr(truth, name)
        if other is None:
            assert one is None, name
        else:
            np.testing.assert_array_equal(one, other, err_msg=name)


def read_back(path):
    return to_samples(read_recording(path), Config()).samples


@pytest.mark.parametrize("kind", list(EXTRACTORS))
@settings(max_examples=25, deadline=None, derandomize=True)
@given(data=st.data())
def test_bulk_serialisation_equals_that_of_rosbags(kind, data):
    types = typestore().types
    stamp, frame, joint = data.draw(stamps), data.draw(frames), data.draw(frames)
    quantities = data.draw(st.lists(st.sampled_from(sorted(EXTRACTORS[kind].feeds)), min_size=1, unique=True))
    if not kind.endswith("JointState"):
        quantities = quantities[:1]
    axis = data.draw(st.sampled_from("xyz"))
    values = {name: data.draw(numbers) for name in quantities}

    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](stamp // NS_PER_S, stamp % NS_PER_S), frame
    )
    value = values[quantities[0]]
    vector = types["geometry_msgs/msg/Vector3"]
    pair = vector(*(value if axis == name else 0.0 for name in "xyz")), vector(0.0, 0.0, 0.0)
    if kind.endswith("JointState"):
        arrays = (np.array([values[name]] if name in values else []) for name in ("position", "velocity", "friction"))
        message = types[kind](header, [joint], *arrays)
    elif kind.endswith(("Twist", "Wrench")):
        message = types[kind](*pair)
    elif kind.endswith(("TwistStamped", "WrenchStamped")):
        message = types[kind](header, types[kind.removesuffix("Stamped")](*pair))
    elif EXTRACTORS[kind].stamped:
        message = types[kind](header, value, 0.0)
    else:
        message = types[kind](value)

    template = sample_template(kind, tuple(quantities), frame_id=frame, joint=joint, axis=axis)
    rows = template.rows(np.array([stamp, stamp]), *(np.full(2, values[name]) for name in quantities))
    assert rows.shape[0] == 2
    for row in rows:
        assert row.tobytes() == bytes(typestore().serialize_cdr(message, kind))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(numbers, min_size=1, max_size=5), st.text("abc_", max_size=9))
def test_bulk_arrays_equal_those_of_rosbags(values, label):
    kind = "std_msgs/msg/Float64MultiArray"
    rows = array_template(label, len(values)).rows(np.zeros(1, np.int64), *(np.array([v]) for v in values))
    message = typestore().deserialize_cdr(rows[0].tobytes(), kind)
    np.testing.assert_array_equal(message.data, values)
    assert [(d.label, d.size, d.stride) for d in message.layout.dim] == [(label, len(values), len(values))]
    assert bytes(typestore().serialize_cdr(message, kind)) == rows[0].tobytes()


@pytest.mark.parametrize("storage", STORAGES)
@settings(max_examples=15, deadline=None, derandomize=True)
@given(data=st.data())
def test_samples_read_back_bit_for_bit(tmp_path_factory, storage, data):
    n = data.draw(st.integers(1, 12))
    usable = st.just(0.0) | st.floats(1e-30, 1e12) | st.floats(-1e12, -1e-30)  # what a sensor reads
    steps = data.draw(st.lists(st.integers(1, 5), min_size=n, max_size=n))

    def column(elements=usable):
        return np.array(data.draw(st.lists(elements, min_size=n, max_size=n)))

    truth = Samples(
        stamp_ns=START + MS * np.cumsum(steps),
        velocity_m_s=column(),
        friction_N=column(),
        restart=np.arange(n) == 0,
        pressure_Pa=column() if data.draw(st.booleans()) else None,
        temperature_degC=column() if data.draw(st.booleans()) else None,
        position_m=column() if data.draw(st.booleans()) else None,
    )
    path = tmp_path_factory.mktemp("bag") / "run"
    write_samples(path, truth, storage)
    assert_same(read_back(path), truth)


@pytest.mark.parametrize("name", ["run.mcap", "run.db3"])
def test_a_bare_file_is_written_where_its_name_asks_for_one(tmp_path, name):
    truth = recorded()
    write_samples(tmp_path / name, truth)
    assert [item.name for item in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).is_file()
    assert_same(read_back(tmp_path / name), truth)


def test_missing_measurements_are_written_and_counted(tmp_path):
    friction = np.ones(10)
    friction[3] = np.nan
    pressure = np.full(10, 2e5)
    pressure[:2] = np.nan
    write_samples(tmp_path / "run", recorded(10, friction_N=friction, pressure_Pa=pressure))
    recording = read_recording(tmp_path / "run")
    assert np.isnan(recording.streams["friction"].value[3])
    assert len(recording.streams["pressure"]) == 8
    admitted = to_samples(recording, Config())
    assert admitted.rejected == {"nan": 1}
    assert (admitted.read, len(admitted.samples)) == (10, 9)
    np.testing.assert_array_equal(np.isnan(admitted.samples.pressure_Pa), np.arange(9) < 2)


def test_other_ros_tools_find_types_definitions_and_stamps(tmp_path):
    write_samples(tmp_path / "run", recorded(3, temperature_degC=np.full(3, 40.0)), frame_id="shaft")
    with AnyReader([tmp_path / "run"]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == {
            name: kind for name, kind in TOPICS.values() if name in ("/velocity", "/friction", "/temperature")
        }
        for connection, log_time, raw in reader.messages():
            header = reader.deserialize(raw, connection.msgtype).header
            assert header.stamp.sec * NS_PER_S + header.stamp.nanosec == log_time
            assert header.frame_id == "shaft"


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_an_interrupted_run_leaves_the_old_recording_and_nothing_else(tmp_path, name):
    old = recorded(5)
    write_samples(tmp_path / name, old)

    def interrupted():
        with writing(tmp_path / name) as writer:
            writer.add_stream("/velocity", TOPICS["velocity"][1], np.array([START]), np.array([1.0]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [item.name for item in tmp_path.iterdir()] == [name]
    assert_same(read_back(tmp_path / name), old)
    new = recorded(7)
    write_samples(tmp_path / name, new)
    assert_same(read_back(tmp_path / name), new)


def test_a_folder_that_is_no_recording_is_never_replaced(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"thesis: a folder that is no recording stands there"):
        write_samples(tmp_path / "thesis", recorded())
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="its name says sqlite3"):
        write_samples(tmp_path / "run.db3", recorded(), "mcap")


def test_streams_are_merged_by_time_of_recording(tmp_path):
    rng = np.random.default_rng(5)
    with writing(tmp_path / "run") as writer:
        for name in ("velocity", "friction"):
            times = START + rng.integers(0, 50, 200) * MS  # unordered, with ties
            writer.add_stream(*TOPICS[name], times, rng.normal(size=200), quantity=name)
    with AnyReader([tmp_path / "run"]) as reader:
        keys = [(log_time, connection.topic) for connection, log_time, _ in reader.messages()]
    assert keys == sorted(keys, key=lambda key: (key[0], key[1] != "/velocity"))


def enriched(source_path, path, rename=None):
    """Copy a recording's inputs and add results, as replay does; return the samples."""
    admitted = to_samples(read_recording(source_path), Config())
    samples = admitted.samples
    weights = np.arange(6.0).reshape(2, 3)
    with Source(source_path) as source, writing(path) as writer:
        writer.copy(source, rename or ["/velocity", "/friction"])
        add_results(
            writer,
            samples.stamp_ns,
            samples.friction_N + 1,
            np.full(len(samples), -1.0),
            {"wavelet_weights": (samples.stamp_ns[:2], weights), "theory_taps": (samples.stamp_ns[:2], weights[:, :0])},
        )
    return samples


@pytest.mark.parametrize("storage", STORAGES)
def test_an_enriched_recording_holds_the_inputs_as_they_were_and_the_results(tmp_path, storage):
    write_samples(tmp_path / "run", recorded(), storage, frame_id="f")
    samples = enriched(tmp_path / "run", tmp_path / "rich")
    with Source(tmp_path / "run") as before, Source(tmp_path / "rich") as after:
        for topic in ("/velocity", "/friction"):
            old, new = (
                [bytes(m) for _, _, part in source.batches([topic]) for m in part] for source in (before, after)
            )
            assert old == new
        assert {topic.name for topic in after.topics} == {
            "/velocity",
            "/friction",
            "/friction_estimator/friction_predicted",
            "/friction_estimator/residual",
            "/friction_estimator/parameters/wavelet_weights",
        }
    # Its own results are no candidates for the input friction, and can be asked for.
    assert_same(read_back(tmp_path / "rich"), samples)
    results = read_recording(tmp_path / "rich", topics={"friction": "/friction_estimator/friction_predicted"})
    np.testing.assert_array_equal(results.streams["friction"].value, samples.friction_N + 1)


def test_results_of_oddly_named_topics_do_not_compete_with_them(tmp_path):
    write_samples(tmp_path / "run", recorded())
    with Source(tmp_path / "run") as source, writing(tmp_path / "odd") as writer:
        writer.copy(source, {"/velocity": "/rig/speed", "/friction": "/rig/load_cell"})
    samples = enriched(tmp_path / "odd", tmp_path / "rich", ["/rig/speed", "/rig/load_cell"])
    assert_same(read_back(tmp_path / "rich"), samples)


@functools.cache
def noetic():
    return get_typestore(Stores.ROS1_NOETIC)


def write_ros1(path, samples):
    types = noetic().types
    vector, zero = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    with Writer1(path) as writer:
        connections = {
            kind: writer.add_connection(name, kind, typestore=noetic())
            for name, kind in (TOPICS["velocity"], TOPICS["friction"])
        }
        for k, stamp in enumerate(samples.stamp_ns.tolist()):
            time = types["builtin_interfaces/msg/Time"](stamp // NS_PER_S, stamp % NS_PER_S)
            header = types["std_msgs/msg/Header"](k, time, "rig")
            for value, kind in (
                (samples.velocity_m_s[k], TOPICS["velocity"][1]),
                (samples.friction_N[k], TOPICS["friction"][1]),
            ):
                pair = types[kind.removesuffix("Stamped")](vector(value, 0.0, 0.0), zero)
                raw = noetic().serialize_ros1(types[kind](header, pair), kind)
                writer.write(connections[kind], stamp, raw)


def test_ros1_bags_are_read_and_translated_into_enriched_recordings(tmp_path):
    truth = recorded()
    write_ros1(tmp_path / "old.bag", truth)
    recording = read_recording(tmp_path / "old.bag")
    assert recording.streams["velocity"].frame_id == "rig"
    samples = enriched(tmp_path / "old.bag", tmp_path / "rich")
    assert_same(samples, truth)
    assert_same(read_back(tmp_path / "rich"), truth)
    with AnyReader([tmp_path / "rich"]) as reader:
        connection, _, raw = next(reader.messages())
        assert reader.deserialize(raw, connection.msgtype).header.frame_id == "rig"
