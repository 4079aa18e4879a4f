"""What stands where in a sensor_msgs/JointState: names, and an array each of position, velocity and effort."""

import difflib
from dataclasses import dataclass
from functools import lru_cache

from friction_estimator.bag.layout import Cursor, LayoutError, NoValueError

CHOOSE_JOINT = "choose one with --joint"
"""Ends every reason that another choice of joint removes."""

LABELS = {"position": "position", "velocity": "velocity", "friction": "effort"}
"""Input -> how a JointState calls it, in the order of the message."""


@dataclass(frozen=True)
class JointArrays:
    """The arrays of one message.

    Attributes
    ----------
    names : of the joints, as they stand there: empty or twice, where the driver writes them so.
    starts, counts : by input (`LABELS`), place of the first float64 in the message; how many there are.
    """

    names: tuple[str, ...]
    starts: dict[str, int]
    counts: dict[str, int]

    @classmethod
    def walk(cls, cursor: Cursor) -> "JointArrays":
        """Walk a message. Raises LayoutError where it is none."""
        cursor.header()
        names = tuple([cursor.string() for _ in range(cursor.count())])
        arrays = {quantity: cursor.array() for quantity in LABELS}
        cursor.end()
        return cls(names, {q: start for q, (start, _) in arrays.items()}, {q: n for q, (_, n) in arrays.items()})

    def named(self, joint: str, quantity: str) -> str:
        """Return the joint that is meant: the named one, or the only one where `joint` is empty.

        Raises NoValueError where that is not clear, or where no joint has a name.
        """
        if not self.names:
            empty = "" if self.counts[quantity] else f" and {LABELS[quantity]} is empty"
            raise NoValueError(f"joint names are empty{empty}")
        listed = ", ".join(self.names)
        if not joint:
            if len(self.names) > 1:
                raise NoValueError(f"several joints ({listed}): {CHOOSE_JOINT}")
            return self.names[0]
        if joint not in self.names:
            near = nearest(joint, self.names)
            hint = f" (did you mean {near}?)" if near else ""
            raise NoValueError(f"no joint {joint!r}{hint} among {listed}: {CHOOSE_JOINT}")
        return joint

    def index(self, joint: str, quantity: str) -> int:
        """Return which value of a quantity is a joint's; raises NoValueError where it has none."""
        index, count = self.names.index(joint), self.counts[quantity]
        if not count:
            raise NoValueError(f"{LABELS[quantity]} is empty")
        if index >= count:
            raise NoValueError(f"{LABELS[quantity]} has {count} values for {len(self.names)} joints")
        return index

    def place(self, joint: str, quantity: str) -> int:
        """Return the place of a joint's float64; raises NoValueError where it has none."""
        return self.starts[quantity] + 8 * self.index(joint, quantity)


def holds_a_joint(raw: bytes, motion: tuple[str, ...] = ("velocity",), *, ros1: bool = False) -> bool:
    """Whether a message holds one of the quantities `motion`, and effort, of any joint."""
    try:
        arrays = JointArrays.walk(Cursor(raw, ros1=ros1))
    except LayoutError:
        return False
    moves = any(arrays.counts[quantity] for quantity in motion)
    return bool(arrays.names and moves and arrays.counts["friction"])


@lru_cache(maxsize=256)
def nearest(joint: str, names: tuple[str, ...]) -> str:
    """Return the name that was probably meant; empty where none is near. Kept: a live input may ask at every message.

    >>> nearest("elbw", ("shoulder", "elbow"))
    'elbow'
    """
    return next(iter(difflib.get_close_matches(joint, names, n=1)), "")
