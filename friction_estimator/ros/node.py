"""Process of the node: arguments, signals, the spin loop, a clean end.

Signal handlers are in place before anything slow is imported, so that a node that is stopped while it starts
ends as cleanly as one that runs (docs/decisions/0031).
"""

import gc
import logging
import os
import signal
import sys
import tempfile
import traceback
from pathlib import Path
from types import FrameType
from typing import Any

from friction_estimator.threads import one_thread

SPIN_S = 0.1
"""Longest wait in one turn of the spin loop: bounds how late a signal is noticed."""


class Stopped(BaseException):
    """Raised by a signal while the node starts."""


class StopSignals:
    """SIGINT and SIGTERM as a wish to stop: an exception while starting, a flag once running."""

    def __init__(self) -> None:
        self.stopping = False
        self._starting = True
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._received)

    def started(self) -> None:
        """From now on, only note the wish."""
        self._starting = False
        if self.stopping:
            raise Stopped

    def _received(self, _number: int, _frame: FrameType | None) -> None:
        self.stopping = True
        if self._starting:
            self._starting = False
            raise Stopped


def main() -> None:
    """Run the node until SIGINT or SIGTERM; end the process with 0, or 2 for unusable arguments."""
    signals = StopSignals()
    one_thread()
    try:
        code = _run(sys.argv, signals)
    except Stopped:
        code = 0
    except Exception:
        traceback.print_exc()
        code = 1
    # All is saved and shut down; taking the interpreter apart (numba, LLVM) can last seconds on a busy machine.
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run(arguments: list[str], signals: StopSignals) -> int:
    import rclpy  # noqa: PLC0415 - after the signal handlers
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415

    from friction_estimator.ros.arguments import params_files, repaired  # noqa: PLC0415
    from friction_estimator.ros.estimator_node import EstimatorNode  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="friction_estimator-") as folder:
        try:
            rclpy.init(args=repaired(arguments, Path(folder)), signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            print(f"friction_estimator: {error}", file=sys.stderr)
            return 2
    node: EstimatorNode | None = None
    try:
        node = EstimatorNode(params_files(arguments))
        # What exists now stays: no full collection shall walk through it while samples wait.
        gc.collect()
        gc.freeze()
        signals.started()
        spin(node, signals)
        node.close()
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def spin(node: Any, signals: StopSignals) -> None:
    """Serve the node until a signal arrives."""
    from rclpy.experimental import EventsExecutor  # noqa: PLC0415
    from rclpy.task import Future  # noqa: PLC0415

    executor = EventsExecutor()
    executor.add_node(node)
    # Waiting for a future that never comes serves many events in one call; without a time limit it would hang.
    never = Future()
    while not signals.stopping:
        try:
            executor.spin_until_future_complete(never, timeout_sec=SPIN_S)
        except Exception as error:  # rclpy's own callbacks (parameter services) may raise
            node.health.exception("callback", error)
    executor.remove_node(node)
    executor.shutdown()


if __name__ == "__main__":
    main()
