"""One input topic: its subscription, with what the diagnostics need to know about it; and what takes its events."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from friction_estimator.bag.messages import LayoutError, NoValueError
from friction_estimator.core.intake.rhythm import Rhythm
from friction_estimator.core.settings.groups import InputConfig
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.ros.motion import Told
from friction_estimator.ros.quality import input_qos, with_overrides

Deliver = Callable[[int, int, float], None]
"""Takes (stream, stamp in ns, value)."""

REMEMBERED = 64
"""Stamps kept of each input, to measure the offset between two of them."""

MOST_STAMPS = 65_536
"""Stamps kept between two looks at them, once a second: a node that stood still looks later, at more."""

STRANGE_S = 10.0
"""A frame that differs from the first one is told of for this long."""

FRAME_FORGOTTEN_S = 60.0
"""A frame that differs from the first one this long is taken for the new usual one."""


def type_name(kind: type) -> str:
    """Return the ROS name of a message type, such as std_msgs/msg/Float64."""
    return f"{kind.__module__.split('.', maxsplit=1)[0]}/msg/{kind.__name__}"


class Feed:
    """What one estimate takes of the inputs.

    Parameters
    ----------
    joint : its name in JointState messages; empty for the only one.
    deliver : takes its events.
    moves : takes whether one of several joints is linear or rotary, and why.
    config : returns the settings of its inputs.

    Attributes
    ----------
    rejected : messages that did not hold this joint of several, by reason; `absence` is the last one in words.
    """

    def __init__(self, joint: str, deliver: Deliver, moves: Told, config: Callable[[], InputConfig]) -> None:
        self.joint, self.deliver, self.moves, self.config = joint, deliver, moves, config
        self.rejected: dict[str, int] = {}
        self.absence = ""

    def reject(self, absence: str) -> None:
        """Count a message that does not hold the joint; `absence` says why."""
        reason = reason_of(absence)
        self.absence = absence
        self.rejected[reason] = self.rejected.get(reason, 0) + 1


def reason_of(absence: str) -> str:
    """Return under which reason a message without a joint's values is counted."""
    return "wrong_joint" if absence.startswith(("no joint", "several joints")) else "empty"


