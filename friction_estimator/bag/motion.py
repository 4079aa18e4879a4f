"""Whether a drive is linear or rotary, by what it publishes: the same rule for a recording and for the live node.

A TwistStamped has linear and angular velocity, a WrenchStamped force and torque. The first message decides of which
only one, along the axis, is not zero; a velocity also decides for linear where both are not, since a sensor of six
axes measures forces and torques whatever moves, and a drive's velocity seldom both. A JointState has numbers without
a unit: its joint is rotary unless a robot description has it as prismatic.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING
from xml.etree import ElementTree  # DOCTYPE, without which there are no entities, is refused below

from friction_estimator.bag.layout import Cursor
from friction_estimator.bag.messages import EXTRACTORS, Decoder, LayoutError, NoValueError, Want
from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.core.settings.groups import AUTO, InputConfig

if TYPE_CHECKING:  # the node needs this module, but no reader of recordings, whose import is a thirtieth of its start
    from friction_estimator.bag.source import Source, Topic

LOOKED_AT = 1000
"""Messages that are looked at; where none of them tells, the drive is taken for linear."""

LARGEST_DESCRIPTION = 2**24
"""Characters of a robot description."""

ROBOT_DESCRIPTION = "robot_description"

_TYPES = {"revolute": ROTARY, "continuous": ROTARY, "prismatic": LINEAR}


class Look:
    """Reads both components of a quantity, linear and angular, in messages of one type.

    Parameters
    ----------
    quantity : "velocity" or "friction".
    message_type : one whose extractor is `along_axis`.
    axis, ros1 : as for `Decoder`.

    Examples
    --------
    >>> import struct
    >>> twist = lambda *values: bytes((0, 1, 0, 0)) + struct.pack("<6d", *values)
    >>> look = Look("velocity", "geometry_msgs/msg/Twist", "z")
    >>> look.told(twist(0, 0, 0, 0, 0, 0)), look.told(twist(0, 0, 0, 0, 0, 2)), look.told(twist(0, 0, 1, 0, 0, 2))
    ('', 'rotary', 'linear')
    """

    def __init__(self, quantity: str, message_type: str, axis: str, *, ros1: bool = False) -> None:
        self._decides = quantity == "velocity"
        self._decoders = [
            Decoder(EXTRACTORS[message_type], Want(quantity, axis, motion=motion), ros1=ros1)
            for motion in (LINEAR, ROTARY)
        ]

    def told(self, raw: bytes) -> str:
        """Return the motion that a message tells; "" where it tells none."""
        linear, angular = self.moving(raw)
        if linear:
            return LINEAR if self._decides or not angular else ""
        return ROTARY if angular else ""

    def moving(self, raw: bytes) -> tuple[bool, bool]:
        """Return whether the linear and the angular component of a message are numbers other than 0."""
        try:
            values = [decoder.one(raw)[1] for decoder in self._decoders]
        except (LayoutError, NoValueError):  # reading it says so
            return False, False
        linear, angular = (math.isfinite(value) and value != 0.0 for value in values)
        return linear, angular


def recorded_motion(
    source: "Source", topics: Mapping[str, "Topic"], config: InputConfig, joint: str | None
) -> tuple[str, str]:
    """Return whether a recorded drive is linear or rotary, and why.

    Parameters
    ----------
    source : the recording. topics : of the inputs.
    config : `input.motion` decides where it is not auto.
    joint : whose effort it is; None where it does not come from a JointState.
    """
    if config.motion != AUTO:
        return config.motion, "input.motion"
    looks = {
        topics[name].name: Look(name, topics[name].message_type, config.axis, ros1=source.ros1)
        for name in ("friction", "velocity")
        if name in topics and EXTRACTORS[topics[name].message_type].along_axis
    }
    for _, (topic, _, raw) in zip(range(LOOKED_AT), source.messages(looks), strict=False):
        if told := looks[topic].told(raw):
            return told, reason(told, config.axis)
    if joint is None:
        return LINEAR, "nothing in the recording tells"
    return joint_motion(source, joint)


def joint_motion(source: "Source", joint: str) -> tuple[str, str]:
    """Return whether a joint of a recorded JointState is linear or rotary, and why: by a recorded robot description."""
    for topic in source.topics:
        if topic.name.rsplit("/", 1)[-1] == ROBOT_DESCRIPTION and topic.message_type == "std_msgs/msg/String":
            raw = source.first(topic.name)
            described = described_motion(_string(raw, source.ros1), joint) if raw is not None else ""
            if described:
                return described, f"{topic.name} has joint {joint} so"
    return ROTARY, "a JointState, and no robot description that has the joint as prismatic"


def reason(motion: str, axis: str) -> str:
    """Return why stamped messages tell this motion, in words."""
    velocity, force = ("angular", "torque") if motion == ROTARY else ("linear", "force")
    return f"twist.{velocity}.{axis} or wrench.{force}.{axis} is the one of its two that is not 0"


def described_motion(description: str, joint: str) -> str:
    """Return what a robot description (URDF) says of a joint: "linear", "rotary", or "" where it does not.

    >>> urdf = '<robot><joint name="lift" type="prismatic"/><joint name="arm" type="revolute"/></robot>'
    >>> described_motion(urdf, "lift"), described_motion(urdf, "arm"), described_motion(urdf, "leg")
    ('linear', 'rotary', '')
    """
    if len(description) > LARGEST_DESCRIPTION or "<!DOCTYPE" in description:
        return ""
    try:
        root = ElementTree.fromstring(description)
    except (ElementTree.ParseError, ValueError):
        return ""
    kinds = (item.get("type", "") for item in root.iter("joint") if item.get("name") == joint)
    return next((_TYPES[kind] for kind in kinds if kind in _TYPES), "")


def _string(raw: bytes, ros1: bool) -> str:
    try:
        return Cursor(raw, ros1=ros1).string()
    except LayoutError:
        return ""
