"""Names of joints as parts of topics, parameters, folders and files."""

import re
from collections.abc import Iterable, Mapping

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


def of_joint(values: Mapping[str, object], joint: str) -> dict[str, object]:
    """Return the settings of one joint out of those for several, by dotted names.

    What is named JOINT.SETTING (`plain_name` of a joint of `input.joints`) wins over SETTING for that joint and is of
    no meaning for others. `input.joints` itself stays only where no joint is named.

    >>> given = {"input.joints": ["a", "b"], "fir.order": 8, "b.fir.order": 4}
    >>> of_joint(given, "b")
    {'fir.order': 4, 'input.joint': 'b'}
    """
    joints = values.get("input.joints") or ()
    if not isinstance(joints, list | tuple) or not all(isinstance(each, str) for each in joints):
        return dict(values)  # told where it is judged
    plain = plain_names(joints)
    prefixes = tuple(f"{name}." for name in plain.values())
    chosen = {name: value for name, value in values.items() if not name.startswith(prefixes)}
    if joint:
        own = f"{plain[joint]}." if joint in plain else None
        if own is not None:
            chosen |= {name.removeprefix(own): value for name, value in values.items() if name.startswith(own)}
        chosen.pop("input.joints", None)
        chosen["input.joint"] = joint
    return chosen
