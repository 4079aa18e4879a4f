"""From messages to numbers in SI units: which type holds which input, and a decoder for one or for many messages.

A new message type is one line in `EXTRACTORS`.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.joint_arrays import JointArrays
from friction_estimator.bag.layout import Cursor, Layout, LayoutError, NoValueError
from friction_estimator.bag.placed import Placed
from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints

Rows = NDArray[np.uint8]

Messages = Rows | list[bytes] | Placed
"""Payloads of one topic: rows of one length, of one length in their chunk, or bytes of any lengths."""

INPUTS = ("velocity", "friction", "pressure", "temperature", "position")

AXES = ("x", "y", "z")

_MANY_LAYOUTS = 8
"""Layouts looked for in one batch before its remaining messages are read one by one."""


@dataclass(frozen=True)
class Want:
    """The quantity wanted of a message: one of `INPUTS`, along or, of a rotary drive, about `axis`, of `joint`.

    An empty joint means the only one.
    """

    quantity: str
    axis: str = "x"
    joint: str = ""
    motion: str = LINEAR


class Extractor(Protocol):
    """What is known about a message type."""

    @property
    def stamped(self) -> bool:
        """Whether it has a header; without one the time of recording serves as stamp."""

    @property
    def feeds(self) -> frozenset[str]:
        """The inputs that it can carry."""

    @property
    def typical_of(self) -> frozenset[str]:
        """The inputs for which a topic of this type is taken even when its name says nothing."""

    @property
    def along_axis(self) -> bool:
        """Whether it has three linear and three angular components."""

    def locate(self, cursor: Cursor, want: Want) -> Layout:
        """Walk a message; return where the wanted quantity stands. LayoutError where it is no such message."""
        ...


@dataclass(frozen=True)
class Doubles:
    """A message of `count` float64, behind a header where `stamped`.

    The value is the first float64, or the one of the wanted axis where `along_axis`: of the first three of a linear
    drive, of the others of a rotary one.
    """

    count: int
    stamped: bool
    feeds: frozenset[str]
    typical_of: frozenset[str] = frozenset()
    along_axis: bool = False

    def locate(self, cursor: Cursor, want: Want) -> Layout:
        """Return where the wanted quantity stands."""
        if self.stamped:
            cursor.header()
        start = cursor.doubles(self.count)
        cursor.end()
        component = AXES.index(want.axis) + (len(AXES) if want.motion == ROTARY else 0)
        return cursor.layout(start + 8 * (component if self.along_axis else 0))


@dataclass(frozen=True)
class JointStates:
    """sensor_msgs/JointState: position, velocity and effort of named joints.

    The effort is the joint's whole effort, inertia and gravity included.
    """

    stamped: bool = True
    feeds: frozenset[str] = frozenset({"velocity", "friction", "position"})
    typical_of: frozenset[str] = frozenset({"position"})
    along_axis: bool = False

    def locate(self, cursor: Cursor, want: Want) -> Layout:
        """Return where the wanted joint's quantity stands; `absence` says why it does not."""
        arrays = JointArrays.walk(cursor)
        try:
            cursor.joint = arrays.named(want.joint, want.quantity)
            return cursor.layout(arrays.place(cursor.joint, want.quantity))
        except NoValueError as error:
            return cursor.layout(None, str(error))


EXTRACTORS: Registry[Extractor] = Registry("message type")
"""Extractor by message type, as rosbags writes the names (for ROS 1 too)."""

_register: Callable[[str, Extractor], Extractor] = EXTRACTORS.register
_VELOCITY, _FRICTION = frozenset({"velocity"}), frozenset({"friction"})
_PRESSURE, _TEMPERATURE = frozenset({"pressure"}), frozenset({"temperature"})
_register("geometry_msgs/msg/TwistStamped", Doubles(6, True, _VELOCITY, _VELOCITY, along_axis=True))
_register("geometry_msgs/msg/WrenchStamped", Doubles(6, True, _FRICTION, _FRICTION, along_axis=True))
_register("sensor_msgs/msg/JointState", JointStates())
_register("sensor_msgs/msg/FluidPressure", Doubles(2, True, _PRESSURE, _PRESSURE))
_register("sensor_msgs/msg/Temperature", Doubles(2, True, _TEMPERATURE, _TEMPERATURE))
_register("geometry_msgs/msg/Twist", Doubles(6, False, _VELOCITY, along_axis=True))
_register("geometry_msgs/msg/Wrench", Doubles(6, False, _FRICTION, along_axis=True))
_register("std_msgs/msg/Float64", Doubles(1, False, frozenset(INPUTS)))


