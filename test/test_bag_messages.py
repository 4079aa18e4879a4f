"""Extraction by layout agrees with a full deserialisation, for every type, byte order and shape of message."""

import contextlib
import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from friction_estimator.bag.joint_arrays import CHOOSE_JOINT
from friction_estimator.bag.layout import SLACK
from friction_estimator.bag.messages import (
    AXES,
    EXTRACTORS,
    INPUTS,
    Decoder,
    LayoutError,
    NoValueError,
    Want,
)
from friction_estimator.bag.placed import Placed
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import NS_PER_S

ROS1, CDR_LITTLE, CDR_BIG = "ros1", "little", "big"

numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
joint_names = st.sampled_from(["a", "bb", "elbow", "Ψ"])


@functools.cache
def store(ros1=False):
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def build(kind, values, stamp=(0, 0), frame="", names=(), ros1=False):
    """Return a typed message: `values` is a list of float64, or three of them for a JointState."""
    types = store(ros1).types
    time = types["builtin_interfaces/msg/Time"](*stamp)
    header = types["std_msgs/msg/Header"](*([7] if ros1 else []), time, frame)
    vector = types["geometry_msgs/msg/Vector3"]

    def pair(name):
        return types[name](vector(*values[:3]), vector(*values[3:6]))

    if kind == "sensor_msgs/msg/JointState":
        return types[kind](header, list(names), *(np.array(v, np.float64) for v in values))
    if kind.endswith(("Twist", "Wrench")):
        return pair(kind)
    if kind.endswith(("TwistStamped", "WrenchStamped")):
        return types[kind](header, pair(kind.removesuffix("Stamped")))
    if kind == "std_msgs/msg/Float64":
        return types[kind](values[0])
    return types[kind](header, values[0], values[1])


def serialise(message, kind, form):
    if form == ROS1:
        return bytes(store(ros1=True).serialize_ros1(message, kind))
    return bytes(store().serialize_cdr(message, kind, little_endian=form == CDR_LITTLE))


def expected(kind, raw, form, want):
    """Read one quantity through rosbags: (stamp or None, value or None where it is absent)."""
    types = store(ros1=form == ROS1)
    message = (types.deserialize_ros1 if form == ROS1 else types.deserialize_cdr)(raw, kind)
    header = getattr(message, "header", None)
    stamp = None if header is None else header.stamp.sec * NS_PER_S + header.stamp.nanosec
    name = kind.rsplit("/", 1)[1]
    if name.startswith("Twist"):
        return stamp, getattr((message.twist if header else message).linear, want.axis)
    if name.startswith("Wrench"):
        return stamp, getattr((message.wrench if header else message).force, want.axis)
    if name == "FluidPressure":
        return stamp, message.fluid_pressure
    if name == "Temperature":
        return stamp, message.temperature
    if name == "Float64":
        return stamp, message.data
    array = {"friction": message.effort}.get(want.quantity, getattr(message, want.quantity, None))
    index = message.name.index(want.joint) if want.joint in message.name else -1
    if not want.joint and len(message.name) == 1:
        index = 0
    return stamp, array[index] if 0 <= index < len(array) else None


@st.composite
def message_of(draw, kind, form):
    stamp = (draw(st.integers(0, 2**31 - 1)), draw(st.integers(0, NS_PER_S - 1)))
    frame = draw(frames)
    if kind == "sensor_msgs/msg/JointState":
        names = draw(st.lists(joint_names, max_size=3, unique=True))
        values = [draw(st.lists(numbers, max_size=3)) for _ in range(3)]
        return serialise(build(kind, values, stamp, frame, names, form == ROS1), kind, form)
    values = draw(st.lists(numbers, min_size=6, max_size=6))
    return serialise(build(kind, values, stamp, frame, ros1=form == ROS1), kind, form)


