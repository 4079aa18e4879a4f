"""From a recording to the streams of its inputs, in SI units and in recorded order."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.joint_arrays import CHOOSE_JOINT, holds_a_joint
from friction_estimator.bag.messages import (
    EXTRACTORS,
    INPUTS,
    Decoder,
    LayoutError,
    NoValueError,
    Rows,
    Want,
)
from friction_estimator.bag.motion import recorded_motion
from friction_estimator.bag.source import Source, Topic
from friction_estimator.bag.topics import JOINT_STATE, JOINT_STATES, REQUIRED, Probe, assign
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError
from friction_estimator.core.intake.pairing import LARGEST_VALUE, STREAMS
from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.groups import InputConfig

_TIE_ORDER = ("pressure", "temperature", "position", "velocity", "friction")
"""Order of messages recorded at the same time: what a sample needs comes before what completes it."""

_MOTION = {"auto": ("velocity", "position"), "topic": ("velocity",), "position": ("position",)}
"""What serves as velocity, the better one first, by `input.velocity_from`."""

Progress = Callable[[int, int], None]
"""Takes the messages just read, and how many there are to read in all."""


@dataclass(frozen=True)
class Stream:
    """One input of a recording, in the order of recording.

    Attributes
    ----------
    topic, message_type : where it comes from; the type as ROS writes it (geometry_msgs/msg/TwistStamped).
    stamp_ns : (n,) int64, header stamp; the time of recording where the type has none (`stamped` is False).
    log_time_ns : (n,) int64, time of recording.
    value : (n,) float64, m/s, N, absolute Pa, degC or m; rad/s, N m and rad of a rotary drive.
    frame_id, joint : of the first message; of the value where it is a joint's.
    missing : messages that do not hold the joint's value.
    """

    topic: str
    message_type: str
    stamp_ns: Ints
    log_time_ns: Ints
    value: Floats
    frame_id: str = ""
    joint: str = ""
    missing: int = 0
    stamped: bool = True

    def __len__(self) -> int:
        return int(self.value.size)


@dataclass(frozen=True)
class Events:
    """Messages of all inputs as they were recorded, each (n,): `stream` indexes `pairing.STREAMS`."""

    stream: NDArray[np.int8]
    stamp_ns: Ints
    value: Floats

    def __len__(self) -> int:
        return int(self.value.size)


@dataclass(frozen=True)
class Recording:
    """The inputs of one recording.

    Attributes
    ----------
    path : the recording.
    streams : by input; friction always, velocity or position, pressure, temperature and position where recorded.
    topics : all topics of the recording.
    motion : "linear" or "rotary".
    notes : what is worth telling about the choice of topics, a line each.
    """

    path: Path
    streams: Mapping[str, Stream]
    topics: tuple[Topic, ...]
    motion: str = LINEAR
    notes: tuple[str, ...] = ()

    def events(self) -> Events:
        """Return the messages of all inputs in recorded order: by time of recording, stable.

        At equal times held channels come first, then velocity, then friction.
        """
        names = [name for name in _TIE_ORDER if name in self.streams]
        parts = [self.streams[name] for name in names]
        order = recorded_order(*(part.log_time_ns for part in parts))
        number = [np.full(len(part), STREAMS.index(name), np.int8) for name, part in zip(names, parts, strict=True)]
        return Events(
            np.concatenate(number)[order],
            np.concatenate([part.stamp_ns for part in parts])[order],
            np.concatenate([part.value for part in parts])[order],
        )


def recorded_order(*log_times_ns: Ints) -> NDArray[np.intp]:
    """Return the order that merges streams by time of recording.

    The indices are into the concatenated streams. Ties keep the order of the arguments, and the order within a
    stream.

    >>> recorded_order(np.array([1, 5]), np.array([1, 3])).tolist()
    [0, 2, 3, 1]
    """
    return np.argsort(np.concatenate(log_times_ns), kind="stable")


def read_recording(
    path: str | PurePath,
    config: InputConfig | None = None,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Read the inputs of a recording.

    Parameters
    ----------
    path : ROS 2 recording (folder with metadata.yaml, .mcap or .db3 file) or ROS 1 .bag file.
    config : axis, joint and mode; the defaults unless given.
    topics : topic by input where the user names it (see `topics.assign`).
    progress : is told of every batch read, and of the total before the first.

    Raises
    ------
    InputError : the recording is damaged, or a choice is needed.
    UnanswerableError : it does not hold friction, and a velocity or what one can be made of (`input.velocity_from`).
    """
    config = config or InputConfig()
    with Source(path) as source:
        where = str(source.path)
        chosen = assign(where, source.topics, topics or {}, config.mode, config.velocity_from, probe_of(source, config))
        joint = _joint(source, chosen.topics["friction"], config)
        motion, why = recorded_motion(source, chosen.topics, config, joint)
        builders = {name: _Builder(name, topic, config, motion, source.ros1) for name, topic in chosen.topics.items()}
        counts = {item.topic.name: item.topic.count for item in builders.values()}
        total = sum(counts.values())
        if progress is not None:
            progress(0, total)
        for topic_name, log_time_ns, messages in source.batches(counts):
            for builder in builders.values():
                if builder.topic.name == topic_name:
                    try:
                        builder.add(log_time_ns, messages)
                    except LayoutError as error:
                        raise InputError(
                            f"{where}: a message on {builder.topic.name} is no "
                            f"{builder.topic.message_type.replace('/msg/', '/')}: {error}; "
                            "record it again, or leave the topic out"
                        ) from error
            if progress is not None:
                progress(len(messages), total)
        notes = [*source.notes, *chosen.notes]
        if motion == ROTARY:
            notes.append(f"the drive is rotary: {why}")
        streams: dict[str, Stream] = {}
        failures: dict[str, FrictionEstimatorError] = {}
        for name in INPUTS:
            if name not in builders:
                continue
            try:
                streams[name] = stream = builders[name].stream()
                unusable = int(np.count_nonzero(~(np.abs(stream.value) <= LARGEST_VALUE)))
                if unusable and name not in REQUIRED:
                    notes.append(
                        f"{name}: {unusable} of {len(stream)} values of {stream.topic} are no number, infinite or "
                        "beyond what a sensor reads: they are passed over"
                    )
            except (InputError, UnanswerableError) as error:
                if name in REQUIRED or name in chosen.explicit or config.velocity_from == "position":
                    failures[name] = error
                elif "velocity" not in builders or builders[name].topic != builders["velocity"].topic:
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
        return Recording(source.path, streams, source.topics, motion, tuple(notes))


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


