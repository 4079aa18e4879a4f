"""Quality of service: the defaults of inputs and outputs, and overrides that cannot end the node."""

from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

INPUT_DEPTH = 1000
"""Messages that the queue of an input holds: a second at 1 kHz."""


def input_qos() -> QoSProfile:
    """Return the default of the inputs: it matches any publisher."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=INPUT_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)


def output_qos(depth: int) -> QoSProfile:
    """Return the default of the outputs: reliable, so that every subscriber matches."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def with_overrides(
    node: Node,
    topic: str,
    default: Callable[[], QoSProfile],
    create: Callable[[QoSProfile, QoSOverridingOptions | None], Any],
) -> tuple[Any, QoSProfile]:
    """Create a publisher or subscription with the user's overrides, or without them where they cannot be used.

    Parameters
    ----------
    topic : for the report.
    default : makes the default; rclpy writes the overrides into it.
    create : takes the profile and the options (None: no overrides).

    Returns
    -------
    What `create` returned, and the profile in force.

    Raises
    ------
    RCLError : the middleware refuses the topic, with whatever profile.
    """
    qos = default()
    try:
        options = QoSOverridingOptions.with_default_policies()
        return create(qos, options), qos
    except rclpy_implementation.RCLError:  # the topic itself: a clashing type
        raise
    except Exception as error:  # rclpy raises half a dozen kinds for values that users write
        qos = default()
        node.get_logger().error(
            f"quality of service of {topic}: {error}; "
            f"using {qos.reliability.name.lower()}, {qos.history.name.lower()} {qos.depth}"
        )
        return create(qos, None), qos
