"""Which topic of a recording is which input.

In this order: the topic named by the user; the only topic of a readable type whose last name part is the input's
name; the only topic of a type that is typical of the input. Velocity and friction may both come from one
JointState topic instead, `/joint_states` before others. Where several topics could be meant, those whose first message
does not hold the value drop out; what is still ambiguous is asked back, never guessed.
"""

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from friction_estimator.bag.messages import EXTRACTORS, INPUTS
from friction_estimator.bag.source import Topic
from friction_estimator.core.errors import InputError, UnanswerableError

JOINT_STATES = "joint_states"
JOINT_STATE = "sensor_msgs/msg/JointState"

USUAL = "/joint_states"
"""Where a robot publishes its joints: preferred among several JointState topics."""

REQUIRED = ("velocity", "friction")
OPTIONAL = ("pressure", "temperature", "position")

OWN_OUTPUTS = ("friction_predicted", "residual")
"""Last name parts of what the estimator writes; such a topic is an input only when the user says so."""

Probe = Callable[[str, Topic], str]
"""Takes an input and a topic; returns why the topic's first message does not hold the input, "" where it does."""

_LISTED = 12


@dataclass(frozen=True)
class Assignment:
    """The topic of each input found, and what is worth telling about it."""

    topics: dict[str, Topic]
    notes: tuple[str, ...]
    explicit: frozenset[str]  # inputs that the user named


def assign(
    where: str,
    topics: Iterable[Topic],
    named: Mapping[str, str],
    mode: str = "stamped",
    velocity_from: str = "auto",
    probe: Probe = lambda name, topic: "",  # noqa: ARG005
) -> Assignment:
    """Choose the topic of every input.

    Parameters
    ----------
    where : the recording, for messages.
    topics : its topics.
    named : topic by input, as the user gave them (`joint_states` among the inputs).
    mode : `input.mode`; "joint_state" takes velocity and friction from a JointState topic only.
    velocity_from : `input.velocity_from`; unless it is "topic", a position does for the velocity.
    probe : looks into topics that compete.

    Raises
    ------
    InputError where a named topic is not there or of no use, or where several could be meant;
    UnanswerableError where the recording has no topic for the velocity or the friction.
    """
    chooser = _Chooser(where, tuple(topics), probe)
    found = {name: chooser.named(name, topic) for name, topic in named.items()}
    joints = found.pop(JOINT_STATES, None)
    notes = []
    required = REQUIRED if velocity_from != "position" else ("position", "friction")
    if joints is None and mode == "joint_state":
        joints = chooser.joints("input.mode joint_state")
    if joints is None:
        stamped = {name: found.get(name) or chooser.unnamed(name) for name in required}
        missing = [name for name, topic in stamped.items() if topic is None]
        if missing:
            joints = None if set(required) & set(named) else chooser.unnamed(JOINT_STATES)
            position = None
            if joints is None and missing == ["velocity"] and velocity_from == "auto":
                position = stamped["position"] = found.get("position") or chooser.unnamed("position")
            if joints is None and position is None:
                raise UnanswerableError(
                    f"{where} has no topic for {' or '.join(missing)}: it has {chooser.listing()}; "
                    f"name one with --topic {missing[0]}=TOPIC, or use --topic joint_states=TOPIC --joint NAME"
                )
            if joints is not None:
                notes.append(
                    f"no topic for {' or '.join(missing)}: {required[0]} and effort of {joints.name} are used; "
                    "an effort holds inertia and gravity too"
                )
        found |= {name: topic for name, topic in stamped.items() if topic is not None}
    if joints is not None:
        found |= {name: joints for name in required if name not in named}
    if velocity_from == "position":
        found.pop("velocity", None)
    for name in OPTIONAL:
        if name in found:
            continue
        try:
            by_type = joints is None or name != "position"  # one JointState topic holds everything of its joint
            topic = chooser.unnamed(name, by_type=by_type)
        except (InputError, UnanswerableError) as error:
            notes.append(f"no {name} is used: {str(error).removeprefix(f'{where}: ')}")
            continue
        topic = topic or (joints if name == "position" else None)
        if topic is not None:
            found[name] = topic
    return Assignment(found, tuple(notes), frozenset(named))