class Source:
    """One input topic.

    Parameters
    ----------
    node : owner of the subscription.
    name : the input's name and topic.
    kind : message type.
    required : False for optional channels, whose silence is no fault.
    on_error : takes an exception that a callback met.

    Attributes
    ----------
    messages : messages received.
    rejected : messages that held no sample, by reason.
    stamps : of the messages since the last look, ns; `recent` of the last ones before.
    rhythm : what their regularity tells of messages that never came.
    missing : how many those were at the last look.
    fault : why the topic cannot be subscribed to; empty where it is.
    frame : serialised frame_id of the last message; `first_frame` of the first.
    strange_frame : one that differed from the first, lately; else empty.
    last : the last message, as it came.
    absence : why the last message without a sample held none.
    """

    def __init__(
        self, node: Node, name: str, kind: type, required: bool, on_error: Callable[[str, Exception], None]
    ) -> None:
        self.name, self.kind, self.required = name, kind, required
        self.messages = 0
        self.rejected: dict[str, int] = {}
        self.stamps: deque[int] = deque(maxlen=MOST_STAMPS)
        self.recent: deque[int] = deque(maxlen=REMEMBERED)
        self.rhythm, self.missing, self.fault = Rhythm(), 0, ""
        self._read: Callable[[bytes], None] | None = None
        self.last = b""
        self._heard, self._heard_at = 0, 0.0
        self.frame = self.first_frame = b""
        self.absence = ""
        self._looked: dict[str, int] = {}
        self.strange_frame = b""
        self._strange_at, self._usual_until = 0.0, time.monotonic()
        self._on_error = on_error
        self.qos = input_qos()
        self._node = node
        self.subscription: Any = None

    @property
    def topic(self) -> str:
        """The resolved topic name."""
        try:
            return str(self._node.resolve_topic_name(self.name))
        except NameValidationException:
            return self.name

    def subscribe(self, callback: Callable[[bytes], None]) -> None:
        """Read messages by `callback` from now on; open the subscription if it is not open yet.

        Quality-of-service overrides that cannot be used are reported and ignored. Where the middleware refuses the
        topic itself, the input stays silent and `fault` says why.
        """
        self._read = callback
        if self.subscription is not None or self.fault:
            return

        def create(qos: QoSProfile, options: Any) -> Any:
            return self._node.create_subscription(
                self.kind, self.name, self._receive, qos, qos_overriding_options=options, raw=True
            )

        try:
            self.subscription, self.qos = with_overrides(self._node, self.name, input_qos, create)
        except Exception as error:  # a clashing type, a name that rcl refuses
            self.fault = shown(
                f"{self.topic}: cannot be subscribed to as {type_name(self.kind)} ({error}); does another topic of "
                "this node have that name? Correct the remapping and start again"
            )

    def close(self) -> None:
        """Close the subscription."""
        if self.subscription is not None:
            self._node.destroy_subscription(self.subscription)

    def reject(self, reason: str) -> None:
        """Count a message that holds no sample."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def rejected_lately(self) -> dict[str, int]:
        """Return the messages rejected since `looked_at`, by reason."""
        return {reason: count - self._looked.get(reason, 0) for reason, count in self.rejected.items()}

    @property
    def publishers(self) -> int:
        """Publishers of the topic that the graph knows of, one that was killed a moment ago among them."""
        return 0 if self.fault else int(self._node.count_publishers(self.topic))

    def count_missing(self, *, pauses: bool) -> None:
        """Look at the stamps since the last look; see `Rhythm.look`."""
        if self.kind is Float64:  # stamped on receipt
            self.recent.extend(self.stamps)
            self.stamps.clear()
            return
        new = list(self.stamps)
        self.stamps.clear()
        self.recent.extend(new)
        if self.messages - self._heard > MOST_STAMPS:
            self.rhythm.restart()
        self.missing = self.rhythm.look(new, pauses=pauses)

    def looked_at(self) -> float:
        """Begin a new count of late rejections; return the time since messages came, in looks once a second, s.

        A changed frame becomes the expected one after a minute.
        """
        now = time.monotonic()
        if self.messages != self._heard:
            self._heard, self._heard_at = self.messages, now
        self._looked = dict(self.rejected)
        if now - self._usual_until > FRAME_FORGOTTEN_S:
            self.first_frame = self.frame
        if self.frame == self.first_frame:
            self._usual_until = now
        if now - self._strange_at > STRANGE_S:
            self.strange_frame = b""
        return now - self._heard_at

    @property
    def last_stamp_ns(self) -> int:
        """Stamp of the last message read, ns."""
        return self.stamps[-1] if self.stamps else self.recent[-1] if self.recent else 0

    @property
    def last_stamps(self) -> list[int]:
        """Stamps of the last messages, ns."""
        return [*self.recent, *self.stamps][-REMEMBERED:]

    def seen(self, frame: bytes) -> None:
        """Remember the frame of the last message."""
        self.first_frame = self.first_frame or frame
        self.frame = frame
        if frame != self.first_frame:
            self.strange_frame, self._strange_at = frame, time.monotonic()

    def _receive(self, raw: bytes) -> None:
        """Count a message and read it."""
        self.messages += 1
        self.last = raw
        try:  # as `read` does: a call less for every message
            self._read(raw)  # type: ignore[misc] # set before the topic is open
        except Exception as error:
            self._unread(error)

    def read(self, raw: bytes) -> None:
        """Read a message that was counted when it came, and survive whatever it provokes."""
        try:
            self._read(raw)  # type: ignore[misc]
        except Exception as error:
            self._unread(error)

    def _unread(self, error: Exception) -> None:
        """Count, or report, why a message could not be read."""
        if isinstance(error, NoValueError):
            self.absence = shown(error, LONGEST_NAME)
            self.reject(reason_of(self.absence))
        elif isinstance(error, LayoutError):
            self.reject("malformed")
        else:
            self._on_error(f"message on {self.name}", error)
