"""Hears what a running node publishes for people, and keeps the last of it."""

import threading
import time
from collections.abc import Sequence
from types import TracebackType

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from friction_estimator.core.decimation import MONITOR_WIDTH
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import LINEAR, ROTARY, Quantities
from friction_estimator.core.settings.joint_names import plain_name
from friction_estimator.report.live.seen import Seen

KEPT_ROWS = 40_000
"""Three quarters of a minute of a fast drive, several of a slow one."""


class MonitorFeed:
    """Subscribes to one node's monitor, curve and diagnostics, in a thread of its own; use as a context manager.

    Best effort, and no question: nothing that the node would have to wait for.

    Parameters
    ----------
    node : name of the node, with its namespace.
    joint : the joint of several whose topics are heard, "" for the only one.
    arguments : of ROS, as `--ros-args ...`.
    """

    def __init__(self, node: str, joint: str = "", arguments: Sequence[str] = ()) -> None:
        self._lock = threading.Lock()
        self._seen, self._rows, self._heard_at = Seen(), np.empty((0, MONITOR_WIDTH)), 0.0
        self._owner, self._joint = "/" + node.strip("/"), joint
        self._prefix = f"{self._owner}/{plain_name(joint)}" if joint else self._owner
        self._context = rclpy.Context()
        rclpy.init(args=["watch", *arguments], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("friction_estimator_watch", context=self._context)
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.topic = f"{self._prefix}/monitor"
        try:
            self._node.create_subscription(Float64MultiArray, self.topic, self._take_rows, qos)
            self._node.create_subscription(Float64MultiArray, f"{self._prefix}/friction_curve", self._take_curve, qos)
            self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, qos)
        except Exception as error:
            self._context.try_shutdown()
            raise InputError(f"--node {node}: {error}", remedy="give a node's name as `ros2 node list` does") from error
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> "MonitorFeed":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def look(self) -> Seen:
        """Return what is known now; it does not change any more."""
        publishers = self._node.count_publishers(self.topic)
        with self._lock:
            silent_s = time.monotonic() - self._heard_at if self._heard_at else float("inf")
            seen = self._seen
            return Seen(
                self._rows, seen.count, seen.round, silent_s, seen.curve, seen.status, seen.level, seen.values,
                publishers, seen.quantities,
            )  # fmt: skip

    def _serve(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _take_rows(self, message: Float64MultiArray) -> None:
        rows = np.array(message.data)
        if not rows.size or rows.size % MONITOR_WIDTH:  # of another program, or another version
            return
        rows = rows.reshape(-1, MONITOR_WIDTH)
        back = np.flatnonzero(np.diff(rows[:, 0]) < 0.0)
        with self._lock:
            if back.size or (self._rows.size and rows[0, 0] < self._rows[-1, 0]):
                self._seen.round += 1
                rows, self._rows = rows[back[-1] + 1 if back.size else 0 :], rows[:0]
            self._rows = np.concatenate([self._rows, rows])[-KEPT_ROWS:]
            self._seen.count += len(rows)
            self._heard_at = time.monotonic()

    def _take_curve(self, message: Float64MultiArray) -> None:
        curve = np.array(message.data)
        if curve.size and curve.size % 4 == 0:
            with self._lock:
                self._seen.curve = curve.reshape(-1, 4)

    def _take_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            owner, _, part = status.name.partition(": ")
            if owner != self._owner:
                continue
            values = {item.key: item.value for item in status.values}
            with self._lock:
                if part == "inputs":
                    motion = values.get("motion", "").partition(":")[0]
                    if motion in (LINEAR, ROTARY):
                        self._seen.quantities = Quantities(motion)
                elif part == (self._joint or "estimator"):
                    self._seen.status, self._seen.level = status.message, int.from_bytes(status.level, "little")
                    self._seen.values = values
