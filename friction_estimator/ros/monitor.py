"""What people look at while the node runs: a few rows of its samples, in batches, while somebody listens.

The thread of the samples appends a row; everything else happens in a thread of its own.
"""

import array
import threading
from collections import deque
from itertools import chain
from typing import Protocol

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from friction_estimator.core.decimation import MONITOR_COLUMNS, MONITOR_WIDTH, telling_rows
from friction_estimator.core.errors import sentence
from friction_estimator.core.sample import NS_PER_S

BATCH_S = 0.05

ASK_S = 0.25
"""Time between two looks for a listener, while there is none."""

MOST_ROWS = 62
"""Rows of a batch: all samples up to 1.2 kHz, and more than a screen of 2000 pixels can tell apart in two seconds."""

ROOM = 20_000
"""Samples that wait for the next batch at the most."""

Row = tuple[float, float, float, float, float]


class Publishes(Protocol):
    """A publisher, or what stands for one that the middleware refused."""

    def publish(self, message: Float64MultiArray) -> None:
        """Publish a message."""

    def get_subscription_count(self) -> int:
        """Return how many listen."""


class Monitor:
    """Publishes the samples in decimated batches.

    Parameters
    ----------
    publisher : of the topic.
    log : of the node; it is told of a batch that failed, and the next one is tried all the same.

    Attributes
    ----------
    wanted : whether anybody listened lately; else samples need not be noted.
    """

    def __init__(self, publisher: Publishes, log: RcutilsLogger) -> None:
        self._publisher, self._log = publisher, log
        self._rows: deque[Row] = deque(maxlen=ROOM)
        self._ended = threading.Event()
        self.wanted = False
        self._thread = threading.Thread(target=self._serve, name="monitor", daemon=True)
        self._thread.start()

    def note(self, stamp_ns: int, velocity_m_s: float, measured_N: float, predicted_N: float, stddev_N: float) -> None:
        """Take a sample."""
        self._rows.append((stamp_ns / NS_PER_S, velocity_m_s, measured_N, predicted_N, stddev_N))

    def close(self) -> None:
        """Publish no more."""
        self._ended.set()
        self._thread.join()

    def _serve(self) -> None:
        while not self._ended.wait(BATCH_S if self.wanted else ASK_S):
            try:
                self.wanted = bool(self._publisher.get_subscription_count())
                if self.wanted and self._rows:
                    self._publisher.publish(batch([self._rows.popleft() for _ in range(len(self._rows))]))
                elif not self.wanted:
                    self._rows.clear()
            except Exception as error:
                self._log.error(f"monitor: {sentence(error)}", throttle_duration_sec=5.0)


def batch(rows: list[Row]) -> Float64MultiArray:
    """Return the message of some samples.

    >>> message = batch([(1.5, 0.1, 2.0, 1.9, 0.2)])
    >>> [dimension.size for dimension in message.layout.dim], message.data.tolist()
    ([1, 5], [1.5, 0.1, 2.0, 1.9, 0.2])
    """
    if len(rows) <= MOST_ROWS:
        data = array.array("d", chain.from_iterable(rows))
    else:
        data = array.array("d", telling_rows(np.array(rows), MOST_ROWS).tobytes())
    message = Float64MultiArray(data=data)
    message.layout.dim = [
        MultiArrayDimension(label="samples", size=len(data) // MONITOR_WIDTH, stride=len(data)),
        MultiArrayDimension(label=MONITOR_COLUMNS, size=MONITOR_WIDTH, stride=MONITOR_WIDTH),
    ]
    return message
