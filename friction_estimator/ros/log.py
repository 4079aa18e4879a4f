"""The node's way to its log: text from the graph, from files and from libraries is made safe first.

rcutils prints what it is given: a joint's name could move the cursor of whoever reads the console, or forge a line of
another node, and a frame of a megabyte would be a line of a megabyte.
"""

from rclpy.impl import rcutils_logger
from rclpy.impl.logging_severity import LoggingSeverity

from friction_estimator.core.text import shown

# The log names the line that called, and throttles by it: not the one below. rclpy keeps this list for third parties.
rcutils_logger._internal_callers.append(__file__)


class SafeLogger(rcutils_logger.RcutilsLogger):  # type: ignore[misc]
    """A logger whose messages pass `core.text.shown`.

    Parameters
    ----------
    name : of the node's own logger.
    """

    def log(self, message: object, severity: LoggingSeverity, **options: object) -> bool:
        """Log a message as one bounded line of printable characters (see RcutilsLogger.log)."""
        return bool(super().log(shown(message), severity, **options))
