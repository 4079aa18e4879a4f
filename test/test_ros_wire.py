"""What is written by hand is what the installed serialiser writes and reads."""

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import TwistStamped, WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from friction_estimator.bag.messages import EXTRACTORS, Decoder, NoValueError, Want
from friction_estimator.ros.wire import WrenchWriter, frame_id, frame_in, serialised_frame

pytestmark = pytest.mark.ros
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
seconds = st.integers(-(2**31), 2**31 - 1)
nanoseconds = st.integers(0, 999_999_999)


def stamped(kind, frame, sec, nanosec):
    message = kind()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


@settings(deadline=None)
@given(st.lists(frames, max_size=4), seconds, nanoseconds, st.floats(allow_nan=False), st.integers(0, 2))
def test_one_writer_writes_any_sequence_of_frames(texts, sec, nanosec, value, axis):
    writer = WrenchWriter(axis)
    for frame in [*texts, "", *texts]:
        raw = writer.write(sec * 10**9 + nanosec, serialised_frame(frame), value)
        expected = stamped(WrenchStamped, frame, sec, nanosec)
        setattr(expected.wrench.force, "xyz"[axis], value)
        assert deserialize_message(raw, WrenchStamped) == expected


@settings(deadline=None)
@given(frames)
def test_frame_is_found_in_a_serialised_message(frame):
    raw = serialize_message(stamped(TwistStamped, frame, 1, 2))
    assert frame_in(raw) == serialised_frame(frame)
    assert frame_id(frame_in(raw)) == frame


names = st.lists(st.text("abc", min_size=1, max_size=5), max_size=4, unique=True)


@settings(deadline=None)
@given(names, st.lists(st.booleans(), min_size=3, max_size=3), st.data())
def test_the_decoder_reads_what_this_serialiser_writes(joints, given_arrays, data):
    wanted = data.draw(st.sampled_from(joints)) if joints else "none"
    quantities = ("position", "velocity", "friction")
    decoders = [Decoder(EXTRACTORS["sensor_msgs/msg/JointState"], Want(q, joint=wanted)) for q in quantities]
    for shift in (0.0, 100.0):
        message = stamped(JointState, "", 1, 2)
        message.name = joints
        arrays = [
            [shift + 10.0 * row + i for i in range(len(joints))] if here else []
            for row, here in enumerate(given_arrays)
        ]
        message.position, message.velocity, message.effort = arrays
        raw = serialize_message(message)
        for decoder, array in zip(decoders, arrays, strict=True):
            if array:
                assert decoder.one(raw) == (1_000_000_002, array[joints.index(wanted)])
            else:
                with pytest.raises(NoValueError):
                    decoder.one(raw)