@dataclass(frozen=True)
class Decoded:
    """Numbers of a batch of messages, in their order, each (n,).

    `present` is False where a message does not hold the wanted joint; `stamp_ns` is None for unstamped types.
    """

    stamp_ns: Ints | None
    value: Floats
    present: Bools


class Decoder:
    """Read stamp and value of one quantity from serialised messages of one type.

    The places are found on one message; the next ones are read from the same places for as long as the bytes
    that fix them (encapsulation, lengths, names) stay the same, and are walked anew where they change. So every
    message is checked, constant layouts are read at the speed of numpy, and changing ones are read all the same.

    Parameters
    ----------
    extractor : entry of `EXTRACTORS`.
    want : the quantity.
    ros1 : the messages are ROS 1's.

    Attributes
    ----------
    absences : how many messages lacked the value, by reason.
    joints : those met.
    frame_id : of the first message; None before it, "" where the type has none.

    Examples
    --------
    >>> decoder = Decoder(EXTRACTORS["std_msgs/msg/Float64"], Want("velocity"))
    >>> decoder.one(b"\\0\\1\\0\\0" + struct.pack("<d", 0.25))
    (None, 0.25)
    """

    def __init__(self, extractor: Extractor, want: Want, *, ros1: bool = False) -> None:
        self.absences: Counter[str] = Counter()
        self.joints: set[str] = set()
        self.frame_id: str | None = None
        self._extractor, self._want, self._ros1 = extractor, want, ros1
        self._layout: Layout | None = None
        self._stamp, self._value = struct.Struct("<iI"), struct.Struct("<d")

    @property
    def layout(self) -> Layout | None:
        """Where the numbers stood in the last message."""
        return self._layout

    def _learn(self, raw: bytes) -> Layout:
        layout = self._extractor.locate(Cursor(raw, ros1=self._ros1), self._want)
        if self.frame_id is None:
            self.frame_id = layout.frame_id
        if layout.joint:
            self.joints.add(layout.joint)
        self._layout = layout
        self._stamp = struct.Struct(layout.order + layout.stamp_code + "I")
        self._value = struct.Struct(layout.order + "d")
        return layout

    def _layout_of(self, raw: bytes) -> Layout:
        layout = self._layout
        return layout if layout is not None and layout.fits(raw) else self._learn(raw)

    def one(self, raw: bytes) -> tuple[int | None, float]:
        """Return (header stamp in ns or None, value in SI units) of one message.

        Raises LayoutError where it is no message of the type, NoValueError where the value is not in it.
        """
        layout = self._layout_of(raw)
        stamp_ns = None
        if layout.stamp_at is not None:
            seconds, nanoseconds = self._stamp.unpack_from(raw, layout.stamp_at)
            stamp_ns = seconds * NS_PER_S + nanoseconds
        if layout.value_at is None:
            self.absences[layout.absence] += 1
            raise NoValueError(layout.absence)
        return stamp_ns, self._value.unpack_from(raw, layout.value_at)[0]

    def many(self, messages: Rows | Sequence[bytes] | Placed) -> Decoded:
        """Return the numbers of messages. Raises LayoutError."""
        if isinstance(messages, Placed):
            return self._placed(messages) or self.many(messages.rows())
        n = len(messages)
        if n and self.frame_id is None:
            self._learn(bytes(messages[0]))
        stamps, value, present = np.zeros(n, np.int64), np.full(n, np.nan), np.zeros(n, np.bool_)
        for own, rows, layout in by_layout(messages, self._layout_of):
            if layout.stamp_at is not None:
                stamps[own] = stamps_of(rows, layout)
            if layout.value_at is None:
                self.absences[layout.absence] += own.size
            else:
                value[own] = _column(rows, layout.value_at, layout.order + "d")
                present[own] = True
        return Decoded(stamps if self._extractor.stamped else None, value, present)

    def _placed(self, messages: Placed) -> Decoded | None:
        """Return the numbers of messages that all have one layout, and the value; None where they are not so."""
        layout = self._layout_of(messages.first())
        taken = None if layout.value_at is None else messages.taken(layout)
        if taken is None:
            return None
        stamp, value = taken
        return Decoded(
            stamps_of(stamp, replace(layout, stamp_at=0)) if layout.stamp_at is not None else None,
            _column(value, 0, layout.order + "d").astype(np.float64, copy=False),
            np.ones(len(messages), np.bool_),
        )


