"""What is wrong with the inputs: the faults that make a node sit silent, lose messages or mix two sensors up, each
found and put into words.

A finding names the topic, what was expected and what was seen. `Findings` logs each once, again every minute
while it lasts, and once more when it is gone.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible
from sensor_msgs.msg import JointState

from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.ros.inputs import Inputs
from friction_estimator.ros.source import Source, type_name
from friction_estimator.ros.wire import frame_id

REPEAT_S = 60.0
"""A finding that lasts is logged again after this time."""

FEW = 3
"""Messages in one look that make a stream count as arriving."""

TOLD_BY_TOPIC = ("wrong_joint", "empty", "malformed")
"""Rejections of whole messages; they have findings of their own."""


@dataclass(frozen=True)
class Finding:
    """One fault: `key` tells it from others, `text` explains it; `grave` where nothing can come out for it."""

    key: str
    text: str
    grave: bool = False


class Findings:
    """Log findings without flooding the log, even where one comes and goes."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._logged_at: dict[str, float] = {}
        self._present: dict[str, Finding] = {}

    def update(self, findings: list[Finding]) -> None:
        """Take the present findings: new ones and lasting ones are logged, vanished ones are told."""
        now = time.monotonic()
        present = {finding.key: finding for finding in findings}
        for key, finding in present.items():
            if now - self._logged_at.get(key, -REPEAT_S) >= REPEAT_S:
                if finding.grave:  # rclpy allows one severity a line of source
                    self._node.get_logger().error(finding.text)
                else:
                    self._node.get_logger().warning(finding.text)
                self._logged_at[key] = now
        for key, finding in self._present.items():
            gone = f"gone: {key}"
            if key not in present and now - self._logged_at.get(gone, -REPEAT_S) >= REPEAT_S:
                self._node.get_logger().info(f"no longer so: {finding.text}")
                self._logged_at[gone] = now
        self._present = present
        self._logged_at = {key: at for key, at in self._logged_at.items() if now - at < REPEAT_S or key in present}


def stamp_offset_s(earlier: Source, later: Source) -> float:
    """Return the median distance from stamps of `later` to the nearest stamps of `earlier`, s; NaN without both."""
    ours, theirs = np.array(later.last_stamps, np.int64), np.sort(np.array(earlier.last_stamps, np.int64))
    if not ours.size or not theirs.size:
        return float("nan")
    place = np.clip(np.searchsorted(theirs, ours), 1, max(1, theirs.size - 1))
    candidates = np.stack([theirs[np.minimum(place, theirs.size - 1)], theirs[place - 1]])
    distance = ours - candidates
    nearest = np.take_along_axis(distance, np.abs(distance).argmin(axis=0)[None], axis=0)[0]
    return float(np.median(nearest)) / NS_PER_S


def explain(
    node: Node,
    config: Config,
    sources: Mapping[str, Source],
    messages: Mapping[str, int],
    rejects: Mapping[str, int],
    samples: int,
) -> Iterator[Finding]:
    """Yield what is wrong with the inputs.

    Parameters
    ----------
    sources : the open inputs.
    messages : messages of each input since the last look.
    rejects : rejected samples since the last look, by reason.
    samples : admitted samples since the last look.
    """
    required = [source for source in sources.values() if source.required]
    silent = [source for source in required if not messages[source.name]]
    heard = [source for source in required if messages[source.name]]
    for source in sources.values():
        if source.fault:
            yield Finding(f"{source.name}: cannot be subscribed to", source.fault, grave=source.required)
    for source in silent:
        if not source.fault:
            yield _why_silent(node, source, heard)
    for source in sources.values():
        yield from _content(config, source, messages[source.name])
        yield from _several_publishers(node, source)
        if source.missing:
            yield Finding(
                f"{source.name}: messages missing",
                f"{source.topic}: expected a message every {source.rhythm.period_ns / 1e6:.4g} ms by the stamps of "
                f"those that came, {source.missing} are missing since the last look ({source.rhythm.missing} in all); "
                "where none may be lost, use reliable publishers and a reliable subscription",
            )
    if silent or samples:
        return
    refused = {reason: count for reason, count in rejects.items() if count and reason not in TOLD_BY_TOPIC}
    zero, total = refused.get("zero_stamp", 0), sum(refused.values())
    if zero and 2 * zero >= total:
        yield Finding(
            "zero stamps",
            f"{_topics(required)}: expected header stamps, all are zero; let the drivers set header.stamp, "
            "or use input.mode float64",
        )
    elif total and "unmatched" not in refused:
        reasons = ", ".join(f"{count} {reason}" for reason, count in refused.items())
        yield Finding(
            f"all refused: {', '.join(refused)}",
            f"{_topics(required)}: expected usable samples, every one was refused: {reasons}",
        )
    elif len(required) == 2 and all(messages[source.name] >= FEW for source in required):
        offset = stamp_offset_s(*required)
        yield Finding(
            "stamps never match",
            f"{_topics(required)}: expected equal stamps (sync.slop is {config.sync.slop:g} s), "
            f"{required[1].name} stamps lie {offset:+.6f} s from the nearest {required[0].name} stamps; "
            f"set sync.slop above {abs(offset):.2g} s if that is less than half the sample period, "
            "or stamp both from one clock",
        )


