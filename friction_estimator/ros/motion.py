"""What moves on the node's inputs: by `input.motion`, or by the first messages, as in a recording (`bag.motion`)."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from friction_estimator.bag.motion import LOOKED_AT, ROBOT_DESCRIPTION, Look, described_motion, reason
from friction_estimator.core.quantities import LINEAR, ROTARY, Quantities
from friction_estimator.core.settings.groups import AUTO, InputConfig

STAMPED = {"velocity": "geometry_msgs/msg/TwistStamped", "friction": "geometry_msgs/msg/WrenchStamped"}

CONTRARY_LOOKS = 3
"""Looks in a row, once a second, at which the last velocity moves in the other way: more than one noisy standstill."""

Told = Callable[[str, str], None]
"""Takes (motion, why)."""


class Motion:
    """Whether the drive is linear or rotary, and how that is known.

    Parameters
    ----------
    node : which hears the robot description.
    told : called where it is known, or known to be otherwise.

    Attributes
    ----------
    known : "linear", "rotary", or "" while the first stamped messages have not told.
    why : in words.
    """

    def __init__(self, node: Node, told: Told) -> None:
        self.known, self.why = "", ""
        self._node, self._told = node, told
        self._config = InputConfig()
        self._looks: dict[str, Look] = {}
        self._waiting: list[tuple[Callable[[bytes], None], bytes]] = []
        self._looked_at = self._contrary = 0
        self._description = self._joint = ""
        self._subscription: Any = None

    @property
    def quantities(self) -> Quantities:
        """What the drive's numbers are; of a linear one while that is not known."""
        return Quantities(self.known or LINEAR)

    def configure(self, config: InputConfig) -> None:
        """Begin with other settings; what the messages have told stays while the mode does."""
        changed = config.mode != self._config.mode or config.motion != self._config.motion or not self.why
        self._config = config
        self._looks = {name: Look(name, kind, config.axis) for name, kind in STAMPED.items()}
        if not changed:
            return
        self._looked_at = self._contrary = 0
        if config.motion != AUTO:
            self._settle(config.motion, "input.motion")
        elif config.mode == "stamped":
            self.known, self.why = "", "no message has told yet"
        elif config.mode == "joint_state":
            self._settle(ROTARY, "a JointState, and no robot description that has the joint as prismatic")
            self._hear_description()
        else:
            self._settle(LINEAR, "nothing in a Float64 tells: input.motion")

    def wait(self, name: str, raw: bytes, read: Callable[[bytes], None]) -> None:
        """Keep a message until it is known how to read it (see `released`), and look whether it tells."""
        self._waiting.append((read, raw))
        self._looked_at += 1
        told = self._looks[name].told(raw)
        if told or self._looked_at >= LOOKED_AT:
            why = reason(told, self._config.axis) if told else "nothing in the first messages tells"
            self._settle(told or LINEAR, why)

    def released(self) -> list[tuple[Callable[[bytes], None], bytes]]:
        """Return the messages that waited, each behind what reads it, in order of arrival; none before it is known."""
        waiting: list[tuple[Callable[[bytes], None], bytes]] = []
        if self.known:
            waiting, self._waiting = self._waiting, waiting
        return waiting

    def joint_is(self, joint: str) -> None:
        """Take the name of the joint whose values are read."""
        if joint != self._joint:
            self._joint = joint
            self._by_description()

    def contrary(self, raw: bytes) -> str:
        """Return what is wrong with the motion that is assumed, by the last velocity message; "" where nothing is.

        Asked once a second.
        """
        axis, rotary = self._config.axis, self.known == ROTARY
        linear, angular = self._looks["velocity"].moving(raw)
        contrary = linear > angular if rotary else angular > linear
        self._contrary = self._contrary + 1 if contrary and self._config.mode == "stamped" and self.known else 0
        if self._contrary < CONTRARY_LOOKS:
            return ""
        read, moving = ("angular", "linear") if rotary else ("linear", "angular")
        return (
            f"expected twist.{read}.{axis} of a {self.known} drive, seen twist.{moving}.{axis} moving: set "
            f"input.motion to {LINEAR if rotary else ROTARY}"
        )

    def close(self) -> None:
        """Hear the robot description no more."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _settle(self, motion: str, why: str) -> None:
        changed = motion != self.known
        self.known, self.why = motion, why
        if changed:
            self._told(motion, why)

    def _hear_description(self) -> None:
        if self._subscription is None:
            kept = QoSProfile(
                depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
            )
            self._subscription = self._node.create_subscription(String, ROBOT_DESCRIPTION, self._describe, kept)

    def _describe(self, message: String) -> None:
        self._description = message.data
        self._by_description()

    def _by_description(self) -> None:
        if self._config.motion != AUTO or self._config.mode != "joint_state":
            return
        described = described_motion(self._description, self._joint) if self._description and self._joint else ""
        if described:
            self._settle(described, f"{ROBOT_DESCRIPTION} has joint {self._joint} so")
