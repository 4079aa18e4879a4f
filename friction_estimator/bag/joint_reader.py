"""Position, velocity and effort of several joints from one JointState message, decoded once for all of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

from friction_estimator.bag.joint_arrays import LABELS, JointArrays
from friction_estimator.bag.layout import Cursor, Layout, NoValueError

_KEPT = 8
"""Layouts remembered: a machine may publish its joints in parts, in turns, on one topic."""


@dataclass(frozen=True)
class JointPlaces:
    """Where the joints stand in every message of one layout.

    Attributes
    ----------
    layout : the bytes that fix it.
    unpack : takes a message, returns its numbers: seconds, nanoseconds, positions, velocities, efforts.
    present : (number of the joint, index of its position, velocity and effort in those numbers); 0 for no position, and
        for a velocity that the position stands for.
    absent : (number of the joint, why it is not in the message).
    joints : name of each joint that is.
    """

    layout: Layout
    unpack: Callable[[bytes], tuple[Any, ...]]
    present: tuple[tuple[int, int, int, int], ...]
    absent: tuple[tuple[int, str], ...]
    joints: tuple[str, ...]


class JointReader:
    """Read the same joints from many messages.

    The places are found on one message and serve for all that have the same bytes where lengths and names stand; so
    every message is checked, and the usual one costs a few comparisons and one unpacking for all joints together.

    Parameters
    ----------
    joints : names; the empty name is the only joint of a message.
    velocity_from : `input.velocity_from` of each; "topic" unless given.
    """

    def __init__(self, joints: Sequence[str], velocity_from: Sequence[str] | None = None) -> None:
        self._joints = tuple(zip(joints, velocity_from or ["topic"] * len(joints), strict=True))
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
        present, absent, joints = [], [], []
        counts = arrays.counts
        first = {"position": 2, "velocity": 2 + counts["position"]}
        first["friction"] = first["velocity"] + counts["velocity"]
        for number, (joint, velocity_from) in enumerate(self._joints):
            try:
                name = arrays.named(joint, "velocity")
                held = arrays.names.index(name) < counts["position"]
                position = first["position"] + arrays.index(name, "position") if held else 0
                moved = arrays.names.index(name) < counts["velocity"]
                if velocity_from == "position" or (velocity_from == "auto" and held and not moved):
                    arrays.index(name, "position")
                    velocity = 0
                else:
                    velocity = first["velocity"] + arrays.index(name, "velocity")
                effort = first["friction"] + arrays.index(name, "friction")
            except NoValueError as error:
                absent.append((number, str(error)))
                continue
            present.append((number, position, velocity, effort))
            joints.append(name)
        unpack = _numbers(layout, arrays).unpack_from
        return JointPlaces(layout, unpack, tuple(present), tuple(absent), tuple(joints))


def _numbers(layout: Layout, arrays: JointArrays) -> Struct:
    """Return what unpacks stamp, positions, velocities and efforts of a message."""
    assert layout.stamp_at is not None
    code, place = f"{layout.order}{layout.stamp_at}x{layout.stamp_code}I", layout.stamp_at + 8
    for quantity in LABELS:
        start, count = arrays.starts[quantity], arrays.counts[quantity]
        if count:
            code += f"{start - place}x{count}d"
            place = start + 8 * count
    return Struct(code)
