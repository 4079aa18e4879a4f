"""Fixed-layout reading and writing of the few serialised messages that the node handles.

Turning CDR bytes into a Python message and back costs more than the estimator itself. Each reader here checks
that the bytes have the layout it knows (little-endian CDR, lengths that add up) and reads only the numbers it
needs; anything else raises `LayoutError`, and the caller deserialises that message in full.
"""

import struct

_LITTLE_ENDIAN = b"\x00\x01"
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_DOUBLE = struct.Struct("<d")
_BODY = 4
"""CDR aligns to the byte after the four of encapsulation."""

_SLACK = 16
"""Fast CDR overestimates the size of some messages and leaves a few bytes behind the last member."""

NS = 1_000_000_000


class LayoutError(ValueError):
    """The bytes are not of the layout that the reader knows."""


def _aligned(place: int, size: int) -> int:
    return place + (_BODY - place) % size


def _count(raw: bytes, place: int) -> int:
    if place + 4 > len(raw):
        raise LayoutError("message ends early")
    return int(_COUNT.unpack_from(raw, place)[0])


def _end_of_header(raw: bytes) -> int:
    """Return the place after the header; raises LayoutError where it is no header."""
    if raw[:2] != _LITTLE_ENDIAN:
        raise LayoutError("not little-endian CDR")
    end = 16 + _count(raw, 12)
    if end > len(raw) or end < 17 or raw[end - 1] != 0:
        raise LayoutError("no frame_id string")
    return end


class StampedReader:
    """Reads stamp and one double of a message that is a header followed by doubles only.

    Parameters
    ----------
    doubles : how many doubles follow the header (6 in a Twist or Wrench, 2 in a FluidPressure).
    item : which of them to read.
    """

    def __init__(self, doubles: int, item: int) -> None:
        self._size, self._skip = 8 * doubles, 8 * item
        self._length = -1
        self._place = 0
        self.frame = b""
        """The header's length-prefixed frame_id of the last message, as serialised."""

    def read(self, raw: bytes) -> tuple[int, float]:
        """Return (stamp in ns, value); raises LayoutError."""
        end = 16 + len(self.frame) - 4
        if len(raw) != self._length or raw[12:end] != self.frame or raw[:2] != _LITTLE_ENDIAN:
            end = _end_of_header(raw)
            start = _aligned(end, 8)
            if not start + self._size <= len(raw) < start + self._size + _SLACK:
                raise LayoutError(f"{len(raw)} bytes, expected {start + self._size}")
            self._length, self._place, self.frame = len(raw), start + self._skip, raw[12:end]
        seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
        return seconds * NS + nanoseconds, _DOUBLE.unpack_from(raw, self._place)[0]


