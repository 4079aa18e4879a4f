"""Names of joints as parts of topics, parameters, folders and files."""

import re
from collections.abc import Iterable

from friction_estimator.core.errors import ConfigError

_FOREIGN = re.compile(r"[^A-Za-z0-9_]")


def plain_name(joint: str) -> str:
    """Return a joint's name as ROS and file systems take it.

    Characters outside [A-Za-z0-9_] become _; before a digit, with which no part of a topic's name may begin, stands
    `joint_`.

    >>> plain_name("arm/Schulter-ä 1"), plain_name("2nd")
    ('arm_Schulter___1', 'joint_2nd')
    """
    name = _FOREIGN.sub("_", joint)
    return f"joint_{name}" if name[:1].isdigit() else name


def plain_names(joints: Iterable[str]) -> dict[str, str]:
    """Return `plain_name` by joint, in order.

    Raises ConfigError where a joint has no name, stands there twice, or where two become one name.

    >>> plain_names(["a.b", "a-b"])
    Traceback (most recent call last):
    friction_estimator.core.errors.ConfigError: the joints 'a.b' and 'a-b' both become a_b: rename one of them
    """
    plain: dict[str, str] = {}
    taken: dict[str, str] = {}
    for joint in joints:
        if not joint:
            raise ConfigError("input.joints: a joint has no name: give it one")
        if joint in plain:
            raise ConfigError(f"input.joints: {joint!r} stands there twice")
        name = plain_name(joint)
        if name in taken:
            raise ConfigError(f"the joints {taken[name]!r} and {joint!r} both become {name}: rename one of them")
        plain[joint], taken[name] = name, joint
    return plain
