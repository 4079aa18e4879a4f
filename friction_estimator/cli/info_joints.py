"""What `info` says of the joints in JointState topics."""

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from friction_estimator.core.quantities import FORCE, POSITION, VELOCITY, Quantities
from friction_estimator.core.text import LONGEST_NAME, shown

if TYPE_CHECKING:
    from friction_estimator.bag.joint_survey import Joint, JointTopic

LABELS = {"position": POSITION, "velocity": VELOCITY, "effort": FORCE}
"""Quantities in the order of a JointState, with the unit of each on a linear drive."""


def facts(found: "JointTopic", motion_of: Callable[[str], str]) -> dict[str, Any]:
    """Return the JSON of one topic; `motion_of` says whether a joint is linear or rotary."""
    joints = {name: {"motion": motion_of(name), **_joint(joint)} for name, joint in found.joints.items()}
    head = {"topic": found.topic.name, "fault": found.fault or None, "unlisted": found.unlisted}
    return head | {"joints": joints, "without_names": dict(found.unnamed)}


def _joint(joint: "Joint") -> dict[str, Any]:
    quantities = {
        label: {**asdict(quantity), "absent": dict(quantity.absent)}
        for label, quantity in zip(LABELS, joint.quantities.values(), strict=True)
    }
    head = {"messages": joint.messages, "rate_hz": joint.rate_hz, "named_twice": joint.named_twice}
    return head | quantities | {"problem": joint.problem or None}


def lines(topics: list[dict[str, Any]], shown_as: Callable[[str], Quantities]) -> list[str]:
    """Return the words for `facts` of some topics; `shown_as` says how the numbers of a motion are shown."""
    out = []
    for topic in topics:
        out.append(f"joints of {topic['topic']}")
        if topic["fault"]:
            out.append(f"  a message is no sensor_msgs/JointState: {topic['fault']}; nothing behind it is looked at")
        if topic["unlisted"]:
            out.append(f"  more than {len(topic['joints'])} joints: {topic['unlisted']} more names are not listed")
        for held, count in topic["without_names"].items():
            out.append(f"  joint names are empty in {count} messages, which hold {held}: no joint can be chosen")
        width = max((len(_name(name)) for name in topic["joints"]), default=0)
        for name, joint in topic["joints"].items():
            quantities = shown_as(joint["motion"])
            ranges = ", ".join(_range(label, joint[label], quantities) for label in LABELS)
            rate = f"{joint['messages']} messages, {joint['rate_hz']:.5g} Hz"
            out.append(f"  {_name(name).ljust(width)}  {rate}; {ranges}")
            out += [f"  {'':{width}}  {fault}" for fault in _faults(joint)]
    return out


def _name(name: str) -> str:
    return shown(name, LONGEST_NAME) or "(no name)"


def _range(label: str, quantity: dict[str, Any], quantities: Quantities) -> str:
    if not quantity["values"] and len(quantity["absent"]) == 1:
        return str(*quantity["absent"])
    if quantity["values"] == quantity["nan"] + quantity["infinite"]:
        return f"no {label}"
    lowest, unit = quantities.value(quantity["lowest"], LABELS[label]), LABELS[label]
    return f"{label} {lowest:.4g} to {quantities.text(quantity['highest'], unit)}"


def _faults(joint: dict[str, Any]) -> list[str]:
    """Return what is wrong with a joint's messages, a line each."""
    found = []
    if joint["named_twice"]:
        found.append(f"named more than once in {joint['named_twice']} messages: the first place counts")
    for label in LABELS:
        quantity = joint[label]
        absent = quantity["absent"] if quantity["values"] else {}
        found += [f"{reason} in {count} messages" for reason, count in absent.items()]
        told = ("nan", "NaN"), ("infinite", "infinite or beyond what a sensor reads")
        found += [f"{label} is {words} in {quantity[key]} messages" for key, words in told if quantity[key]]
    if joint["problem"] is None and joint["velocity"]["lowest"] == joint["velocity"]["highest"]:
        found.append("stands still: the velocity never changes")
    return found
