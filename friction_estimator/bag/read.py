"""From a recording to the streams of its inputs, in SI units and in recorded order: whole, or piece by piece."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path, PurePath

import numpy as np

from friction_estimator.bag.batches import ANYTHING_BEHIND, NOTHING_BEHIND
from friction_estimator.bag.joint_arrays import CHOOSE_JOINT, holds_a_joint
from friction_estimator.bag.merge import Events, Merge, Part, in_order, joined, recorded_order
from friction_estimator.bag.messages import (
    EXTRACTORS,
    INPUTS,
    Decoder,
    LayoutError,
    Messages,
    NoValueError,
    Want,
)
from friction_estimator.bag.motion import recorded_motion
from friction_estimator.bag.recording import Heard, Outline, Recorded, Recording, Stream
from friction_estimator.bag.source import Source, Topic
from friction_estimator.bag.topics import JOINT_STATE, JOINT_STATES, REQUIRED, Assignment, Probe, assign
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError
from friction_estimator.core.growing import Column
from friction_estimator.core.intake.pairing import LARGEST_VALUE
from friction_estimator.core.quantities import ROTARY
from friction_estimator.core.sample import Ints
from friction_estimator.core.settings.groups import InputConfig

_MOTION = {"auto": ("velocity", "position"), "topic": ("velocity",), "position": ("position",)}
"""What serves as velocity, the better one first, by `input.velocity_from`."""

GATHERED = 32768
"""Messages that are merged at a time, at least: chunks of a file have a few thousand."""

Progress = Callable[[int, int], None]
"""Takes the messages just read, and how many there are to read in all."""


def read_recording(
    path: str | PurePath | Source,
    config: InputConfig | None = None,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Read the inputs of a recording.

    Parameters
    ----------
    path : ROS 2 recording (folder with metadata.yaml, .mcap or .db3 file) or ROS 1 .bag file, open or not.
    config : axis, joint and mode; the defaults unless given.
    topics : topic by input where the user names it (see `topics.assign`).
    progress : is told of every batch read, and of the total before the first.

    Raises
    ------
    InputError : the recording is damaged, or a choice is needed.
    UnanswerableError : it does not hold friction, and a velocity or what one can be made of (`input.velocity_from`).
    """
    with Reading(path, config, topics, progress) as reading:
        parts: dict[str, list[Part]] = {name: [] for name in reading.names}
        for name, part, _ in reading.parts():
            parts[name].append(part)
        outline = reading.outline()
    streams = {}
    for name, heard in outline.streams.items():
        part = joined(parts.pop(name))
        if not in_order(part.log_time_ns):
            order = recorded_order(part.log_time_ns)
            part = Part(part.stamp_ns[order], part.log_time_ns[order], part.value[order])
        numbers = part.stamp_ns, part.log_time_ns, part.value
        streams[name] = Stream(
            heard.topic,
            heard.message_type,
            *numbers,
            frame_id=heard.frame_id,
            joint=heard.joint,
            missing=heard.missing,
            stamped=heard.stamped,
        )
    return Recording(outline.path, streams, outline.topics, outline.motion, outline.notes)


def times_of(recording: Recorded, name: str) -> tuple[Ints, Ints]:
    """Return stamps and times of recording of an input, ns, (n,) each, in recorded order.

    They are read again where the numbers were not kept; the values are not kept then either.
    """
    if not isinstance(recording, Outline):
        stream = recording.whole().streams[name]
        return stream.stamp_ns, stream.log_time_ns
    stamps, log_times = Column(np.int64), Column(np.int64)
    with Reading(recording.path, recording.config, recording.asked) as reading:
        for own, part, _ in reading.parts():
            if own == name:
                stamps.extend(part.stamp_ns)
                log_times.extend(part.log_time_ns)
    stamp_ns, log_time_ns = stamps.taken(), log_times.taken()
    if in_order(log_time_ns):
        return stamp_ns, log_time_ns
    order = recorded_order(log_time_ns)
    return stamp_ns[order], log_time_ns[order]