class _Builder:
    """Collects one stream batch by batch."""

    def __init__(self, name: str, topic: Topic, config: InputConfig, motion: str, ros1: bool) -> None:
        self.topic = topic
        self._name, self._joint_named = name, bool(config.joint)
        self._extractor = EXTRACTORS[topic.message_type]
        self._decoder = Decoder(self._extractor, Want(name, config.axis, config.joint, motion), ros1=ros1)
        self._stamps: list[Ints] = []
        self._log_times: list[Ints] = []
        self._values: list[Floats] = []
        self._frame_id: str | None = None

    def add(self, log_time_ns: Ints, messages: Rows | list[bytes]) -> None:
        """Decode a batch. Raises LayoutError."""
        if not len(messages):
            return
        decoded = self._decoder.many(messages)
        if self._frame_id is None:
            self._frame_id = min(self._decoder.frames, default="")
        self._stamps.append((log_time_ns if decoded.stamp_ns is None else decoded.stamp_ns)[decoded.present])
        self._log_times.append(log_time_ns[decoded.present])
        self._values.append(decoded.value[decoded.present])

    def stream(self) -> Stream:
        """Return what was collected, in the order of recording.

        Raises InputError where the joint is not clear, UnanswerableError where there is no value.
        """
        topic, absences = self.topic, self._decoder.absences
        joints = sorted(self._decoder.joints)
        if len(joints) > 1:
            raise InputError(f"{topic} holds several joints ({', '.join(joints)}): {CHOOSE_JOINT}")
        value = np.concatenate(self._values) if self._values else np.zeros(0)
        choice = [reason for reason in absences if reason.endswith(CHOOSE_JOINT)]
        if choice and not (value.size and self._joint_named):
            raise InputError(f"{topic} gives no {self._name}: {choice[0]}")
        if not value.size:
            reason = absences.most_common(1)[0][0] if absences else "no messages"
            raise UnanswerableError(f"{topic} gives no {self._name}: {reason}")
        log_time_ns, stamp_ns = np.concatenate(self._log_times), np.concatenate(self._stamps)
        if np.any(np.diff(log_time_ns) < 0):
            order = recorded_order(log_time_ns)
            log_time_ns, stamp_ns, value = log_time_ns[order], stamp_ns[order], value[order]
        return Stream(
            topic=topic.name,
            message_type=topic.message_type,
            stamp_ns=stamp_ns,
            log_time_ns=log_time_ns,
            value=value,
            frame_id=self._frame_id or "",
            joint="".join(joints),
            missing=absences.total(),
            stamped=self._extractor.stamped,
        )
