"""What the JointState topics of a recording hold, joint by joint, before anything is chosen."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from friction_estimator.bag.joint_arrays import LABELS, JointArrays
from friction_estimator.bag.layout import Cursor, Layout, LayoutError, NoValueError
from friction_estimator.bag.messages import Rows, by_layout, stamps_of
from friction_estimator.bag.read import Progress, probe_of
from friction_estimator.bag.source import Source, Topic
from friction_estimator.bag.topics import JOINT_STATE, joint_topic
from friction_estimator.core.errors import InputError, UnanswerableError
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.sample import NS_PER_S, Floats, Ints
from friction_estimator.core.settings.groups import InputConfig

MOST_JOINTS = 1000
"""Joints of a topic, and sets of them, that are told apart: no machine has more, and a file could name any number."""


@dataclass
class Quantity:
    """Values of one joint's position, velocity or effort over a recording, SI units.

    Attributes
    ----------
    values : messages that hold one.
    nan, infinite : of these, no number; beyond what a sensor reads.
    lowest, highest : of the others; NaN where there is none.
    absent : messages of the joint without a value, by reason.
    """

    values: int = 0
    nan: int = 0
    infinite: int = 0
    lowest: float = float("nan")
    highest: float = float("nan")
    absent: Counter[str] = field(default_factory=Counter)

    def add(self, value: Floats) -> None:
        """Take values, (n,)."""
        nan, usable = np.isnan(value), np.abs(value) <= LARGEST_VALUE
        self.values += value.size
        self.nan += int(np.count_nonzero(nan))
        self.infinite += value.size - int(np.count_nonzero(nan | usable))
        if usable.any():
            self.lowest = float(np.fmin(self.lowest, value[usable].min()))
            self.highest = float(np.fmax(self.highest, value[usable].max()))


@dataclass
class Joint:
    """One joint of a topic.

    Attributes
    ----------
    messages : that name it; `named_twice` of these name it more than once: the first place counts.
    rate_hz : reciprocal of the median period of those messages, NaN for less than two.
    quantities : by input, as in `LABELS`.
    """

    messages: int = 0
    named_twice: int = 0
    rate_hz: float = float("nan")
    quantities: dict[str, Quantity] = field(default_factory=lambda: {name: Quantity() for name in LABELS})

    @property
    def problem(self) -> str:
        """Why no sample of the joint can be used; empty where some can."""
        alone = self.quantities["position"].values and not self.quantities["velocity"].values
        motion = "position" if alone else "velocity"
        for quantity in (motion, "friction"):
            found, label = self.quantities[quantity], LABELS[quantity]
            if not found.values:
                return found.absent.most_common(1)[0][0] if found.absent else f"no {label}"
            if found.nan == found.values:
                return f"{label} is NaN throughout"
            if found.nan + found.infinite == found.values:
                return f"{label} is no usable number throughout"
        return ""


@dataclass
class JointTopic:
    """The joints of one JointState topic, in the order in which they were first named.

    `unnamed` are messages without joint names, by what is in them; `unlisted` counts names beyond `MOST_JOINTS`.
    `fault` says why a message could not be read: what is behind it was not looked at.
    """

    topic: Topic
    joints: dict[str, Joint] = field(default_factory=dict)
    unnamed: Counter[str] = field(default_factory=Counter)
    unlisted: int = 0
    fault: str = ""


def survey(source: Source, topics: Sequence[Topic] | None = None, progress: Progress | None = None) -> list[JointTopic]:
    """Return what the JointState topics of a recording hold: all of them, or `topics`.

    Raises InputError where the recording is damaged; bytes that are no JointState are their topic's `fault`.
    """
    chosen = [topic for topic in source.topics if topic.message_type == JOINT_STATE] if topics is None else list(topics)
    surveys = {topic.name: _Survey(topic, ros1=source.ros1) for topic in chosen if topic.count}
    total = sum(topic.count for topic in chosen)
    for name, log_time_ns, messages in source.batches(surveys) if surveys else ():
        surveys[name].add(messages)
        if progress is not None:
            progress(log_time_ns.size, total)
    return [each.result() for each in surveys.values()]


def joint_names(
    path: str, config: InputConfig, topics: Mapping[str, str], progress: Progress | None = None
) -> list[str]:
    """Return the joints of the recording's one JointState topic in question, in the order in which they were named.

    Parameters
    ----------
    config : its `joints`, where there are some, are returned as they are.
    topics : `joint_states` where the user names it.

    Raises UnanswerableError where there is no such topic or no joint in it, InputError where several topics could be
    meant.
    """
    with Source(path) as source:
        where = str(source.path)
        topic = joint_topic(where, source.topics, topics, probe_of(source, config))
        if config.joints:
            return list(config.joints)
        (found,) = survey(source, [topic], progress)
        joints = list(found.joints)
        if found.fault:
            raise InputError(
                f"{where}: a message on {topic.name} is no sensor_msgs/JointState: {found.fault}; record it again"
            )
        if not joints:
            raise UnanswerableError(f"{where}: {topic} names no joint; let the driver set JointState.name")
        return joints


class _Survey:
    """Looks at one topic batch by batch; only stamps are kept."""

    def __init__(self, topic: Topic, *, ros1: bool) -> None:
        self._found, self._ros1 = JointTopic(topic), ros1
        self._stamps: dict[tuple[str, ...], list[Ints]] = {}
        self._walked: tuple[Layout, JointArrays] | None = None

    def add(self, messages: Rows | list[bytes]) -> None:
        """Take a batch."""
        if self._found.fault:
            return
        try:
            for _, rows, _ in by_layout(messages, self._layout_of):
                assert self._walked is not None
                self._look(rows, *self._walked)
        except LayoutError as error:
            self._found.fault = str(error)

    def _layout_of(self, raw: bytes) -> Layout:
        if self._walked is None or not self._walked[0].fits(raw):
            cursor = Cursor(raw, ros1=self._ros1)
            arrays = JointArrays.walk(cursor)
            self._walked = cursor.layout(None), arrays
        return self._walked[0]

    def _look(self, rows: Rows, layout: Layout, arrays: JointArrays) -> None:
        count = rows.shape[0]
        if not arrays.names:
            held = [f"{arrays.counts[quantity]} of {label}" for quantity, label in LABELS.items()]
            self._found.unnamed[", ".join(held)] += count
            return
        if arrays.names in self._stamps or len(self._stamps) < MOST_JOINTS:
            self._stamps.setdefault(arrays.names, []).append(stamps_of(rows, layout))
        columns = {quantity: _columns(rows, layout, arrays, quantity) for quantity in LABELS}
        for name in dict.fromkeys(arrays.names):
            if name not in self._found.joints and len(self._found.joints) >= MOST_JOINTS:
                self._found.unlisted += 1
                continue
            joint = self._found.joints.setdefault(name, Joint())
            joint.messages += count
            joint.named_twice += count * (arrays.names.count(name) > 1)
            for quantity, values in columns.items():
                try:
                    joint.quantities[quantity].add(values[:, arrays.index(name, quantity)])
                except NoValueError as error:
                    joint.quantities[quantity].absent[str(error)] += count

    def result(self) -> JointTopic:
        """Return what was found, with the rates."""
        stamps = {names: np.concatenate(parts) for names, parts in self._stamps.items()}
        rates: dict[tuple[tuple[str, ...], ...], float] = {}
        for name, joint in self._found.joints.items():
            groups = tuple(names for names in stamps if name in names)
            if groups not in rates:
                rates[groups] = _rate_hz(np.concatenate([np.zeros(0, np.int64), *(stamps[names] for names in groups)]))
            joint.rate_hz = rates[groups]
        return self._found


def _columns(rows: Rows, layout: Layout, arrays: JointArrays, quantity: str) -> Floats:
    """Return the values of a quantity, (messages, values)."""
    start, count = arrays.starts[quantity], arrays.counts[quantity]
    part = np.ascontiguousarray(rows[:, start : start + 8 * count])
    return np.asarray(part.view(np.dtype(f"{layout.order}f8")).reshape(rows.shape[0], count), np.float64)


def _rate_hz(stamp_ns: Ints) -> float:
    step = np.diff(np.sort(stamp_ns[stamp_ns != 0]))
    forward = step[step > 0]
    return float(NS_PER_S / np.median(forward)) if forward.size else float("nan")
