"""The loop of the nodes that stand beside the estimator in the benchmarks."""

import signal

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node


def serve(node: Node, executor: Executor, ready: str) -> None:
    """Log `ready`, then serve the node until SIGINT or SIGTERM."""
    stopping = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.append(True))
    executor.add_node(node)
    node.get_logger().info(ready)
    while not stopping:
        executor.spin_once(timeout_sec=0.1)
    executor.remove_node(node)
    node.destroy_node()
    rclpy.shutdown()
