"""Real processes on a ROS graph of their own: the node under test, and a probe that feeds and hears it.

Shared by the ROS tests and benchmarks/node. Nothing here sleeps for a fixed time where a condition can be awaited.
"""

import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

LIMIT_S = 60.0
"""A condition that does not hold after this long is a failure; far above what a busy machine needs."""

NS = 1_000_000_000
ROOT = Path(__file__).resolve().parents[1]
INPUTS = ("velocity", "friction", "joint_states", "pressure", "temperature", "position")
RELIABLE = {f"qos_overrides./{topic}.subscription.reliability": "reliable" for topic in INPUTS}
# The queue of the tests outlasts a machine that stands still for seconds; the benchmarks keep the node's own.
DEEP = {f"qos_overrides./{topic}.subscription.depth": 4000 for topic in INPUTS}

# Range and units of `motion`, for tests that are not about the first contact.
UNITS = {"theory.kind": "seal", "basis.velocity_range": [-0.15, 0.15], "force_unit": 10.0}

PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
ANNOUNCED_OFTEN = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><participant profile_name="probe" is_default_profile="true">
<rtps><builtin><discovery_config><leaseAnnouncement><sec>0</sec><nanosec>50000000</nanosec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant></profiles></dds>
"""


@contextmanager
def announced_often(folder: Path) -> Iterator[None]:
    """Let participants that are made within announce themselves every 50 ms; processes started later are as usual.

    Two participants of Fast DDS that miss each other's first announcements find each other at the next one: 3 s later.
    """
    file = folder / "profiles.xml"
    file.write_text(ANNOUNCED_OFTEN)
    os.environ.update(dict.fromkeys(PROFILES, str(file)))
    try:
        yield
    finally:
        for name in PROFILES:
            del os.environ[name]


def await_(condition: Callable[[], Any], what: str, limit_s: float = LIMIT_S) -> Any:
    """Return the condition's first true value; fails with `what` where it never comes."""
    deadline = time.monotonic() + limit_s
    pause = 0.0002
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {limit_s:g} s: {what}")
        time.sleep(pause)
        pause = min(1.5 * pause, 0.02)


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve a domain id that no other test on this machine uses (a bound port is the lock)."""
    start = os.getpid() % 90
    for offset in range(90):
        domain = 10 + (start + offset) % 90
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lock:
            try:
                lock.bind(("127.0.0.1", 61000 + domain))
            except OSError:
                continue
            yield domain
            return
    raise AssertionError("no free ROS domain id")


class Process:
    """A child process whose output is kept; `options` are those of `subprocess.Popen`."""

    def __init__(self, command: list[str], environment: dict[str, str], log: Path, **options: Any) -> None:
        self.log = log
        with log.open("wb") as sink:
            self.popen = subprocess.Popen(command, env=environment, stdout=sink, stderr=subprocess.STDOUT, **options)

    @property
    def pid(self) -> int:
        return self.popen.pid

    def output(self) -> str:
        return self.log.read_text(errors="replace")

    def says(self, text: str, limit_s: float = LIMIT_S) -> None:
        """Wait until the output holds `text`."""

        def found() -> bool:
            if text in self.output():
                return True
            assert self.popen.poll() is None, f"process ended with {self.popen.returncode}:\n{self.output()}"
            return False

        try:
            await_(found, f"{text!r} in the output", limit_s)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.output()}") from None

    def stop(self, number: int = signal.SIGINT, limit_s: float = LIMIT_S) -> int:
        """Send a signal and return the exit code."""
        if self.popen.poll() is None:
            self.popen.send_signal(number)
        return self.popen.wait(limit_s)

    def cpu_s(self) -> float:
        """Processor time so far, s."""
        parts = Path(f"/proc/{self.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")

    def memory_MB(self) -> float:
        """Resident memory, MB."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Graph:
    """A domain with a probe node in this process.

    Attributes
    ----------
    probe : rclpy node, served by a thread.
    """

    def __init__(self, domain: int, folder: Path) -> None:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["ROS_LOG_DIR"] = str(folder / "ros_log")
        import rclpy
        from rclpy.experimental import EventsExecutor

        self.domain, self.folder = domain, folder
        self.context = rclpy.Context()
        with announced_often(folder):
            rclpy.init(args=[], context=self.context, domain_id=domain)
            self.probe = rclpy.create_node("probe", context=self.context)
        self._executor = EventsExecutor(context=self.context)
        self._executor.add_node(self.probe)
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        self.processes: list[Process] = []
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}

    def _serve(self) -> None:
        while self._running:
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        """End the children and the probe."""
        for process in self.processes:
            if process.popen.poll() is None:
                process.popen.kill()
                process.popen.wait(LIMIT_S)
        self._running = False
        self._thread.join(LIMIT_S)
        self._executor.remove_node(self.probe)
        self._executor.shutdown()
        self.probe.destroy_node()
        self.context.try_shutdown()

    # --- processes ---------------------------------------------------------------------------------------------

    def environment(self) -> dict[str, str]:
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "PYTHONUNBUFFERED": "1"}

    def start(self, *command: str) -> Process:
        """Start `python ...`."""
        log = self.folder / f"process{len(self.processes)}.log"
        process = Process([sys.executable, *command], self.environment(), log)
        self.processes.append(process)
        return process

    def start_node(
        self,
        parameters: dict[str, Any] | None = None,
        *,
        namespace: str = "",
        arguments: tuple[str, ...] = (),
        reliable: bool = True,
        deep: bool = True,
        units: bool = True,
        ready: bool = True,
        limit_s: float = LIMIT_S,
    ) -> Process:
        """Start the node under test with these parameters; return when it listens, which has to be within `limit_s`.

        Without `units` the first contact chooses them.
        """
        values = {
            **(RELIABLE if reliable else {}),
            **(DEEP if deep else {}),
            **(UNITS if units else {}),
            **(parameters or {}),
        }
        file = self.folder / f"parameters{len(self.processes)}.yaml"
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
        ros = ["--ros-args", "--params-file", str(file)]
        if namespace:
            ros += ["-r", f"__ns:={namespace}"]
        process = self.start("-m", "friction_estimator.ros.node", *ros, *arguments)
        if ready:
            process.says("listening", limit_s)
        return process

    # --- topics ------------------------------------------------------------------------------------------------

    def publisher(self, kind: type, topic: str, *, reliable: bool = True, depth: int = 10000) -> Any:
        """Return a publisher, one a topic."""
        if topic not in self._publishers:
            self._publishers[topic] = self.probe.create_publisher(kind, topic, qos(reliable, depth))
        return self._publishers[topic]

    def matched(self, *topics: str, count: int = 1) -> None:
        """Wait until the probe's publishers have subscribers."""
        for topic in topics:
            publisher = self._publishers[topic]
            await_(lambda p=publisher: p.get_subscription_count() >= count, f"a subscriber of {topic}")

    def hear(self, kind: type, topic: str, *, raw: bool = False) -> list[Any]:
        """Return a list that fills with the messages of a topic."""
        heard: list[Any] = []
        self.probe.create_subscription(kind, topic, heard.append, qos(True, 10000), raw=raw)
        return heard

    def heard_by(self, topic: str, count: int = 1) -> None:
        """Wait until a topic has publishers."""
        await_(lambda: self.probe.count_publishers(topic) >= count, f"a publisher of {topic}")

    def reached_by(self, node: str = "/friction_estimator") -> None:
        """Wait until the predictions of a node reach a subscription, and so all that were made before it here.

        That this process knows the node's publisher does not mean that the publisher knows of its subscription: both
        find each other at their own time, and what is published before is for nobody. Only the node can tell.
        """
        from diagnostic_msgs.msg import DiagnosticArray

        told: list[int] = []

        def look(message: Any) -> None:
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                if status.hardware_id == node:
                    told.append(int(values.get("subscribers of the prediction", 0)))

        subscription = self.probe.create_subscription(DiagnosticArray, "/diagnostics", look, 10)
        try:
            await_(lambda: any(told), f"a subscription to the predictions of {node}")
        finally:
            self.probe.destroy_subscription(subscription)

    # --- services ----------------------------------------------------------------------------------------------

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service and return its answer.

        One client a service: a server may not know a client of this very moment yet, and its answer gets lost.
        """
        if name not in self._clients:
            self._clients[name] = self.probe.create_client(kind, name)
        client = self._clients[name]
        await_(client.service_is_ready, f"service {name}")
        for _ in range(3):
            done = threading.Event()
            future = client.call_async(kind.Request(**fields))
            future.add_done_callback(lambda _, done=done: done.set())
            if done.wait(LIMIT_S / 3):
                return future.result()
        raise AssertionError(f"no answer from {name}")

    def call_get(self, node: str, name: str) -> Any:
        """Return a parameter of a node as its message gives it."""
        from rcl_interfaces.srv import GetParameters
        from rclpy.parameter import parameter_value_to_python

        return parameter_value_to_python(self.call(GetParameters, f"{node}/get_parameters", names=[name]).values[0])

    def call_set(self, node: str, *, atomically: bool = True, **values: Any) -> Any:
        """Set parameters (dots are written __); return the answers, one if set atomically."""
        from rcl_interfaces.srv import SetParameters, SetParametersAtomically
        from rclpy.parameter import Parameter

        messages = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()
        ]
        if atomically:
            kind, service = SetParametersAtomically, "set_parameters_atomically"
            return self.call(kind, f"{node}/{service}", parameters=messages).result
        return self.call(SetParameters, f"{node}/set_parameters", parameters=messages).results


def qos(reliable: bool, depth: int) -> Any:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=reliability)


@contextmanager
def graph(folder: Path) -> Iterator[Graph]:
    """A graph on a domain of its own."""
    with reserved_domain() as domain:
        made = Graph(domain, folder)
        try:
            yield made
        finally:
            made.close()


class Feeder:
    """Publishes velocity and friction messages as bytes, by stamp.

    Parameters
    ----------
    graph : whose probe publishes.
    prefix : of the topic names, such as "/left".
    rotary : angular velocity and torque instead of linear velocity and force.
    """

    def __init__(
        self, graph: Graph, prefix: str = "", *, reliable: bool = True, frame: str = "shaft", rotary: bool = False
    ) -> None:
        from geometry_msgs.msg import TwistStamped, WrenchStamped

        from friction_estimator.ros.wire import serialised_frame

        self._velocity = graph.publisher(TwistStamped, f"{prefix}/velocity", reliable=reliable)
        self._friction = graph.publisher(WrenchStamped, f"{prefix}/friction", reliable=reliable)
        self._topics = (f"{prefix}/velocity", f"{prefix}/friction")
        self._graph = graph
        text = serialised_frame(frame)
        text += bytes(-(12 + len(text) - 4) % 8)
        self._layout = struct.Struct(f"<4sII{len(text)}s{'24xd16x' if rotary else 'd40x'}")
        self._frame = text

    def matched(self, count: int = 1) -> None:
        self._graph.matched(*self._topics, count=count)

    def message(self, stamp_ns: int, value: float) -> bytes:
        seconds, nanoseconds = divmod(stamp_ns, NS)
        return self._layout.pack(b"\0\1\0\0", seconds % 2**32, nanoseconds, self._frame, value)

    def velocity(self, stamp_ns: int, value: float) -> None:
        self._velocity.publish(self.message(stamp_ns, value))

    def friction(self, stamp_ns: int, value: float) -> None:
        self._friction.publish(self.message(stamp_ns, value))

    def pair(self, stamp_ns: int, velocity: float, friction: float) -> None:
        self.velocity(stamp_ns, velocity)
        self.friction(stamp_ns, friction)

    def acknowledged(self) -> None:
        """Wait until every subscriber has taken everything."""
        from rclpy.duration import Duration

        for publisher in (self._velocity, self._friction):
            assert publisher.wait_for_all_acked(Duration(seconds=LIMIT_S)), "messages were not acknowledged"


def motion(count: int, rate_hz: float, seed: int = 0) -> tuple[Any, Any, Any]:
    """Return stamps (ns), velocity (m/s) and friction (N) of a plausible shaft."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(count) / rate_hz
    velocity = 0.1 * np.sin(2 * np.pi * 0.7 * time_s)
    friction = 4.0 * np.tanh(velocity / 0.004) * (0.6 + 0.4 * np.exp(-abs(velocity) / 0.02)) + 12.0 * velocity
    stamps = 1_700_000_000 * NS + np.round(time_s * NS).astype(np.int64)
    return stamps, velocity, friction + 0.02 * rng.standard_normal(count)


def force(message: bytes, component: int = 0) -> tuple[int, float]:
    """Return (stamp in ns, force.x) of a serialised WrenchStamped; component 3 is torque.x."""
    size = struct.unpack_from("<I", message, 12)[0]
    seconds, nanoseconds = struct.unpack_from("<iI", message, 4)
    place = 16 + size + -(12 + size) % 8 + 8 * component
    return seconds * NS + nanoseconds, struct.unpack_from("<d", message, place)[0]
