"""Process of the node: arguments, signals, the spin loop, a clean end.

Signal handlers are in place before anything slow is imported, so that a node that is stopped while it starts
ends as cleanly as one that runs (docs/decisions/0031).
"""

import os
import sys

from friction_estimator.ros.stop_signals import StopSignals
from friction_estimator.startup import spare_the_start
from friction_estimator.threads import one_thread

TYPE_CHECKING = False
if TYPE_CHECKING:
    from friction_estimator.ros.estimator_node import EstimatorNode

SWITCH_S = 2e-5
"""Longest time that a thread in the background keeps a sample waiting for the interpreter's lock (5 ms by default)."""

SEARCH_OBJECTS = 700
"""New objects between two searches for unreachable cycles while samples come: few, so that each search is short."""

SPIN_S = 0.1
"""Longest wait in one turn of the spin loop: bounds how late a signal is noticed."""


def main() -> None:
    """Run the node until a signal ends it; end the process with 0, 2 for unusable arguments, 70 for a fault."""
    signals = StopSignals()
    spare_the_start()
    import logging  # noqa: PLC0415 - what is imported before the handlers are in place cannot be stopped in order
    from contextlib import suppress  # noqa: PLC0415

    from friction_estimator.streams import open_standard_streams, told  # noqa: PLC0415

    open_standard_streams()
    one_thread()
    try:
        _run(sys.argv, signals)
        code = 0
    except Exception as error:
        code = told("friction_estimator", error, debug="--debug" in sys.argv)
    # All is saved and shut down; taking the interpreter apart (numba, LLVM) can last seconds on a busy machine.
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, AttributeError):  # closed, or its reader went away
            stream.flush()
    os._exit(code)


def _run(arguments: list[str], signals: StopSignals) -> None:
    """Run the node; raises InputError for arguments and names that rcl refuses."""
    import gc  # noqa: PLC0415 - after the signal handlers
    import tempfile  # noqa: PLC0415
    from pathlib import Path  # noqa: PLC0415

    import rclpy  # noqa: PLC0415
    from rclpy.exceptions import NameValidationException  # noqa: PLC0415
    from rclpy.impl.implementation_singleton import rclpy_implementation  # noqa: PLC0415
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415

    from friction_estimator.core.errors import InputError  # noqa: PLC0415
    from friction_estimator.ros.arguments import params_files, repaired  # noqa: PLC0415
    from friction_estimator.ros.estimator_node import EstimatorNode  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="friction_estimator-") as folder:
        signals.scratch = folder
        try:
            rclpy.init(args=repaired(arguments, Path(folder)), signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise InputError(str(error)) from error
    signals.scratch = ""
    sys.setswitchinterval(SWITCH_S)
    node: EstimatorNode | None = None
    try:
        try:
            node = EstimatorNode(files=params_files(arguments))
        except (NameValidationException, rclpy_implementation.RCLError) as error:
            raise InputError(str(error), remedy="correct names and remappings of the start") from error
        # What exists now stays: no full collection shall walk through it while samples wait.
        gc.collect()
        gc.freeze()
        gc.set_threshold(SEARCH_OBJECTS)
        signals.started()
        spin(node, signals)
        node.close()
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def spin(node: "EstimatorNode", signals: StopSignals) -> None:
    """Serve the node until a signal arrives."""
    from rclpy.experimental import EventsExecutor  # noqa: PLC0415
    from rclpy.task import Future  # noqa: PLC0415

    executor = EventsExecutor()
    executor.add_node(node)
    node.stopping = lambda: signals.stopping
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
