"""The node's way to its log: text from the graph, from files and from libraries is made safe first.

rcutils prints what it is given: a joint's name could move the cursor of whoever reads the console, or forge a line of
another node, and a frame of a megabyte would be a line of a megabyte.
"""

import sys
from types import FrameType, SimpleNamespace

from rclpy.impl import rcutils_logger
from rclpy.impl.logging_severity import LoggingSeverity

from friction_estimator.core.text import shown

# The log names the line that called, and throttles by it: not the one below. rclpy keeps this list for third parties.
rcutils_logger._internal_callers.append(__file__)


def _file_of(frame: FrameType) -> SimpleNamespace:
    """Return of `inspect.getframeinfo` what rclpy takes of it."""
    return SimpleNamespace(filename=frame.f_code.co_filename)


# To name that line rclpy has `inspect` go through the files of all modules and read the source: 0.1 s for the first
# message, when the node starts. The code knows the name of its file.
rcutils_logger.inspect = SimpleNamespace(currentframe=sys._getframe, getframeinfo=_file_of)


class SafeLogger(rcutils_logger.RcutilsLogger):  # type: ignore[misc]
    """A logger whose messages pass `core.text.shown`.

    Parameters
    ----------
    name : of the node's own logger.
    """

    def log(self, message: object, severity: LoggingSeverity, **options: object) -> bool:
        """Log a message as one bounded line of printable characters (see RcutilsLogger.log)."""
        return bool(super().log(shown(message), severity, **options))
