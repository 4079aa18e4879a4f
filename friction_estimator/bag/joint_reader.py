"""Velocity and effort of several joints from one JointState message, decoded once for all of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct

from friction_estimator.bag.joint_arrays import JointArrays
from friction_estimator.bag.layout import Cursor, Layout, NoValueError

_KEPT = 8
"""Layouts remembered: a machine may publish its joints in parts, in turns, on one topic."""


@dataclass(frozen=True)
class JointPlaces:
    """Where the joints stand in every message of one layout.

    Attributes
    ----------
    layout : the bytes that fix it.
    unpack : takes a message and `layout.stamp_at`, returns its numbers: seconds, nanoseconds, velocities, efforts.
    present : (number of the joint, index of its velocity and of its effort in those numbers).
    absent : (number of the joint, why it is not in the message).
    """

    layout: Layout
    unpack: Struct
    present: tuple[tuple[int, int, int], ...]
    absent: tuple[tuple[int, str], ...]


class JointReader:
    """Read the same joints from many messages.

    The places are found on one message and serve for all that have the same bytes where lengths and names stand; so
    every message is checked, and the usual one costs four comparisons and one unpacking for all joints together.

    Parameters
    ----------
    joints : names; the empty name is the only joint of a message.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self._joints = tuple(joints)
        self._known: list[JointPlaces] = []

    def places(self, raw: bytes) -> JointPlaces:
        """Return where the joints of a message stand; raises LayoutError where it is no JointState."""
        for number, known in enumerate(self._known):
            if known.layout.fits(raw):
                if number:
                    self._known.insert(0, self._known.pop(number))
                return known
        found = self._learn(raw)
        self._known.insert(0, found)
        del self._known[_KEPT:]
        return found

    def _learn(self, raw: bytes) -> JointPlaces:
        cursor = Cursor(raw)
        arrays = JointArrays.walk(cursor)
        layout = cursor.layout(None)
        present, absent = [], []
        velocities = arrays.counts["velocity"]
        for number, joint in enumerate(self._joints):
            try:
                name = arrays.named(joint, "velocity")
                velocity, effort = arrays.index(name, "velocity"), arrays.index(name, "friction")
                present.append((number, 2 + velocity, 2 + velocities + effort))
            except NoValueError as error:
                absent.append((number, str(error)))
        return JointPlaces(layout, _numbers(layout, arrays), tuple(present), tuple(absent))


def _numbers(layout: Layout, arrays: JointArrays) -> Struct:
    """Return what unpacks stamp, velocities and efforts, from the stamp on."""
    assert layout.stamp_at is not None
    code, place = f"{layout.order}{layout.stamp_code}I", layout.stamp_at + 8
    for quantity in ("velocity", "friction"):
        start, count = arrays.starts[quantity], arrays.counts[quantity]
        if count:
            code += f"{start - place}x{count}d"
            place = start + 8 * count
    return Struct(code)
