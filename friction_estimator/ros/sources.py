"""Input topics: one `Source` a subscription, with what the diagnostics need to know about it.

Messages are taken as bytes and read by the decoder that replay uses, which checks the layout of each.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any

from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from std_msgs.msg import Float64

from friction_estimator.bag.joint_reader import JointPlaces, JointReader
from friction_estimator.bag.messages import EXTRACTORS, Decoder, LayoutError, NoValueError, Want
from friction_estimator.core.intake.pairing import FRICTION, POSITION, STREAMS, VELOCITY
from friction_estimator.core.intake.rhythm import Rhythm
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.groups import InputConfig
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.ros.load import Load
from friction_estimator.ros.motion import Motion, Told
from friction_estimator.ros.quality import input_qos, with_overrides
from friction_estimator.ros.receipt import ReceiptPairing
from friction_estimator.ros.wire import NO_FRAME, frame_in

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

_NOTHING = Struct("<iId")


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
        self.read(raw)

    def read(self, raw: bytes) -> None:
        """Read a message and survive whatever it provokes."""
        try:
            self._read(raw)  # type: ignore[misc] # set before the topic is open
        except NoValueError as error:
            self.absence = shown(error, LONGEST_NAME)
            self.reject(reason_of(self.absence))
        except LayoutError:
            self.reject("malformed")
        except Exception as error:
            self._on_error(f"message on {self.name}", error)


class Inputs:
    """All input topics of one input mode.

    Parameters
    ----------
    node : owner of the subscriptions.
    config : mode, axis and joint.
    feeds : what takes the events: one, or one for each of several joints.
    on_error : takes exceptions.
    on_motion : takes whether the drive is linear or rotary, and why, as soon as it is known.
    load : is told when a message for several joints arrived.
    """

    def __init__(
        self,
        node: Node,
        config: InputConfig,
        feeds: Sequence[Feed],
        on_error: Callable[[str, Exception], None],
        load: Load,
        on_motion: Told,
    ) -> None:
        self._node, self._config, self._feeds, self._on_error = node, config, tuple(feeds), on_error
        self._load = load
        self._several = several = bool(config.joints)  # be it only one that is named so
        self._deliver = self._to_all if several else self._feeds[0].deliver
        self.motion = Motion(node, (lambda *_: None) if several else on_motion)
        """Whether the drive is linear or rotary; each of several joints has its own."""
        self._motions = [Motion(node, feed.moves) for feed in self._feeds] if several else []
        self.frame = NO_FRAME
        """Serialised frame of the last friction message."""
        self.sources: dict[str, Source] = {}
        self._configure_motion()
        self._open()

    def _configure_motion(self) -> None:
        self.motion.configure(self._config)
        for motion, feed in zip(self._motions, self._feeds, strict=False):  # there are none of a single drive
            motion.configure(feed.config())
            motion.joint_is(feed.joint)

    def _wait(self, source: Source, raw: bytes) -> None:
        """Let a message wait until it is known what moves; then read all that waited."""
        self.motion.wait(source.name, raw, source.read)
        if self.motion.known:
            self._open()
            self._read_what_waited()

    def _read_what_waited(self) -> None:
        for read, raw in self.motion.released():
            read(raw)

    def _open(self) -> None:
        """Read every input as the configuration says; what is open stays open."""
        mode = self._config.mode
        if mode == "stamped":
            self._stamped("velocity", TwistStamped, required=True)
            self._stamped("friction", WrenchStamped, required=True)
        elif mode == "joint_state":
            self._joint_states()
        elif "velocity" not in self.sources:  # neither axis nor joint matter to it
            self._float64()
        self._stamped("pressure", FluidPressure)
        self._stamped("temperature", Temperature)
        if self._several:
            self._positions()
        else:
            self._stamped("position", JointState)

    def _to_all(self, stream: int, stamp_ns: int, value: float) -> None:
        """Deliver an event of a channel that all joints share."""
        for feed in self._feeds:
            self._hand(feed, stream, stamp_ns, value)

    def _hand(self, feed: Feed, stream: int, stamp_ns: int, value: float) -> None:
        """Deliver an event to one of several joints; its failure is no other one's."""
        try:
            feed.deliver(stream, stamp_ns, value)
        except Exception as error:
            self._on_error(f"sample of {feed.joint}", error)

    def reconfigure(self, config: InputConfig) -> None:
        """Read by other settings from now on; only a change of the mode closes topics and opens others."""
        former, self._config = self._config, config
        self._configure_motion()
        if config.mode != former.mode:
            for name in [name for name, source in self.sources.items() if source.required]:
                self.sources.pop(name).close()
        self._open()
        self._read_what_waited()

    def expect(self, *, positions: bool) -> None:
        """Expect positions where a velocity of its own topic was expected, or that again (`Pairer.tracks`)."""
        if self._config.mode != "stamped":
            return
        velocity, position = self.sources["velocity"], self.sources["position"]
        wanted = self._config.velocity_from == "position"
        position.required = positions and (wanted or (position.messages > 0 and not velocity.messages))
        velocity.required = not position.required

    @property
    def depth(self) -> int:
        """Messages that the queue of a required input holds."""
        return max(int(source.qos.depth) for source in self.sources.values() if source.required)

    def close(self) -> None:
        """Close all subscriptions."""
        for motion in (self.motion, *self._motions):
            motion.close()
        for source in self.sources.values():
            source.close()

    def _source(self, name: str, kind: type, *, required: bool) -> Source:
        if name not in self.sources:
            self.sources[name] = Source(self._node, name, kind, required, self._on_error)
        return self.sources[name]

    def _decoder(self, kind: type, quantity: str) -> Decoder:
        want = Want(quantity, self._config.axis, self._config.joint, self.motion.known)
        return Decoder(EXTRACTORS[type_name(kind)], want)

    def _stamped(self, name: str, kind: type, *, required: bool = False) -> None:
        source = self._source(name, kind, required=required)
        if required and not self.motion.known:
            source.subscribe(lambda raw: self._wait(source, raw))
            return
        decoder, deliver, stream = self._decoder(kind, name), self._deliver, STREAMS.index(name)
        remember = source.stamps.append
        # The usual message has the length and the frame of the one before: two comparisons and one unpacking.
        length, head, frame_end, unpack = -1, b"", 0, _NOTHING.unpack_from

        def receive(raw: bytes) -> None:
            nonlocal length, head, frame_end, unpack
            if len(raw) == length and raw[12:frame_end] == source.frame and raw[:2] == head:
                seconds, nanoseconds, value = unpack(raw, 4)
                stamp_ns = seconds * NS_PER_S + nanoseconds
            else:
                stamp, value = decoder.one(raw)
                stamp_ns = stamp or 0
                source.seen(frame_in(raw))
                layout = decoder.layout
                if (
                    layout is not None
                    and layout.order == "<"
                    and layout.value_at is not None
                    and kind is not JointState
                ):
                    length, head, frame_end = len(raw), raw[:2], 12 + len(source.frame)
                    unpack = Struct(f"<iI{layout.value_at - 12}xd").unpack_from
            if stream == FRICTION:
                self.frame = source.frame
            remember(stamp_ns)
            deliver(stream, stamp_ns, value)

        source.subscribe(receive)

    def _joint_states(self) -> None:
        source = self._source("joint_states", JointState, required=True)
        feeds, load = self._feeds, self._load
        alone = not self._several
        inputs = [self._config] if alone else [feed.config() for feed in feeds]
        reader = JointReader([each.joint for each in inputs], [each.velocity_from for each in inputs])
        remember, unusual = source.stamps.append, self._on_error
        places: JointPlaces | None = None

        def receive(raw: bytes) -> None:
            nonlocal places
            found = reader.places(raw)
            if found is not places:  # the frame is among what fixes the places
                places = found
                source.seen(frame_in(raw))
                self.frame = source.frame
                if alone and found.joints:
                    self.motion.joint_is(found.joints[0])
            if found.absent:
                if alone:
                    raise NoValueError(found.absent[0][1])
                for number, absence in found.absent:
                    feeds[number].reject(absence)
            numbers = found.unpack(raw)
            stamp_ns = numbers[0] * NS_PER_S + numbers[1]
            remember(stamp_ns)
            load.message()
            for number, position, velocity, effort in found.present:
                deliver = feeds[number].deliver
                try:
                    if position:
                        deliver(POSITION, stamp_ns, numbers[position])
                    if velocity:
                        deliver(VELOCITY, stamp_ns, numbers[velocity])
                    deliver(FRICTION, stamp_ns, numbers[effort])
                except Exception as error:
                    unusual(f"sample of {feeds[number].joint}", error)
            load.message_done()

        source.subscribe(receive)

    def _positions(self) -> None:
        """Read the position of each of several joints from one topic."""
        source = self._source("position", JointState, required=False)
        extractor = EXTRACTORS[type_name(JointState)]
        decoders = [(feed, Decoder(extractor, Want("position", joint=feed.joint))) for feed in self._feeds]

        def receive(raw: bytes) -> None:
            absences, stamp_ns = [], None
            for feed, decoder in decoders:
                try:
                    stamp_ns, value = decoder.one(raw)
                except NoValueError as error:
                    absences.append(error)
                else:
                    self._hand(feed, POSITION, stamp_ns or 0, value)
            if len(absences) == len(decoders):
                raise absences[0]
            source.stamps.append(stamp_ns or 0)
            source.seen(frame_in(raw))

        source.subscribe(receive)

    def _float64(self) -> None:
        """Pair by time of receipt; see `ReceiptPairing`."""
        velocity_source = self._source("velocity", Float64, required=True)
        friction_source = self._source("friction", Float64, required=True)
        read = self._decoder(Float64, "velocity").one
        pairing = ReceiptPairing()

        def deliver(pair: tuple[int, float, float] | None) -> None:
            if pair is not None:
                stamp_ns, velocity, friction = pair
                self._deliver(VELOCITY, stamp_ns, velocity)
                self._deliver(FRICTION, stamp_ns, friction)

        def receive_velocity(raw: bytes) -> None:
            _, value = read(raw)
            velocity_source.stamps.append(time.time_ns())
            deliver(pairing.velocity(velocity_source.stamps[-1], value))

        def receive_friction(raw: bytes) -> None:
            _, value = read(raw)
            friction_source.stamps.append(time.time_ns())
            deliver(pairing.friction(friction_source.stamps[-1], value))
            if pairing.dropped > friction_source.rejected.get("unmatched", 0):
                friction_source.reject("unmatched")

        velocity_source.subscribe(receive_velocity)
        friction_source.subscribe(receive_friction)
