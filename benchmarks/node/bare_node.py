"""The least that a node of rclpy can be: it repeats each friction message as a prediction."""

import contextlib

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import ExternalShutdownException


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("friction_estimator")
    predicted = node.create_publisher(WrenchStamped, "~/friction_predicted", 10)
    node.create_subscription(WrenchStamped, "friction", predicted.publish, 10)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
