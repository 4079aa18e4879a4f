"""The estimator node under rclpy's stock single-threaded executor, for comparison."""

from typing import Any

import rclpy.experimental
from rclpy.executors import SingleThreadedExecutor

from friction_estimator.ros.node import main


def stock() -> Any:
    return SingleThreadedExecutor()


if __name__ == "__main__":
    rclpy.experimental.EventsExecutor = stock
    main()
