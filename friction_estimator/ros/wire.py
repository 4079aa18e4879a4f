"""Writing the one message type that the node sends for every sample, without a message object.

The readers are `bag.messages`, which replay uses too. Turning CDR bytes into a Python message and back costs
more than the estimator itself.
"""

import struct

_LITTLE_ENDIAN = b"\x00\x01"
_ENCAPSULATION = b"\x00\x01\x00\x00"
_COUNT = struct.Struct("<I")
_FRAME_AT = 12
_NS = 1_000_000_000


def serialised_frame(frame_id: str) -> bytes:
    """Return a frame_id as it stands in a serialised header: length, text, zero."""
    text = frame_id.encode() + b"\x00"
    return _COUNT.pack(len(text)) + text


NO_FRAME = serialised_frame("")


def frame_in(raw: bytes) -> bytes:
    """Return the serialised frame_id of a stamped message; empty where its byte order is another machine's."""
    if raw[:2] != _LITTLE_ENDIAN:
        return NO_FRAME
    return raw[_FRAME_AT : _FRAME_AT + 4 + _COUNT.unpack_from(raw, _FRAME_AT)[0]]


def frame_id(frame: bytes) -> str:
    """Return the text of a serialised frame_id."""
    return frame[4:-1].decode("utf-8", "replace")


class WrenchWriter:
    """Writes a serialised WrenchStamped with one component that is not zero.

    Parameters
    ----------
    component : 0, 1 or 2 for force.x, .y, .z; 3, 4 or 5 for torque.x, .y, .z.
    """

    def __init__(self, component: int) -> None:
        self._component = component
        self._frame = b""
        self._padded = b""
        self._struct = struct.Struct("<")

    def write(self, stamp_ns: int, frame: bytes, force_N: float) -> bytes:
        """Return the message; `frame` is a serialised frame_id."""
        if frame != self._frame:
            # CDR aligns float64 to 8 bytes, counted from behind the encapsulation.
            padding = -(_FRAME_AT - len(_ENCAPSULATION) + len(frame)) % 8
            self._frame, self._padded = frame, frame + bytes(padding)
            before, after = 8 * self._component, 40 - 8 * self._component
            self._struct = struct.Struct(f"<4siI{len(self._padded)}s{before}xd{after}x")
        seconds, nanoseconds = divmod(stamp_ns, _NS)
        return self._struct.pack(_ENCAPSULATION, seconds, nanoseconds, self._padded, force_N)