def _topics(sources: list[Source]) -> str:
    return " and ".join(source.topic for source in sources)


def _why_silent(node: Node, source: Source, heard: list[Source]) -> Finding:
    expected = type_name(source.kind)
    publishers: list[Any] = node.get_publishers_info_by_topic(source.topic)
    if not publishers:
        same = [
            topic
            for topic, types in node.get_topic_names_and_types()
            if expected in types and node.count_publishers(topic) and not topic.startswith(f"{_name(node)}/")
        ]
        hint = f"; topics of that type: {', '.join(same)}" if same else ""
        return Finding(
            f"{source.name}: no publisher{hint}", f"{source.topic}: expected a publisher of {expected}, seen none{hint}"
        )
    of_type = [info for info in publishers if info.topic_type == expected]
    if not of_type:
        seen = ", ".join(sorted({info.topic_type for info in publishers}))
        return Finding(f"{source.name}: wrong type", f"{source.topic}: expected {expected}, seen {seen}")
    matching = []
    reasons = set()
    for info in of_type:
        verdict, reason = qos_check_compatible(info.qos_profile, source.qos)
        if verdict == QoSCompatibility.ERROR:
            reasons.add(reason.strip().rstrip(";"))
        else:
            matching.append(info)
    if not matching:
        theirs = of_type[0].qos_profile
        return Finding(
            f"{source.name}: incompatible QoS",
            f"{source.topic}: expected {source.qos.reliability.name} {source.qos.durability.name}, seen "
            f"{theirs.reliability.name} {theirs.durability.name}: incompatible QoS, nothing can arrive "
            f"({'; '.join(sorted(reasons))}); change qos_overrides.{source.topic}.subscription.*",
        )
    others = f"; only {' and '.join(other.name for other in heard)} arrives" if heard else ""
    who = ", ".join(sorted({f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in matching}))
    return Finding(
        f"{source.name}: silent{others}",
        f"{source.topic}: expected messages from {who}, seen none in the last second{others}",
    )


def _several_publishers(node: Node, source: Source) -> Iterator[Finding]:
    """Yield that several publishers are on one input."""
    if source.fault or source.publishers < 2:
        return
    if source.kind is JointState and source.rejected_lately().get("wrong_joint"):
        return  # the joints of a machine, published in parts: one of them has ours
    who = sorted(
        f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        for info in node.get_publishers_info_by_topic(source.topic)
    )
    names = shown(", ".join(who), LONGEST_NAME)
    yield Finding(
        f"{source.name}: several publishers",
        f"{source.topic}: expected one publisher, seen {source.publishers} ({names}): the values of both are taken for "
        "one sensor's; stop one, or remap this input",
    )


def _content(config: Config, source: Source, messages: int) -> Iterator[Finding]:
    """Yield what is wrong with the messages of one input themselves."""
    if not messages:
        return
    now = source.rejected_lately()
    seen = source.absence.partition(": choose")[0]  # the hint is the command line's
    if now.get("wrong_joint"):
        expected = f"joint {config.input.joint!r}" if config.input.joint else "one joint (input.joint is empty)"
        yield Finding(f"{source.name}: wrong joint", f"{source.topic}: expected {expected}, seen: {seen}")
    if now.get("empty"):
        wanted = "position" if source.name == "position" else "velocity and effort"
        yield Finding(f"{source.name}: empty", f"{source.topic}: expected {wanted} of the joint, seen: {seen}")
    if now.get("malformed"):
        yield Finding(
            f"{source.name}: malformed", f"{source.topic}: expected {type_name(source.kind)}, seen unreadable bytes"
        )
    if source.strange_frame:
        yield Finding(
            f"{source.name}: frame",
            f"{source.topic}: expected frame {_quoted(source.first_frame)} as in the first message, "
            f"seen {_quoted(source.strange_frame)}; do two sensors publish on it?",
        )


def motion_findings(inputs: Inputs) -> list[Finding]:
    """Return that the drive moves in the other way than was assumed."""
    velocity = inputs.sources.get("velocity")
    told = inputs.motion.contrary(velocity.last) if velocity is not None else ""
    return [Finding("velocity: other motion", f"{velocity.topic}: {told}")] if velocity is not None and told else []


def _quoted(frame: bytes) -> str:
    return f"'{shown(frame_id(frame), LONGEST_NAME)}'"


def _name(node: Node) -> str:
    return str(node.get_fully_qualified_name())
