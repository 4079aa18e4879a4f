"""Input topics of the node: which there are, and how each message becomes events.

Messages are taken as bytes and read by the decoder that replay uses, which checks the layout of each.
"""

import time
from collections.abc import Callable, Sequence
from struct import Struct

from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from std_msgs.msg import Float64

from friction_estimator.bag.joint_reader import JointPlaces, JointReader
from friction_estimator.bag.messages import EXTRACTORS, Decoder, NoValueError, Want
from friction_estimator.core.intake.pairing import FRICTION, POSITION, STREAMS, VELOCITY
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.groups import InputConfig
from friction_estimator.ros.load import Load
from friction_estimator.ros.motion import Motion, Told
from friction_estimator.ros.receipt import ReceiptPairing
from friction_estimator.ros.source import Feed, Source, type_name
from friction_estimator.ros.wire import NO_FRAME, frame_in

_NOTHING = Struct("<iId")


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
        frame_end = 0

        def receive(raw: bytes) -> None:
            nonlocal places, frame_end
            found = reader.places(raw)
            if raw[12:frame_end] != source.frame or found is not places:
                places = found
                source.seen(frame_in(raw))
                self.frame, frame_end = source.frame, 12 + len(source.frame)
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
