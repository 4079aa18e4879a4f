"""What the node publishes: prediction, its deviation and residual as raw WrenchStamped, the rest as labelled arrays."""

import array
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from friction_estimator.core.fit.band import Curve
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.core.sample import NS_PER_S, Floats
from friction_estimator.core.text import shown
from friction_estimator.ros.monitor import Monitor
from friction_estimator.ros.quality import output_qos, with_overrides
from friction_estimator.ros.wire import WrenchWriter

ARRAYS = ("fir_taps", "theory_taps", "wavelet_weights")

CURVE_COLUMNS = "velocity_m_s,friction_N,low_N,high_N"
"""Label of the curve's columns."""


class Unpublished:
    """Stands for a publisher of a topic that the middleware refused."""

    def publish(self, message: object) -> None:
        """Pass over a message."""

    def get_subscription_count(self) -> int:
        """Nobody can listen."""
        return 0


class Outputs:
    """The node's publishers.

    Parameters
    ----------
    node : owner of the publishers.
    axis, motion : along or about which friction acts.
    prefix : of the topics' names.
    """

    def __init__(self, node: Node, axis: str, motion: str = LINEAR, prefix: str = "~/") -> None:
        self.faults: list[str] = []
        """Why outputs are not published."""

        def publisher(kind: type, topic: str, depth: int) -> Publisher | Unpublished:
            def create(qos: QoSProfile, options: Any) -> Publisher:
                return node.create_publisher(kind, topic, qos, qos_overriding_options=options)

            try:
                return with_overrides(node, topic, lambda: output_qos(depth), create)[0]
            except Exception as error:  # a clashing type, a name that rcl refuses
                fault = f"{topic} cannot be published ({error}): correct the remapping and start again"
                self.faults.append(shown(fault))
                return Unpublished()

        samples = [
            publisher(WrenchStamped, f"{prefix}{topic}", 1000)
            for topic in ("friction_predicted", "residual", "friction_stddev")
        ]
        self._predicted = samples[0]
        self._send = tuple(map(_sender, samples))
        self._curve = publisher(Float64MultiArray, f"{prefix}friction_curve", 1)
        self._arrays = {name: publisher(Float64MultiArray, f"{prefix}parameters/{name}", 10) for name in ARRAYS}
        self._named = publisher(JointState, f"{prefix}parameters/named", 10)
        self._monitor = Monitor(publisher(Float64MultiArray, f"{prefix}monitor", 10), node.get_logger())
        self._parameters_due = 0.0
        self.published = 0
        self.set_axis(axis, motion)

    def set_axis(self, axis: str, motion: str) -> None:
        """Publish friction as the force along this axis, or, of a rotary drive, as the torque about it."""
        self._writer = WrenchWriter("xyz".index(axis) + (3 if motion == ROTARY else 0))

    def sample(
        self, stamp_ns: int, frame: bytes, velocity_m_s: float, predicted_N: float, friction_N: float, stddev_N: float
    ) -> None:
        """Publish the prediction of one sample, its residual and its standard deviation."""
        write = self._writer.write
        send_predicted, send_residual, send_stddev = self._send
        send_predicted(write(stamp_ns, frame, predicted_N))
        send_residual(write(stamp_ns, frame, friction_N - predicted_N))
        send_stddev(write(stamp_ns, frame, stddev_N))
        if self._monitor.wanted:
            self._monitor.note(stamp_ns, velocity_m_s, friction_N, predicted_N, stddev_N)
        self.published += 1

    def close(self) -> None:
        """Publish nothing more for people."""
        self._monitor.close()

    @property
    def subscribers(self) -> int:
        """Subscriptions that predictions reach: those that this publisher has been matched with."""
        return self._predicted.get_subscription_count()

    def parameters_due(self, rate_hz: float) -> bool:
        """Return True where the parameters are to be published now; a rate of 0 means always."""
        if rate_hz <= 0.0:
            return True
        now = time.monotonic()
        if now < self._parameters_due:
            return False
        self._parameters_due = now + 1.0 / rate_hz
        return True

    def parameters_at_once(self) -> None:
        """Let the next sample's parameters be published: the rate has changed."""
        self._parameters_due = 0.0

    def parameters(self, values: Parameters, stamp_ns: int) -> None:
        """Publish the learned values; where somebody listens, all of them by name with the stamp of their sample."""
        for name in ARRAYS:
            self._arrays[name].publish(labelled(name, getattr(values, name)))
        if self._named.get_subscription_count():
            message = JointState()
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
            message.name = [f"{name}.{k}" for name in ARRAYS for k in range(getattr(values, name).size)]
            message.position = np.concatenate([getattr(values, name) for name in ARRAYS])
            self._named.publish(message)

    @property
    def curve_wanted(self) -> bool:
        """Whether anybody listens to the curve."""
        return bool(self._curve.get_subscription_count())

    def curve(self, curve: Curve) -> None:
        """Publish the static curve: a row a velocity."""
        rows = np.stack([curve.velocity_m_s, curve.friction_N, curve.low_N, curve.high_N], 1)
        count, columns = rows.shape
        message = Float64MultiArray()
        message.layout.dim = [
            MultiArrayDimension(label="velocities", size=count, stride=rows.size),
            MultiArrayDimension(label=CURVE_COLUMNS, size=columns, stride=columns),
        ]
        message.data = array.array("d", rows.tobytes())
        self._curve.publish(message)


def _sender(publisher: Publisher | Unpublished) -> Callable[[bytes], None]:
    """Return what sends serialised messages.

    `Publisher.publish` first asks whether it was given a message object, which takes longer than sending the bytes.
    """
    return publisher.publish if isinstance(publisher, Unpublished) else publisher.handle.publish_raw


def labelled(name: str, values: Floats) -> Float64MultiArray:
    """Return an array message with one labelled dimension."""
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension(label=name, size=values.size, stride=values.size)]
    message.data = array.array("d", values.tobytes())
    return message
