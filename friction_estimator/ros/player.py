"""Publish a recording, where `ros2 bag play` is not installed, without losing a message at either end.

Messages go out as the bytes that were recorded, reliably. The first one waits until every subscriber that the graph
knows of is matched, the last one until all subscribers have acknowledged everything. Its name and services are those of
rosbag2's player (`player_services`).
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from types import TracebackType

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from friction_estimator.bag.source import Source, Topic
from friction_estimator.core.errors import InputError, UnanswerableError, sentence
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.ros.playback_clock import PlaybackClock
from friction_estimator.ros.playback_control import FASTEST, PlaybackControl, Turn
from friction_estimator.ros.player_services import NODE_NAME, PlayerServices

DEPTH = 10_000
"""Messages kept a topic until they are acknowledged."""

SETTLED_S = 3.5
"""Subscribers count as complete when none was added for so long: DDS participants announce themselves every 3 s, and
on a busy machine one whose first announcements went unheard appears only then."""

ACKNOWLEDGE_S = 30.0


@dataclass(frozen=True)
class Playback:
    """How to play.

    Attributes
    ----------
    rate : speed; 2 is twice as fast as recorded.
    start_offset_s, duration_s : part of the recording, in its own time; None plays to the end.
    loop : begin again at the end, until stopped.
    clock_hz : rate of /clock (the recording's time); 0: none.
    remap : new name by recorded topic name.
    topics : topics to play; empty: all.
    wait_s : longest wait for subscribers; 0 plays to nobody too.
    start_paused : wait for `resume` or single steps before the first message.
    """

    rate: float = 1.0
    start_offset_s: float = 0.0
    duration_s: float | None = None
    loop: bool = False
    clock_hz: float = 0.0
    remap: Mapping[str, str] = field(default_factory=dict)
    topics: Sequence[str] = ()
    wait_s: float = 30.0
    start_paused: bool = False

    def __post_init__(self) -> None:
        if not 0.0 < self.rate <= FASTEST:
            raise InputError(f"--rate {self.rate:g}: give a speed above 0, at most {FASTEST:g}")
        if not 0.0 <= self.start_offset_s < math.inf:
            raise InputError(f"--start-offset {self.start_offset_s:g}: give seconds, 0 or more")
        if self.duration_s is not None and not 0.0 < self.duration_s < math.inf:
            raise InputError(
                f"--duration {self.duration_s:g}: give seconds above 0, or leave it away to play to the end"
            )
        if not 0.0 <= self.clock_hz <= 1e4:
            raise InputError(f"--clock {self.clock_hz:g}: give 0 to 10000 Hz")
        if not self.wait_s >= 0.0:
            raise InputError(f"--wait {self.wait_s:g}: give seconds, 0 or more")


class Player:
    """Plays one recording on the ROS graph (context manager).

    Parameters
    ----------
    source : the open recording.
    playback : how.
    say : takes lines for the user.
    ros_arguments : handed to rclpy (`--ros-args ...`).

    Attributes
    ----------
    control : pause, rate, jumps and steps, for any thread.

    Raises
    ------
    InputError : a ROS 1 recording, an unknown topic, an offset beyond the end.
    UnanswerableError : no topic of a type that is installed here.
    """

    def __init__(
        self, source: Source, playback: Playback, say: Callable[[str], None], ros_arguments: Sequence[str] = ()
    ) -> None:
        if source.ros1:
            raise InputError(
                f"{source.path} is a ROS 1 recording; convert it first: rosbags-convert --src ... --dst ..."
            )
        self._source, self._playback, self._say = source, playback, say
        first, last = source.span_ns
        length_s = (last - first) / NS_PER_S
        if playback.start_offset_s >= length_s:
            raise InputError(f"--start-offset {playback.start_offset_s:g}: {source.path} ends after {length_s:.3f} s")
        self._start_ns = first + round(playback.start_offset_s * NS_PER_S)
        self._end_ns = last
        if playback.duration_s is not None and playback.duration_s < length_s:
            self._end_ns = min(last, self._start_ns + round(playback.duration_s * NS_PER_S))
        kinds = self._kinds()
        self._context = rclpy.Context()
        rclpy.init(
            args=["player", *ros_arguments], context=self._context, signal_handler_options=SignalHandlerOptions.NO
        )
        self._node = rclpy.create_node(NODE_NAME, context=self._context)
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        try:
            self._publishers: dict[str, Publisher] = {
                name: self._node.create_publisher(kind, playback.remap.get(name, name), qos)
                for name, kind in kinds.items()
            }
        except InvalidTopicNameException as error:
            self._context.try_shutdown()
            raise InputError(f"--remap: {sentence(error)}") from error
        self._clock = self._node.create_publisher(Clock, "/clock", qos) if playback.clock_hz else None
        self.control = PlaybackControl(
            PlaybackClock(self._start_ns, playback.rate),
            self._start_ns,
            self._end_ns,
            loop=playback.loop,
            tick_hz=playback.clock_hz,
            tell_time=self._tell_time,
        )
        if playback.start_paused:
            self.control.pause()
        self._services = PlayerServices(self._node, self.control)

    def __enter__(self) -> "Player":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._services.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _kinds(self) -> dict[str, type]:
        """Return the message class of each topic to play."""
        chosen = self._chosen()
        kinds = {}
        for topic in chosen:
            package, _, name = topic.message_type.partition("/msg/")
            try:
                kinds[topic.name] = getattr(import_module(f"{package}.msg"), name)
            except (ImportError, AttributeError, ValueError):
                self._say(f"passed over: {topic}: its message type is not installed")
        if not kinds:
            raise UnanswerableError(f"{self._source.path} holds no topic of a message type that is installed here")
        played: dict[str, str] = {}
        for name, kind in kinds.items():
            other = played.setdefault(self._playback.remap.get(name, name), name)
            if kinds[other] is not kind:
                raise InputError(
                    f"--remap {name}:={self._playback.remap.get(name, name)}: {other} is played there, and is of "
                    "another message type"
                )
        return kinds

    def _chosen(self) -> list[Topic]:
        topics = {topic.name: topic for topic in self._source.topics}
        for name in (*self._playback.topics, *self._playback.remap):
            if name not in topics:
                raise InputError(f"{self._source.path} has no topic {name}: it has {', '.join(topics) or 'none'}")
        return [topics[name] for name in self._playback.topics or topics]

    @property
    def span_s(self) -> tuple[float, float]:
        """Where in the recording the playback is, and where it ends, s from the recording's first message."""
        first, _ = self._source.span_ns
        return (self.control.position_ns - first) / NS_PER_S, (self._end_ns - first) / NS_PER_S

    def run(self) -> int:
        """Play; return the number of messages published."""
        self._say(self._services.told)
        self._await_subscribers()
        self.control.begin()
        count, turn, position_ns = 0, Turn.MOVED, self._start_ns
        while turn is Turn.MOVED:
            turn = Turn.DUE
            for topic, log_time_ns, raw in self._source.messages(self._publishers, position_ns):
                if log_time_ns >= self._end_ns:
                    break
                turn = self.control.wait_until(log_time_ns)
                if turn is not Turn.DUE:
                    break
                self._publishers[topic].publish(raw)
                self.control.played()
                count += 1
            if turn is Turn.DUE:
                turn = self.control.wait_until(self._end_ns - 1, end=True)
            if turn is Turn.DUE and self._playback.loop:
                self.control.rewind()
                turn = Turn.MOVED
            position_ns = self.control.from_ns
        self.control.stop()  # what is asked from here on is refused
        self._await_acknowledgement(count)
        return count

    def _tell_time(self, now_ns: int) -> None:
        if self._clock is not None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now_ns, NS_PER_S)
            self._clock.publish(message)

    def _await_subscribers(self) -> None:
        """Wait until all subscribers that the graph knows of are matched, and no more appear."""
        wait_s = self._playback.wait_s
        deadline = time.monotonic() + wait_s
        publishers = [*self._publishers.values(), *([self._clock] if self._clock is not None else [])]
        told = False
        known: list[int] = []
        since = time.monotonic()
        while not self.control.stopped:
            matched = [publisher.get_subscription_count() for publisher in publishers]
            wanted = [self._node.count_subscribers(publisher.topic_name) for publisher in publishers]
            now = time.monotonic()
            if [*matched, *wanted] != known:
                known, since = [*matched, *wanted], now
            complete = any(matched) and all(m >= w for m, w in zip(matched, wanted, strict=True))
            if (complete and now - since >= SETTLED_S) or now >= deadline:
                break
            if not told and now - since > 1.0:
                self._say("waiting for subscribers")
                told = True
            time.sleep(0.01)
        if self.control.stopped:
            return
        if wait_s and not any(matched):
            names = ", ".join(publisher.topic_name for publisher in publishers)
            raise UnanswerableError(
                f"nobody subscribed to {names} within {wait_s:g} s; start the node first, or use --remap, or --wait 0"
            )
        unheard = [publisher.topic_name for publisher, m in zip(publishers, matched, strict=True) if not m]
        if unheard:
            self._say(f"warning: nobody listens to {', '.join(unheard)}; is it remapped, or the node not there yet?")
        for publisher, m, w in zip(publishers, matched, wanted, strict=True):
            if wait_s and m < w:
                self._say(f"{publisher.topic_name}: only {m} of {w} subscribers are matched; is their QoS compatible?")

    def _await_acknowledgement(self, count: int) -> None:
        limit = time.monotonic() + ACKNOWLEDGE_S
        for name, publisher in self._publishers.items():
            left = max(0.0, limit - time.monotonic())
            if not publisher.wait_for_all_acked(Duration(seconds=left)):
                self._say(f"{name}: not every subscriber acknowledged all messages within {ACKNOWLEDGE_S:g} s")
        self._say(f"played {count} messages")
