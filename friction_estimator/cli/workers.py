"""Processes that compute for a verb, and end with it however it ends."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from typing import Any

from friction_estimator.core.errors import FrictionEstimatorError
from friction_estimator.threads import VARIABLES

WORKERS = 2

_OURS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that may reach the whole group (Ctrl-C, a closed terminal): the verb obeys them, and ends its workers."""

_SINGLE_THREAD = dict.fromkeys(VARIABLES, "1")


@dataclass(frozen=True)
class Task:
    """One piece of work: a pure function of a module, and its arguments."""

    key: tuple[Any, ...]
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class WorkerError(FrictionEstimatorError):
    """A worker process ended before its work was done."""


def run_tasks(
    tasks: Sequence[Task], advance: Callable[[int], None], workers: int = WORKERS
) -> dict[tuple[Any, ...], Any]:
    """Compute every task in processes of their own; return the results by key, in the order of the tasks.

    An interrupt, or whatever else ends the wait, ends the workers at once, busy as they may be; so does the death of
    this process.

    Parameters
    ----------
    advance : told of each task that is done.
    workers : most processes at a time; no more than there are cores.

    Raises WorkerError where a worker dies, and what a task raises.
    """
    others = set(active_children())
    with _signals_blocked(signal.SIGHUP):  # starts the tracker of multiprocessing, which would die of it, and complain
        pool = ProcessPoolExecutor(
            min(workers, os.cpu_count() or 1), get_context("spawn"), initializer=_end_with_the_parent
        )
    try:
        with _single_threaded(), _signals_blocked(*_OURS):  # submitting starts the workers, which inherit both
            futures: dict[Future[Any], Task] = {pool.submit(task.function, *task.arguments): task for task in tasks}
        done = {}
        for future in as_completed(futures):
            done[futures[future].key] = future.result()
            advance(1)
    except BaseException as error:
        for process in set(active_children()) - others:
            process.kill()
        pool.shutdown(wait=False, cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            raise WorkerError("a worker process was killed, for want of memory perhaps; run it again") from None
        raise
    pool.shutdown()
    return {task.key: done[task.key] for task in tasks}


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Have processes that are started now use one thread each: faster on small matrices, and the same bits."""
    before = {name: os.environ.get(name) for name in _SINGLE_THREAD}
    os.environ.update(_SINGLE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _signals_blocked(*numbers: signal.Signals) -> Iterator[None]:
    """Keep signals from this thread, and for good from processes that it starts; one that waited comes at the end."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _end_with_the_parent() -> None:
    """End this worker when its parent is gone: nobody else would tell it."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