def by_layout(
    messages: Rows | Sequence[bytes], layout_of: Callable[[bytes], Layout]
) -> Iterator[tuple[NDArray[np.intp], Rows, Layout]]:
    """Yield the messages in groups of one layout: their indices, themselves as (n, length) uint8, and the layout.

    Parameters
    ----------
    messages : (n, length) uint8, one a row, or bytes of any lengths.
    layout_of : finds the layout of one message.
    """
    if isinstance(messages, np.ndarray):
        yield from _alike(np.arange(messages.shape[0]), messages, layout_of)
        return
    lengths = np.fromiter(map(len, messages), np.int64, len(messages))
    for length in np.unique(lengths):
        own = np.flatnonzero(lengths == length)
        joined = b"".join(messages if own.size == len(messages) else [messages[k] for k in own.tolist()])
        yield from _alike(own, np.frombuffer(joined, np.uint8).reshape(own.size, length), layout_of)


def _alike(
    numbers: NDArray[np.intp], rows: Rows, layout_of: Callable[[bytes], Layout]
) -> Iterator[tuple[NDArray[np.intp], Rows, Layout]]:
    """Yield rows of one length in groups of one layout, under their numbers."""
    for _ in range(_MANY_LAYOUTS):
        if not numbers.size:
            return
        layout = layout_of(rows[0].tobytes())
        alike = np.ones(numbers.size, np.bool_)
        for place, content in layout.fixed:
            template = np.frombuffer(content, np.uint8)
            alike &= np.all(rows[:, place : place + len(content)] == template, axis=1)
        if alike.all():
            yield numbers, rows, layout
            return
        yield numbers[alike], rows[alike], layout
        numbers, rows = numbers[~alike], rows[~alike]
    for k in range(numbers.size):
        yield numbers[k : k + 1], rows[k : k + 1], layout_of(rows[k].tobytes())


def stamps_of(rows: Rows, layout: Layout) -> Ints:
    """Return the header stamps of messages of one layout that has them, (n,), ns."""
    assert layout.stamp_at is not None
    seconds = _column(rows, layout.stamp_at, layout.order + layout.stamp_code)
    nanoseconds = _column(rows, layout.stamp_at + 4, layout.order + "I")
    return np.asarray(seconds.astype(np.int64) * NS_PER_S + nanoseconds, np.int64)


def _column(rows: Rows, place: int, code: str) -> NDArray[Any]:
    """Return the number of struct code `code` that stands at `place` of every row, (n,)."""
    kind = np.dtype(code)
    if rows.flags.c_contiguous and rows.shape[1] % kind.itemsize == place % kind.itemsize == 0:
        return rows.view(kind)[:, place // kind.itemsize]
    return np.ascontiguousarray(rows[:, place : place + kind.itemsize]).view(kind)[:, 0]


__all__ = [
    "AXES",
    "EXTRACTORS",
    "INPUTS",
    "Decoded",
    "Decoder",
    "Extractor",
    "LayoutError",
    "Messages",
    "NoValueError",
    "Rows",
    "Want",
    "by_layout",
    "stamps_of",
]
