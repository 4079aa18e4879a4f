"""What is known of a recording: its inputs with their numbers, or without."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from friction_estimator.bag.merge import Events, Part, merged
from friction_estimator.bag.source import Topic
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.groups import InputConfig


@dataclass(frozen=True)
class Heard:
    """What is known of one input of a recording without its numbers.

    Attributes
    ----------
    topic, message_type : where it comes from; the type as ROS writes it (geometry_msgs/msg/TwistStamped).
    messages : that hold its value.
    frame_id, joint : of the first message; of the value where it is a joint's.
    missing : messages that do not hold the joint's value.
    stamped : whether the type has a header; else the time of recording stands for the stamp.
    unusable : values that are no number, infinite or beyond what a sensor reads.
    """

    topic: str
    message_type: str
    messages: int
    frame_id: str = ""
    joint: str = ""
    missing: int = 0
    stamped: bool = True
    unusable: int = 0

    def __len__(self) -> int:
        return self.messages


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
        parts = {name: Part(one.stamp_ns, one.log_time_ns, one.value) for name, one in self.streams.items()}
        return merged(parts)

    def whole(self) -> "Recording":
        """Return itself: its numbers are here."""
        return self


@dataclass(frozen=True)
class Outline:
    """A recording whose numbers were read and not kept.

    Attributes
    ----------
    streams : what was found. config, asked : how it was read: the inputs, and the topics that the user named.
    again : reads it with its numbers.
    """

    path: Path
    streams: Mapping[str, Heard]
    topics: tuple[Topic, ...]
    motion: str
    notes: tuple[str, ...]
    config: InputConfig
    asked: Mapping[str, str]
    again: Callable[[], Recording]

    def whole(self) -> Recording:
        """Return the recording with its numbers, read again."""
        return self.again()


class Described(Protocol):
    """An input of a recording, with its numbers or without."""

    @property
    def topic(self) -> str:
        """Where it comes from."""

    @property
    def message_type(self) -> str:
        """As ROS writes it."""

    @property
    def joint(self) -> str:
        """Whose value it is, where it is a joint's."""

    @property
    def frame_id(self) -> str:
        """Of the first message."""

    @property
    def missing(self) -> int:
        """Messages without its value."""

    @property
    def stamped(self) -> bool:
        """Whether the type has a header."""

    def __len__(self) -> int: ...


class Recorded(Protocol):
    """A recording, whose numbers are here or can be read again."""

    @property
    def path(self) -> Path:
        """Where it is."""

    @property
    def streams(self) -> Mapping[str, Described]:
        """By input."""

    @property
    def motion(self) -> str:
        """Linear or rotary."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth telling."""

    def whole(self) -> Recording:
        """Return it with its numbers."""