@pytest.mark.parametrize("form", [CDR_LITTLE, CDR_BIG, ROS1])
@pytest.mark.parametrize("kind", list(EXTRACTORS))
@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_every_message_reads_as_rosbags_reads_it(kind, form, data):
    raws = data.draw(st.lists(message_of(kind, form), min_size=1, max_size=14))
    quantity = data.draw(st.sampled_from(sorted(EXTRACTORS[kind].feeds)))
    joint = data.draw(st.sampled_from(["", "a", "elbow"]))
    want = Want(quantity, data.draw(st.sampled_from(AXES)), joint)
    truth = [expected(kind, raw, form, want) for raw in raws]

    single = Decoder(EXTRACTORS[kind], want, ros1=form == ROS1)
    for raw, (stamp, value) in zip(raws, truth, strict=True):
        if value is None:
            with pytest.raises(NoValueError):
                single.one(raw)
        else:
            got_stamp, got = single.one(raw)
            assert got_stamp == stamp
            np.testing.assert_array_equal(got, value)

    together = Decoder(EXTRACTORS[kind], want, ros1=form == ROS1)
    decoded = together.many(raws)
    present = np.array([value is not None for _, value in truth])
    np.testing.assert_array_equal(decoded.present, present)
    np.testing.assert_array_equal(decoded.value, np.array([np.nan if value is None else value for _, value in truth]))
    if EXTRACTORS[kind].stamped:
        assert decoded.stamp_ns is not None
        np.testing.assert_array_equal(decoded.stamp_ns[present], [s for s, v in truth if v is not None])
    else:
        assert decoded.stamp_ns is None
    assert together.absences == single.absences
    assert together.absences.total() == int(np.count_nonzero(~present))


@pytest.mark.parametrize("form", [CDR_LITTLE, CDR_BIG, ROS1])
@pytest.mark.parametrize("kind", list(EXTRACTORS))
@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_a_damaged_message_is_refused_and_never_crashes(kind, form, data):
    raw = bytearray(data.draw(message_of(kind, form)))
    if data.draw(st.booleans()):
        del raw[data.draw(st.integers(0, len(raw) - 1)) :]
    else:
        raw[data.draw(st.integers(0, len(raw) - 1))] ^= data.draw(st.integers(1, 255))
    quantity = sorted(EXTRACTORS[kind].feeds)[0]
    decoder = Decoder(EXTRACTORS[kind], Want(quantity), ros1=form == ROS1)
    with contextlib.suppress(LayoutError):
        decoder.many([bytes(raw)])


def in_a_chunk(raws, rng):
    """Return messages of one length at random places, in order, among other bytes."""
    length, pieces, starts, at = len(raws[0]), [], [], 0
    for raw in raws:
        gap = rng.integers(0, 255, int(rng.integers(0, 40)), np.uint8).tobytes()
        starts.append(at + len(gap))
        pieces += [gap, raw]
        at += len(gap) + length
    return Placed(np.frombuffer(b"".join(pieces), np.uint8), np.array(starts, np.int64), length)


@pytest.mark.parametrize("form", [CDR_LITTLE, CDR_BIG, ROS1])
@pytest.mark.parametrize("kind", list(EXTRACTORS))
@settings(max_examples=25, deadline=None, derandomize=True)
@given(data=st.data())
def test_numbers_taken_in_their_chunk_are_those_of_rows(kind, form, data):
    """One byte of one message may be another: of a string, a length, the encapsulation or a number."""
    rng = np.random.default_rng(data.draw(st.integers(0, 999)))
    first = data.draw(message_of(kind, form))
    raws = [bytearray(first) for _ in range(data.draw(st.integers(1, 9)))]
    for raw in raws[1:]:
        raw[-8:] = rng.bytes(8)
    if data.draw(st.booleans()):
        raws[-1][data.draw(st.integers(0, len(first) - 1))] ^= data.draw(st.integers(1, 255))
    want = Want(sorted(EXTRACTORS[kind].feeds)[0], "x", data.draw(st.sampled_from(["", "a"])))
    messages = in_a_chunk([bytes(raw) for raw in raws], rng)
    found = []
    for given_as in (messages, messages.rows(), [bytes(raw) for raw in raws]):
        decoder = Decoder(EXTRACTORS[kind], want, ros1=form == ROS1)
        try:
            decoded = decoder.many(given_as)
        except LayoutError as error:
            found.append(str(error))
            continue
        stamps = decoded.stamp_ns if decoded.stamp_ns is None else decoded.stamp_ns[decoded.present].tolist()
        arrays = decoded.value.tobytes(), decoded.value.dtype, decoded.present.tolist()
        found.append((stamps, *arrays, decoder.absences, decoder.joints, decoder.frame_id))
    assert found[0] == found[1] == found[2]


