"""Where the numbers stand in a serialised message.

A `Cursor` walks one message the way its serialisation lays it out and remembers which bytes decided the way: a
length, a joint's name, the encapsulation. Every message that has the same bytes there has its numbers in the same
places, so one walk serves for thousands of messages (see `messages.Decoder`).

Serialisations: CDR of ROS 2 in both byte orders (4 bytes of encapsulation, alignment counted from behind them,
strings with a closing zero) and ROS 1 (little-endian, packed, strings without the zero).
"""

import struct
from dataclasses import dataclass

from friction_estimator.core.errors import InputError

ENCAPSULATION = {b"\x00\x00": ">", b"\x00\x01": "<"}
"""Byte order by CDR encapsulation identifier; the two bytes behind it are options and mean nothing here."""

SLACK = 16
"""Fewer bytes than this may follow the last member: writers pad, and Fast CDR overestimates some sizes."""


class LayoutError(InputError):
    """Bytes that are no message of the expected type."""


class NoValueError(InputError):
    """A sound message that does not hold the wanted value; says why."""


@dataclass(frozen=True)
class Layout:
    """Places in a message, and the bytes that fix them.

    Attributes
    ----------
    length : of the whole message, bytes.
    order : "<" or ">", byte order of its numbers.
    fixed : (place, bytes): messages of equal `length` with these bytes have this layout.
    stamp_at : place of the header stamp; None without header.
    stamp_code : struct code of the seconds: "i" in ROS 2, "I" in ROS 1.
    value_at : place of the wanted float64; None where the message does not hold it, `absence` says why.
    frame_id : of the header of the message that was walked; of others with this layout it may be another.
    joint : of the value.
    """

    length: int
    order: str
    fixed: tuple[tuple[int, bytes], ...]
    stamp_at: int | None
    stamp_code: str
    value_at: int | None
    absence: str
    frame_id: str
    joint: str

    def fits(self, raw: bytes) -> bool:
        """Whether another message has this layout, too."""
        if len(raw) != self.length:
            return False
        return all(raw[place : place + len(content)] == content for place, content in self.fixed)


class Cursor:
    """Walk through one serialised message.

    Parameters
    ----------
    raw : the message.
    ros1 : True for the ROS 1 serialisation, False for CDR.

    Raises
    ------
    LayoutError where the bytes end early or are of another serialisation; so does every method.
    """

    def __init__(self, raw: bytes, *, ros1: bool = False) -> None:
        self._raw, self._ros1 = raw, ros1
        self._fixed: list[tuple[int, bytes]] = []
        self._place = self._origin = 0 if ros1 else 4
        self.order = "<"
        self.stamp_at: int | None = None
        self.frame_id = ""
        self.joint = ""
        if not ros1:
            try:
                self.order = ENCAPSULATION[raw[:2]]
            except KeyError:
                raise LayoutError(f"serialisation {raw[:2].hex() or 'empty'} is not plain CDR") from None
            self._fixed.append((0, raw[:2]))

    def _advance(self, size: int) -> int:
        start, self._place = self._place, self._place + size
        if self._place > len(self._raw):
            raise LayoutError(f"message of {len(self._raw)} bytes ends early")
        return start

    def _align(self, size: int) -> None:
        if not self._ros1:
            self._place += (self._origin - self._place) % size

    def count(self) -> int:
        """Pass a uint32 length."""
        self._align(4)
        start = self._advance(4)
        self._fixed.append((start, self._raw[start : start + 4]))
        return int(struct.unpack_from(self.order + "I", self._raw, start)[0])

    def string(self, *, fixed: bool = True) -> str:
        """Pass a string; where it is not `fixed`, another text of the same length has the same layout."""
        size = self.count()
        start = self._advance(size)
        text = self._raw[start : start + size]
        closing = b"" if self._ros1 else b"\x00"
        if not text.endswith(closing):
            raise LayoutError("a string without its closing zero")
        decides = text if fixed else closing
        self._fixed.append((start + size - len(decides), decides))
        return text.removesuffix(closing).decode("utf-8", "replace")

    def header(self) -> None:
        """Pass a std_msgs/Header; keep the place of its stamp and its frame_id, which may change between messages."""
        if self._ros1:
            self._advance(4)  # seq
        self._align(4)
        self.stamp_at = self._advance(8)
        self.frame_id = self.string(fixed=False)

    def doubles(self, count: int) -> int:
        """Pass `count` float64; return the place of the first. No items, no alignment."""
        if count:
            self._align(8)
        return self._advance(8 * count)

    def array(self) -> tuple[int, int]:
        """Pass a float64 array of variable length; return (place of the first, count)."""
        count = self.count()
        return self.doubles(count), count

    def end(self) -> None:
        """Check that the message ends here."""
        if not 0 <= len(self._raw) - self._place < SLACK:
            raise LayoutError(f"{len(self._raw)} bytes, expected {self._place}")

    def layout(self, value_at: int | None, absence: str = "") -> Layout:
        """Return what was found."""
        return Layout(
            length=len(self._raw),
            order=self.order,
            fixed=_joined(self._fixed),
            stamp_at=self.stamp_at,
            stamp_code="I" if self._ros1 else "i",
            value_at=value_at,
            absence=absence,
            frame_id=self.frame_id,
            joint=self.joint,
        )


def _joined(pieces: list[tuple[int, bytes]]) -> tuple[tuple[int, bytes], ...]:
    """Join pieces that touch."""
    joined: list[tuple[int, bytes]] = []
    for place, content in pieces:
        if joined and joined[-1][0] + len(joined[-1][1]) == place:
            joined[-1] = (joined[-1][0], joined[-1][1] + content)
        elif content:
            joined.append((place, content))
    return tuple(joined)
