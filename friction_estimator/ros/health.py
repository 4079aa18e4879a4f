"""The node's account of itself, once a second on /diagnostics."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from friction_estimator.core.errors import sentence
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.ros.estimated_joint import EstimatedJoint
from friction_estimator.ros.estimator_status import EstimatorStatus
from friction_estimator.ros.growth import Growth
from friction_estimator.ros.input_status import InputStatus
from friction_estimator.ros.inputs import Inputs
from friction_estimator.ros.load import Load


class Health:
    """Counts exceptions, looks at inputs and estimate, publishes diagnostics.

    Parameters
    ----------
    node : owner of the publisher and the log.

    Attributes
    ----------
    notes : lasting facts worth a warning level, such as start-up values that were refused.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.load = Load()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._inputs = InputStatus(node)
        self._estimates: list[EstimatorStatus] = []
        self._growth = Growth()
        self._last = time.monotonic()
        self.exceptions = 0
        self.last_exception = ""
        self.notes: dict[str, str] = {}

    def exception(self, where: str, error: BaseException) -> None:
        """Count and report an exception that a callback met."""
        self.exceptions += 1
        self.last_exception = f"{where}: {sentence(error)}"
        self._node.get_logger().error(self.last_exception, throttle_duration_sec=5.0)

    def inputs_changed(self) -> None:
        """Start a new grace period (other topics, estimator enabled again)."""
        self._inputs.changed()

    def tick(
        self,
        config: Config,
        inputs: Inputs,
        joints: Sequence[EstimatedJoint],
        enabled: bool,
    ) -> None:
        """Publish diagnostics and log what is newly wrong.

        Parameters
        ----------
        config : what the joints share.
        """
        now = time.monotonic()
        span = max(now - self._last, 1e-3)
        self._last = now
        if config.input.mode == "float64":
            self.notes["float64"] = "messages without stamps: paired by time of receipt"
        else:
            self.notes.pop("float64", None)
        looked = self._inputs.look(config, inputs, [joint.stream for joint in joints], enabled, span)
        self._estimates = self._estimates or [EstimatorStatus(joint) for joint in joints]
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [self._status("inputs", *looked)]
        account, raised = self.load.look(), self._growth.of("exceptions", self.exceptions)
        for estimate in self._estimates:
            level, words, values = estimate.look(span, account, self.notes)
            values["exceptions"] = self.exceptions
            if self.last_exception:
                values["last exception"] = self.last_exception
            if raised:
                level, words = DiagnosticStatus.ERROR, self.last_exception
            message.status.append(self._status(estimate.name, level, words, values))
        self._publisher.publish(message)

    def _status(self, part: str, level: bytes, words: str, values: Mapping[str, Any]) -> DiagnosticStatus:
        name = self._node.get_fully_qualified_name()
        return DiagnosticStatus(
            name=f"{name}: {part}",
            hardware_id=name,
            level=level,
            message=shown(words),
            values=[KeyValue(key=shown(key, LONGEST_NAME), value=shown(value)) for key, value in values.items()],
        )