class Walks:
    """An extractor that counts how many messages it walks."""

    def __init__(self, extractor):
        self.extractor, self.stamped, self.count = extractor, extractor.stamped, 0

    def locate(self, cursor, want):
        self.count += 1
        return self.extractor.locate(cursor, want)


@pytest.mark.parametrize("form", [CDR_LITTLE, CDR_BIG, ROS1])
@pytest.mark.parametrize("kind", [name for name, entry in EXTRACTORS.items() if entry.stamped])
def test_frames_that_change_with_every_message_cost_neither_a_sample_nor_a_walk(kind, form):
    """One walk for each of its three lengths, whatever stands in it, and one of the first message for its own."""
    rng = np.random.default_rng(3)
    raws = []
    for k, row in enumerate(rng.normal(size=(200, 6))):
        body = [row[:1], row[1:2], row[2:3]] if kind.endswith("JointState") else row.tolist()
        raws.append(serialise(build(kind, body, (k + 1, k), f"f{200 - k}", ["a"], form == ROS1), kind, form))
    want = Want(sorted(EXTRACTORS[kind].feeds)[0])
    walks = Walks(EXTRACTORS[kind])
    decoder = Decoder(walks, want, ros1=form == ROS1)
    decoded = decoder.many(raws)
    assert walks.count <= 4
    assert decoder.frame_id == "f200"
    assert decoded.present.all()
    assert decoded.stamp_ns is not None
    np.testing.assert_array_equal(decoded.stamp_ns, [(k + 1) * NS_PER_S + k for k in range(200)])
    np.testing.assert_array_equal(decoded.value, [expected(kind, raw, form, want)[1] for raw in raws])


@pytest.mark.parametrize("form", [CDR_LITTLE, CDR_BIG, ROS1])
@pytest.mark.parametrize("kind", list(EXTRACTORS))
@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_what_a_writer_leaves_behind_the_last_member_changes_nothing(kind, form, data):
    """Fast CDR overestimates the size of a JointState with empty arrays: garbage follows."""
    raw = data.draw(message_of(kind, form))
    want = Want(sorted(EXTRACTORS[kind].feeds)[0])
    clean, padded = (Decoder(EXTRACTORS[kind], want, ros1=form == ROS1) for _ in range(2))
    truth = clean.many([raw])
    got = padded.many([raw + data.draw(st.binary(min_size=1, max_size=SLACK - 1))])
    np.testing.assert_array_equal(got.value, truth.value)
    np.testing.assert_array_equal(got.present, truth.present)
    with pytest.raises(LayoutError):
        padded.many([raw + bytes(SLACK)])


@pytest.mark.parametrize(
    ("names", "values", "want", "reason"),
    [
        ([], [[], [], []], Want("friction"), "joint names are empty and effort is empty"),
        ([], [[], [1.0], []], Want("velocity"), "joint names are empty"),
        (["a"], [[], [1.0], []], Want("friction"), "effort is empty"),
        (["a", "b"], [[], [1.0, 2.0], []], Want("velocity"), f"several joints (a, b): {CHOOSE_JOINT}"),
        (["a", "b"], [[], [1.0, 2.0], []], Want("velocity", joint="c"), f"no joint 'c' among a, b: {CHOOSE_JOINT}"),
        (["a", "b"], [[], [1.0], []], Want("velocity", joint="b"), "velocity has 1 values for 2 joints"),
    ],
)
def test_a_joint_state_without_the_value_says_why(names, values, want, reason):
    kind = "sensor_msgs/msg/JointState"
    raw = serialise(build(kind, values, (1, 0), "", names), kind, CDR_LITTLE)
    decoder = Decoder(EXTRACTORS[kind], want)
    with pytest.raises(NoValueError) as caught:
        decoder.one(raw)
    assert str(caught.value) == reason
    assert decoder.absences == {reason: 1}


def test_another_serialisation_is_refused():
    with pytest.raises(LayoutError, match="not plain CDR"):
        Decoder(EXTRACTORS["std_msgs/msg/Float64"], Want("velocity")).one(b"\0\7\0\0" + bytes(8))


def test_the_table_names_known_inputs_only():
    for name, entry in EXTRACTORS.items():
        assert entry.feeds <= set(INPUTS), name
        assert entry.typical_of <= entry.feeds, name
    with pytest.raises(ConfigError, match="unknown message type 'std_msgs/msg/String'"):
        EXTRACTORS["std_msgs/msg/String"]