class Reading:
    """The inputs of a recording while they are read (context manager); parameters and errors of `read_recording`."""

    def __init__(
        self,
        path: str | PurePath | Source,
        config: InputConfig | None = None,
        topics: Mapping[str, str] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._config = config or InputConfig()
        self._progress = progress or (lambda _read, _total: None)
        self._asked = dict(topics or {})
        with ExitStack() as stack:
            self._source = stack.enter_context(Source.opened(path))
            self._again = partial(read_recording, self._source.path, config, topics)
            self._choose()
            self._stack = stack.pop_all()

    def _choose(self) -> None:
        source, config = self._source, self._config
        probe = probe_of(source, config)
        self._chosen = assign(str(source.path), source.topics, self._asked, config.mode, config.velocity_from, probe)
        joint = _joint(source, self._chosen.topics["friction"], config)
        self.motion, self._why_motion = recorded_motion(source, self._chosen.topics, config, joint)
        self._listeners = {
            name: _Listener(name, topic, config, self.motion, source.ros1)
            for name, topic in self._chosen.topics.items()
        }

    def __enter__(self) -> "Reading":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def path(self) -> Path:
        """The recording."""
        return self._source.path

    @property
    def names(self) -> list[str]:
        """The inputs that topics were found for."""
        return list(self._listeners)

    @property
    def topics(self) -> Mapping[str, Topic]:
        """The topic of each of them."""
        return self._chosen.topics

    def parts(self) -> Iterator[tuple[str, Part, int]]:
        """Yield the messages of the inputs batch by batch, in the order of the file.

        With each comes a time of recording, ns, before which nothing is behind it (`Source.timed_batches`).
        """
        counts = {one.topic.name: one.topic.count for one in self._listeners.values()}
        total = sum(counts.values())
        self._progress(0, total)
        for (topic, log_time_ns, messages), behind_ns in self._source.timed_batches(counts):
            own = [name for name, one in self._listeners.items() if one.topic.name == topic]
            for left, name in zip(range(len(own) - 1, -1, -1), own, strict=True):
                # A JointState is several inputs: those behind come at the same times.
                safe_ns = min(behind_ns, int(log_time_ns.min())) if left and log_time_ns.size else behind_ns
                yield name, self._heard(self._listeners[name], log_time_ns, messages), safe_ns
            self._progress(len(messages), total)

    def events(self) -> Iterator[Events]:
        """Yield the messages of all inputs in recorded order, as soon as nothing earlier can come.

        Raises OutOfOrderError where the recording holds earlier messages than it says: it has to be read whole.
        """
        merge = Merge(self.names)
        handed_on_ns = ANYTHING_BEHIND
        for name, part, behind_ns in self.parts():
            merge.add(name, part)
            if behind_ns > handed_on_ns and merge.count >= GATHERED:
                handed_on_ns = behind_ns
                yield merge.before(behind_ns)
        yield merge.before(NOTHING_BEHIND)

    def _heard(self, listener: "_Listener", log_time_ns: Ints, messages: Messages) -> Part:
        try:
            return listener.part(log_time_ns, messages)
        except LayoutError as error:
            raise InputError(
                f"{self.path}: a message on {listener.topic.name} is no "
                f"{listener.topic.message_type.replace('/msg/', '/')}: {error}; "
                "record it again, or leave the topic out"
            ) from error

    def outline(self) -> Outline:
        """Return what was found, once all of it was read. Raises as `read_recording`."""
        notes = [*self._source.notes, *self._chosen.notes]
        if self.motion == ROTARY:
            notes.append(f"the drive is rotary: {self._why_motion}")
        streams, more = _concluded(str(self.path), self._listeners, self._chosen, self._config)
        told = (*notes, *more)
        how = self._config, self._asked, self._again
        return Outline(self.path, streams, self._source.topics, self.motion, told, *how)


def _concluded(
    where: str, listeners: "Mapping[str, _Listener]", chosen: Assignment, config: InputConfig
) -> tuple[dict[str, Heard], list[str]]:
    """Return the inputs that hold values, and notes on the others. Raises as `read_recording`."""
    notes: list[str] = []
    streams: dict[str, Heard] = {}
    failures: dict[str, FrictionEstimatorError] = {}
    for name in INPUTS:
        if name not in listeners:
            continue
        try:
            streams[name] = heard = listeners[name].heard()
            if heard.unusable and name not in REQUIRED:
                notes.append(
                    f"{name}: {heard.unusable} of {len(heard)} values of {heard.topic} are no number, infinite or "
                    "beyond what a sensor reads: they are passed over"
                )
        except (InputError, UnanswerableError) as error:
            if name in REQUIRED or name in chosen.explicit or config.velocity_from == "position":
                failures[name] = error
            elif "velocity" not in listeners or listeners[name].topic != listeners["velocity"].topic:
                notes.append(f"no {name} is used: {error}")
    if "position" in streams and "velocity" not in chosen.explicit and config.velocity_from == "auto":
        failures.pop("velocity", None)
    if failures:
        # A joint that is not there lacks both of its values: once is enough.
        first, *others = failures.values()
        told = [first] if str(first).endswith(CHOOSE_JOINT) else [first, *others]
        raise type(first)(f"{where}: {'; '.join(map(str, told))}")
    if "velocity" not in streams:
        notes.append(
            "no velocity: a tracking filter makes it of the position, without delay at constant acceleration "
            "(input.velocity_from)"
        )
    return streams, notes


def probe_of(source: Source, config: InputConfig) -> Probe:
    """Return a function that says why a topic's first message does not hold an input, or "".

    Where no joint is named, a JointState topic holds velocity and effort if it does so for any joint.
    """

    def why_not(name: str, topic: Topic) -> str:
        raw = source.first(topic.name)
        if raw is None:
            return "no messages"
        motion = _MOTION[config.velocity_from]
        if name == JOINT_STATES and not config.joint and holds_a_joint(raw, motion, ros1=source.ros1):
            return ""

        def lacks(quantity: str) -> str:
            want = Want(quantity, config.axis, config.joint)
            try:
                Decoder(EXTRACTORS[topic.message_type], want, ros1=source.ros1).one(raw)
            except (LayoutError, NoValueError) as error:
                return f"no {quantity}, {error}"
            return ""

        if name != JOINT_STATES:
            return lacks(name)
        without = [lacks(quantity) for quantity in motion]
        return "; ".join(filter(None, (without[0] if all(without) else "", lacks("friction"))))

    return why_not


def _joint(source: Source, topic: Topic, config: InputConfig) -> str | None:
    """Return whose effort a topic holds, "" where that is not clear; None where it is no joint's."""
    raw = source.first(topic.name)
    if topic.message_type != JOINT_STATE or raw is None:
        return None
    decoder = Decoder(EXTRACTORS[topic.message_type], Want("friction", config.axis, config.joint), ros1=source.ros1)
    with suppress(LayoutError, NoValueError):  # told when it is read
        decoder.one(raw)
    return min(decoder.joints, default=config.joint)


class _Listener:
    """Takes one input out of the batches of its topic, and keeps account of it."""

    def __init__(self, name: str, topic: Topic, config: InputConfig, motion: str, ros1: bool) -> None:
        self.topic = topic
        self._name, self._joint_named = name, bool(config.joint)
        self._extractor = EXTRACTORS[topic.message_type]
        self._decoder = Decoder(self._extractor, Want(name, config.axis, config.joint, motion), ros1=ros1)
        self._messages = self._unusable = 0

    def part(self, log_time_ns: Ints, messages: Messages) -> Part:
        """Return the numbers of a batch. Raises LayoutError."""
        decoded = self._decoder.many(messages)
        part = Part(log_time_ns if decoded.stamp_ns is None else decoded.stamp_ns, log_time_ns, decoded.value)
        if not decoded.present.all():
            part = part.where(decoded.present)
        self._messages += len(part)
        self._unusable += int(np.count_nonzero(~(np.abs(part.value) <= LARGEST_VALUE)))
        return part

    def heard(self) -> Heard:
        """Return what was found.

        Raises InputError where the joint is not clear, UnanswerableError where there is no value.
        """
        topic, absences = self.topic, self._decoder.absences
        joints = sorted(self._decoder.joints)
        if len(joints) > 1:
            raise InputError(f"{topic} holds several joints ({', '.join(joints)}): {CHOOSE_JOINT}")
        choice = [reason for reason in absences if reason.endswith(CHOOSE_JOINT)]
        if choice and not (self._messages and self._joint_named):
            raise InputError(f"{topic} gives no {self._name}: {choice[0]}")
        if not self._messages:
            reason = absences.most_common(1)[0][0] if absences else "no messages"
            raise UnanswerableError(f"{topic} gives no {self._name}: {reason}")
        return Heard(
            topic=topic.name,
            message_type=topic.message_type,
            messages=self._messages,
            frame_id=self._decoder.frame_id or "",
            joint="".join(joints),
            missing=absences.total(),
            stamped=self._extractor.stamped,
            unusable=self._unusable,
        )