class JointReader:
    """Reads stamp, position, velocity and effort of one joint of a JointState; NaN where an array is empty.

    Parameters
    ----------
    joint : its name; empty: the only joint of the message.
    """

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self._length = -1
        self._prefix = self._middle = b""
        self._middle_at = 0
        self._places = (0, 0, 0)
        self.frame = b""
        self.names: list[str] = []
        self.index: int | None = None
        """Place of the joint in the last message; None where it is not in there."""
        self.holds = (False, False, False)
        """Whether the last message has the joint's position, velocity and effort."""

    def read(self, raw: bytes) -> tuple[int, float, float, float]:
        """Return (stamp in ns, position, velocity, effort); raises LayoutError."""
        if (
            len(raw) != self._length
            or raw[12 : 12 + len(self._prefix)] != self._prefix
            or raw[self._middle_at : self._middle_at + 4] != self._middle
            or raw[:2] != _LITTLE_ENDIAN
        ):
            self._learn(raw)
        seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
        position, velocity, effort = (
            _DOUBLE.unpack_from(raw, place)[0] if place else float("nan") for place in self._places
        )
        return seconds * NS + nanoseconds, position, velocity, effort

    def _learn(self, raw: bytes) -> None:
        """Walk through a message of a new layout and note the places of its numbers."""
        self._length = -1
        end = _end_of_header(raw)
        self.frame = raw[12:end]
        place = _aligned(end, 4)
        count = _count(raw, place)
        place += 4
        names = []
        for _ in range(count):
            place = _aligned(place, 4)
            size = _count(raw, place)
            if place + 4 + size > len(raw):
                raise LayoutError("message ends in a joint name")
            names.append(raw[place + 4 : place + 3 + size].decode("utf-8", "replace"))
            place += 4 + size
        counts, starts = self._arrays(raw, place)
        self.names = names
        self.index = joint_index(self._joint, names, max(counts[1], counts[2]))
        index = self.index
        self._places = tuple(  # type: ignore[assignment]
            start + 8 * index if index is not None and index < size else 0
            for size, start in zip(counts, starts, strict=True)
        )
        self.holds = tuple(place > 0 for place in self._places)  # type: ignore[assignment]
        self._prefix = raw[12 : _aligned(place, 4) + 4]
        self._middle_at = _aligned(starts[0] + 8 * counts[0], 4)
        self._middle = raw[self._middle_at : self._middle_at + 4]
        self._length = len(raw)

    @staticmethod
    def _arrays(raw: bytes, place: int) -> tuple[list[int], list[int]]:
        """Return counts and places of position, velocity and effort, which begin after `place`."""
        # Some writers align the start of an empty array too: take what adds up.
        for align_empty in (False, True):
            counts, starts, at = [], [], place
            for _ in range(3):
                at = _aligned(at, 4)
                if at + 4 > len(raw):
                    break
                counts.append(_count(raw, at))
                at += 4
                if counts[-1] or align_empty:
                    at = _aligned(at, 8)
                starts.append(at)
                at += 8 * counts[-1]
            if len(counts) == 3 and at <= len(raw) < at + _SLACK:
                return counts, starts
        raise LayoutError(f"{len(raw)} bytes do not hold three arrays")


def joint_index(joint: str, names: list[str], values: int) -> int | None:
    """Return the place of `joint` in `names`; the only joint's place where `joint` is empty; None: not there."""
    if joint:
        return names.index(joint) if joint in names else None
    return 0 if len(names) == 1 or (not names and values == 1) else None


def frame_id(frame: bytes) -> str:
    """Return the text of a serialised frame_id."""
    return frame[4:-1].decode("utf-8", "replace")


def read_double(raw: bytes) -> float:
    """Return the value of a message that is one double without a header; raises LayoutError."""
    if raw[:2] != _LITTLE_ENDIAN or not 12 <= len(raw) < 12 + _SLACK:
        raise LayoutError(f"{len(raw)} bytes, expected 12")
    return float(_DOUBLE.unpack_from(raw, 4)[0])


class WrenchWriter:
    """Writes a serialised WrenchStamped with one force component.

    Parameters
    ----------
    axis : 0, 1 or 2 for force.x, .y, .z.
    """

    def __init__(self, axis: int) -> None:
        self._axis = axis
        self._frame = b""
        self._head = self._tail = b""
        self._struct = struct.Struct("<")

    def write(self, stamp_ns: int, frame: bytes, force_N: float) -> bytes:
        """Return the message; `frame` is a serialised frame_id as the readers give it."""
        if frame != self._frame or not self._head:
            padding = _aligned(12 + len(frame), 8) - 12 - len(frame)
            self._head = _LITTLE_ENDIAN + b"\x00\x00"
            self._frame, self._padded = frame, frame + bytes(padding)
            before, after = 8 * self._axis, 40 - 8 * self._axis
            self._struct = struct.Struct(f"<4siI{len(self._padded)}s{before}xd{after}x")
        seconds, nanoseconds = divmod(stamp_ns, NS)
        return self._struct.pack(self._head, seconds, nanoseconds, self._padded, force_N)


def serialised_frame(frame_id: str) -> bytes:
    """Return a frame_id as it stands in a serialised header."""
    text = frame_id.encode() + b"\x00"
    return _COUNT.pack(len(text)) + text
