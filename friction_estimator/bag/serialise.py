"""From arrays to serialised messages, many at a time.

rosbags serialises one message; every other one differs from it only in its stamp and its numbers, which are
written over in a copy of its bytes (see `layout` for how their places are found).
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from friction_estimator.bag.layout import Cursor
from friction_estimator.bag.messages import EXTRACTORS, Rows, Want
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.sample import NS_PER_S, Floats, Ints

JOINT_STATE = "sensor_msgs/msg/JointState"
MULTI_ARRAY = "std_msgs/msg/Float64MultiArray"


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Template:
    """The serialised form of every message on one topic, but for stamp and numbers.

    Attributes
    ----------
    message_type : its type.
    raw : a message with zero stamp and zero numbers.
    stamp_at : place of the header stamp; None without header.
    values_at : place of each float64 that varies.
    """

    message_type: str
    raw: bytes
    stamp_at: int | None
    values_at: tuple[int, ...]

    def rows(self, stamp_ns: Ints, *values: Floats) -> Rows:
        """Return one message a row, (n, length) uint8, from stamps (ns) and one (n,) array a varying number."""
        rows = np.tile(np.frombuffer(self.raw, np.uint8), (stamp_ns.size, 1))
        if self.stamp_at is not None:
            seconds, nanoseconds = np.divmod(stamp_ns, NS_PER_S)
            _put(rows, self.stamp_at, seconds.astype("<i4"))
            _put(rows, self.stamp_at + 4, nanoseconds.astype("<u4"))
        for place, value in zip(self.values_at, values, strict=True):
            _put(rows, place, value.astype("<f8"))
        return rows


def _put(rows: Rows, place: int, numbers: np.ndarray[Any, Any]) -> None:
    """Write one number a row at `place`."""
    size = numbers.dtype.itemsize
    rows[:, place : place + size] = np.ascontiguousarray(numbers).view(np.uint8).reshape(-1, size)


def sample_template(
    message_type: str,
    quantities: tuple[str, ...],
    *,
    frame_id: str = "",
    joint: str = "",
    axis: str = "x",
    motion: str = LINEAR,
) -> Template:
    """Return the template of a type in `EXTRACTORS` that carries `quantities` (see `messages.INPUTS`).

    Only a JointState carries several; its effort is called friction here. Of a rotary `motion`, a twist carries an
    angular velocity and a wrench a torque. Raises ConfigError for other types.
    """
    extractor = EXTRACTORS[message_type]
    if message_type == JOINT_STATE:
        message = _joint_state(quantities, frame_id, joint)
    else:
        message = _zeros(message_type, frame_id)
    raw = _serialised(message_type, message)
    layouts = [extractor.locate(Cursor(raw), Want(quantity, axis, joint, motion)) for quantity in quantities]
    places = tuple(layout.value_at for layout in layouts if layout.value_at is not None)
    return Template(message_type, raw, layouts[0].stamp_at, places)


def array_template(label: str, size: int) -> Template:
    """Return the template of a Float64MultiArray of one dimension, with its label."""
    types = typestore().types
    dimension = types["std_msgs/msg/MultiArrayDimension"](label, size, size)
    layout = types["std_msgs/msg/MultiArrayLayout"]([dimension], 0)
    raw = _serialised(MULTI_ARRAY, types[MULTI_ARRAY](layout, np.zeros(size)))
    return Template(MULTI_ARRAY, raw, None, tuple(range(len(raw) - 8 * size, len(raw), 8)))


def _serialised(message_type: str, message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, message_type))


def _header(frame_id: str) -> Any:
    types = typestore().types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), frame_id)


def _zeros(message_type: str, frame_id: str) -> Any:
    """Return a message of numbers only, all zero, behind its header if it has one."""
    types = typestore().types
    kind = message_type.removesuffix("Stamped")
    if kind.endswith(("Twist", "Wrench")):
        vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        pair = types[kind](vector, vector)
        return pair if kind == message_type else types[message_type](_header(frame_id), pair)
    if EXTRACTORS[message_type].stamped:
        return types[message_type](_header(frame_id), 0.0, 0.0)
    return types[message_type](0.0)


def _joint_state(quantities: tuple[str, ...], frame_id: str, joint: str) -> Any:
    arrays = (np.zeros(int(name in quantities)) for name in ("position", "velocity", "friction"))
    return typestore().types[JOINT_STATE](_header(frame_id), [joint], *arrays)
