"""A node with the estimator's subscriptions and publications that only echoes: what the middleware alone costs.

python echo_node.py events|single raw|typed
"""

import sys

import rclpy
from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import FluidPressure, JointState, Temperature
from serving import serve
from std_msgs.msg import Float64MultiArray


def main(executor_kind: str, message_kind: str) -> None:
    raw = message_kind == "raw"
    rclpy.init(args=["echo"], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("friction_estimator")
    qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    predicted = node.create_publisher(WrenchStamped, "~/friction_predicted", qos)
    residual = node.create_publisher(WrenchStamped, "~/residual", qos)
    stddev = node.create_publisher(WrenchStamped, "~/friction_stddev", qos)
    node.create_publisher(Float64MultiArray, "~/friction_curve", 1)
    for name in ("fir_taps", "theory_taps", "wavelet_weights"):
        node.create_publisher(Float64MultiArray, f"~/parameters/{name}", 10)

    def echo(message: object) -> None:
        predicted.publish(message)
        residual.publish(message)
        stddev.publish(message)

    def pass_over(message: object) -> None:
        pass

    node.create_subscription(TwistStamped, "velocity", pass_over, qos, raw=raw)
    node.create_subscription(WrenchStamped, "friction", echo, qos, raw=raw)
    for kind, topic in ((FluidPressure, "pressure"), (Temperature, "temperature"), (JointState, "position")):
        node.create_subscription(kind, topic, pass_over, qos, raw=raw)
    serve(node, EventsExecutor() if executor_kind == "events" else SingleThreadedExecutor(), "listening")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
