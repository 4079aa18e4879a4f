"""Collects the node's predictions from another process, for the demonstration."""

from collections.abc import Callable
from types import TracebackType

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from friction_estimator.core.sample import NS_PER_S

SPIN_S = 0.1
DEPTH = 20000


class Listener:
    """Hears `friction_predicted` and `residual` of one node; use as a context manager.

    Attributes
    ----------
    predicted, residual : by stamp (ns), N, in order of arrival.
    """

    def __init__(self, node_name: str = "friction_estimator") -> None:
        self.predicted: dict[int, float] = {}
        self.residual: dict[int, float] = {}
        self._node_name = node_name

    def __enter__(self) -> "Listener":
        rclpy.init()
        self._node = rclpy.create_node(f"{self._node_name}_listener")
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
        for topic, heard in (("friction_predicted", self.predicted), ("residual", self.residual)):
            self._node.create_subscription(WrenchStamped, f"{self._node_name}/{topic}", _into(heard), qos)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.remove_node(self._node)
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def connected(self) -> bool:
        """Return whether the node publishes both topics."""
        return all(
            self._node.count_publishers(f"{self._node_name}/{topic}") for topic in ("friction_predicted", "residual")
        )

    def serve_until(self, condition: Callable[[], bool]) -> None:
        """Take messages until `condition` holds; it is asked about every `SPIN_S`."""
        while not condition():
            self._executor.spin_once(timeout_sec=SPIN_S)


def _into(heard: dict[int, float]) -> Callable[[WrenchStamped], None]:
    def take(message: WrenchStamped) -> None:
        stamp = message.header.stamp
        heard[stamp.sec * NS_PER_S + stamp.nanosec] = message.wrench.force.x

    return take
