"""Fixed-layout readers and writers agree with the installed serialiser on every message they accept."""

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import TwistStamped, WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from std_msgs.msg import Float64

from friction_estimator.ros.wire import (
    JointReader,
    LayoutError,
    StampedReader,
    WrenchWriter,
    frame_id,
    joint_index,
    read_double,
    serialised_frame,
)

pytestmark = pytest.mark.ros
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
seconds = st.integers(-(2**31), 2**31 - 1)
nanoseconds = st.integers(0, 999_999_999)
doubles = st.floats(allow_nan=False)


def stamped(kind, frame, sec, nanosec):
    message = kind()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


@settings(deadline=None)
@given(frames, seconds, nanoseconds, st.lists(doubles, min_size=3, max_size=3))
def test_one_reader_reads_any_sequence_of_frames(frame, sec, nanosec, values):
    reader = StampedReader(6, 1)
    for text in (frame, "", frame, frame + "x"):
        message = stamped(TwistStamped, text, sec, nanosec)
        message.twist.linear.x, message.twist.linear.y, message.twist.linear.z = values
        assert reader.read(serialize_message(message)) == (sec * 10**9 + nanosec, values[1])
        assert frame_id(reader.frame) == text


@settings(deadline=None)
@given(frames, seconds, nanoseconds, doubles, st.integers(0, 2))
def test_written_wrench_is_what_the_serialiser_reads(frame, sec, nanosec, value, axis):
    raw = WrenchWriter(axis).write(sec * 10**9 + nanosec, serialised_frame(frame), value)
    message = deserialize_message(raw, WrenchStamped)
    expected = stamped(WrenchStamped, frame, sec, nanosec)
    setattr(expected.wrench.force, "xyz"[axis], value)
    assert message == expected


def test_pressure_and_temperature():
    for kind, field in ((FluidPressure, "fluid_pressure"), (Temperature, "temperature")):
        message = stamped(kind, "oil", 3, 4)
        setattr(message, field, 42.5)
        message.variance = 7.0
        assert StampedReader(2, 0).read(serialize_message(message)) == (3_000_000_004, 42.5)


def test_bare_double():
    assert read_double(serialize_message(Float64(data=-2.5))) == -2.5


names = st.lists(st.text("abc", min_size=1, max_size=5), max_size=4, unique=True)


@settings(deadline=None)
@given(names, st.lists(st.booleans(), min_size=3, max_size=3), st.data())
def test_joint_states_of_any_layout(joints, given_arrays, data):
    wanted = data.draw(st.sampled_from(joints)) if joints else "none"
    reader = JointReader(wanted)
    for shift in (0.0, 100.0):
        message = stamped(JointState, "", 1, 2)
        message.name = joints
        arrays = [
            [shift + 10.0 * row + i for i in range(len(joints))] if here else []
            for row, here in enumerate(given_arrays)
        ]
        message.position, message.velocity, message.effort = arrays
        stamp_ns, *values = reader.read(serialize_message(message))
        assert stamp_ns == 1_000_000_002
        if not joints:
            assert reader.index is None
            continue
        place = joints.index(wanted)
        for holds, value, array in zip(reader.holds, values, arrays, strict=True):
            assert holds == bool(array)
            assert not array or value == array[place]


def test_joint_is_found_by_name_or_by_being_the_only_one():
    assert joint_index("b", ["a", "b"], 2) == 1
    assert joint_index("c", ["a", "b"], 2) is None
    assert joint_index("", ["a"], 1) == 0
    assert joint_index("", ["a", "b"], 2) is None
    assert joint_index("", [], 1) == 0


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_other_bytes_are_refused(raw):
    for reader in (StampedReader(6, 0), JointReader("a")):
        try:
            reader.read(raw)
        except LayoutError:
            continue
        assert raw[:2] == b"\0\1"


def test_cut_messages_are_refused():
    message = stamped(TwistStamped, "shaft", 1, 2)
    raw = serialize_message(message)
    reader = StampedReader(6, 0)
    reader.read(raw)
    for length in range(len(raw)):
        with pytest.raises(LayoutError):
            reader.read(raw[:length])