def joint_topic(where: str, topics: Iterable[Topic], named: Mapping[str, str], probe: Probe) -> Topic:
    """Choose the JointState topic of which all joints are wanted; parameters and failures as those of `assign`."""
    chooser = _Chooser(where, tuple(topics), probe)
    if JOINT_STATES in named:
        return chooser.named(JOINT_STATES, named[JOINT_STATES])
    return chooser.joints("--joint all")


class _Chooser:
    """Finds topics by name and by type."""

    def __init__(self, where: str, topics: tuple[Topic, ...], probe: Probe) -> None:
        self._where, self._topics, self._probe = where, topics, probe

    def named(self, name: str, topic_name: str) -> Topic:
        """Return the topic that the user named for an input."""
        by_name = {topic.name: topic for topic in self._topics}
        topic = by_name.get(topic_name) or by_name.get(f"/{topic_name}")
        if topic is None:
            near = difflib.get_close_matches(topic_name, by_name, n=1)
            hint = f"nearest: {near[0]}" if near else f"it has {self.listing()}"
            raise InputError(f"{self._where} has no topic {topic_name} (--topic {name}={topic_name}); {hint}")
        if not self._readable(name, topic):
            raise InputError(f"{self._where}: {topic} cannot be read as {name}; {_readable_types(name)} can")
        return topic

    def joints(self, purpose: str) -> Topic:
        """Return the JointState topic that serves a purpose; raises as `unnamed`, and where there is none."""
        topic = self.unnamed(JOINT_STATES)
        if topic is None:
            raise UnanswerableError(f"{self._where} has no JointState topic for {purpose}; it has {self.listing()}")
        return topic

    def unnamed(self, name: str, *, by_type: bool = True) -> Topic | None:
        """Return the topic that its name, or else its type, makes an input; None where there is none.

        Raises InputError where several could be meant, UnanswerableError where none of several holds it.
        """
        usable = [topic for topic in self._topics if topic.count and self._readable(name, topic)]
        named_so = [topic for topic in usable if _last(topic) == name]
        typical = [topic for topic in usable if by_type and self._typical(name, topic)]
        if name == JOINT_STATES and len(named_so) == 1 < len(typical) and self._probe(name, named_so[0]):
            named_so = []  # joint_states without efforts, beside the state of a drive that measures them
        for candidates in (named_so, typical):
            if len(candidates) == 1:
                return candidates[0]
            if candidates:
                return self._only(name, candidates)
        return None

    def _only(self, name: str, candidates: list[Topic]) -> Topic:
        """Return the only one of several topics that holds an input."""
        reasons = [self._probe(name, topic) for topic in candidates]
        able = [topic for topic, reason in zip(candidates, reasons, strict=True) if not reason]
        usual = [topic for topic in able if name == JOINT_STATES and topic.name == USUAL]
        if len(able) == 1 or usual:
            return (usual or able)[0]
        if not able:
            told = "; ".join(f"{topic}: {reason}" for topic, reason in zip(candidates, reasons, strict=True))
            raise UnanswerableError(f"{self._where} has no {name} that can be used: {told}")
        raise InputError(
            f"{self._where}: {name} could be {' or '.join(map(str, able[:_LISTED]))}; "
            f"choose with --topic {name}={able[0].name}"
        )

    def listing(self) -> str:
        """Return the topics in words."""
        texts = [str(topic) for topic in self._topics[:_LISTED]]
        more = len(self._topics) - len(texts)
        return (", ".join(texts) + (f" and {more} more" if more else "")) or "no topics at all"

    @staticmethod
    def _readable(name: str, topic: Topic) -> bool:
        kind = topic.message_type
        if name == JOINT_STATES:
            return kind == JOINT_STATE
        return kind in EXTRACTORS and name in EXTRACTORS[kind].feeds

    @staticmethod
    def _typical(name: str, topic: Topic) -> bool:
        last = _last(topic)
        if last in OWN_OUTPUTS or (last != name and last in INPUTS):
            return False
        return name == JOINT_STATES or name in EXTRACTORS[topic.message_type].typical_of


def _last(topic: Topic) -> str:
    return topic.name.rsplit("/", 1)[-1]


def _readable_types(name: str) -> str:
    if name == JOINT_STATES:
        return JOINT_STATE.replace("/msg/", "/")
    kinds = (kind.replace("/msg/", "/") for kind, entry in EXTRACTORS.items() if name in entry.feeds)
    return ", ".join(kinds)
