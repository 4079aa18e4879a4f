"""Processes of this machine that compute tasks, and end with this one however it ends.

One task at a time in each process, so that a process that dies tells which task it died of: `concurrent.futures` gives
up all of its work then.
"""

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import TracebackType

from friction_estimator.core.memory import kept
from friction_estimator.startup import spare_the_start
from friction_estimator.tasks.task import LOST, Done, Failure, Task, attempt
from friction_estimator.threads import VARIABLES

MOST_WORKERS = 256

LARGEST_IDLE = 1 << 30
"""Resident bytes of a process that is done with a task above which another takes its place: a few large recordings
leave a heap in pieces, and 2000 small ones must not add up."""

_OURS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that may reach the whole group (Ctrl-C, a closed terminal): the verb obeys them, and ends its workers."""

_SINGLE_THREAD = dict.fromkeys(VARIABLES, "1")


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


class LocalWorkers:
    """Processes of this machine (context manager); they start with the block where they are to be ready, else with the
    first task.

    An interrupt, or whatever else ends the block, ends them at once, busy as they may be; so does the death of this
    process.

    Parameters
    ----------
    count : processes at a time. ready : a function of a module that each calls as it starts: it loads what tasks need.
    """

    def __init__(self, count: int, ready: Callable[[], None] | None = None) -> None:
        self._count, self._ready = count, ready
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, _Worker] = {}

    def __enter__(self) -> "LocalWorkers":
        """Start the processes that are to be ready."""
        if self._ready is not None:
            self._idle = [_started(self._ready) for _ in range(self._count)]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End every process."""
        for worker in (*self._idle, *self._busy.values()):
            worker.process.kill()
        for worker in (*self._idle, *self._busy.values()):
            worker.process.join()
            worker.connection.close()
        self._idle, self._busy = [], {}

    def run(self, tasks: Iterable[Task]) -> Iterator[Done]:
        """Yield each task once it is done; see `Workers.run`."""
        suspects: list[Task] = []
        for done in self._computed(tasks, self._count):
            if done.failure is _DIED:
                suspects.append(done.task)
            else:
                yield done
        for done in self._computed(suspects, 1):  # alone: each for itself may have found memory enough
            yield Done(done.task, failure=Failure(LOST, 2)) if done.failure is _DIED else done

    def _computed(self, tasks: Iterable[Task], count: int) -> Iterator[Done]:
        """Yield tasks as they are done by `count` processes; the failure is `_DIED` where the process died of it."""
        waiting = Waiting(tasks)
        while waiting or self._busy:
            while waiting and len(self._busy) < count:
                worker = self._idle.pop() if self._idle else _started(self._ready)
                task = waiting.take(worker.task)
                if worker.begin(task):
                    self._busy[worker.connection] = worker
                else:  # it died without work
                    waiting.give_back(task)
                    worker.end()
            for connection in wait(list(self._busy)):
                assert isinstance(connection, Connection)
                worker = self._busy[connection]
                done = worker.done()
                del self._busy[connection]
                if done.failure is not _DIED and worker.resident <= LARGEST_IDLE:
                    self._idle.append(worker)
                else:
                    worker.end()
                yield done


class Waiting:
    """Tasks that nobody computes yet, handed out so that few processes look at the same thing.

    A process goes on with the kin of its last task. When they are all handed out it takes a kin that nobody has begun,
    and when all are begun, that of which most is left.

    Examples
    --------
    >>> tasks = [Task(key, print, (), kin=key[0]) for key in ("a1", "a2", "b1", "b2", "b3")]
    >>> waiting = Waiting(tasks)
    >>> first, second = waiting.take(None), waiting.take(None)
    >>> first.key, second.key, waiting.take(first).key, waiting.take(first).key, waiting.take(second).key, bool(waiting)
    ('a1', 'b1', 'a2', 'b2', 'b3', False)
    """

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._left: dict[Hashable, deque[Task]] = {}
        for task in tasks:
            self._left.setdefault(task.kin, deque()).append(task)
        self._new = deque(self._left)  # kins that nobody has begun, as far as is known here

    def __bool__(self) -> bool:
        return bool(self._left)

    def take(self, last: Task | None) -> Task:
        """Return the next task for a process that has computed `last`; there is one."""
        kin = None if last is None else last.kin
        while kin not in self._left and self._new:
            kin = self._new.popleft()
        if kin not in self._left:
            kin = max(self._left, key=lambda kin: len(self._left[kin]))
        task = self._left[kin].popleft()
        if not self._left[kin]:
            del self._left[kin]
        return task

    def give_back(self, task: Task) -> None:
        """Take back a task that was handed out in vain."""
        self._left.setdefault(task.kin, deque()).appendleft(task)


_DIED = Failure("", 0)


@dataclass
class _Worker:
    """A process, our end of the pipe to it, the task that it computes and the memory that it held after the last."""

    process: SpawnProcess
    connection: Connection
    task: Task | None = None
    resident: int = 0

    def begin(self, task: Task) -> bool:
        """Hand a task over; False where the process is gone."""
        self.task = task
        with suppress(OSError):
            self.connection.send((task.function, task.arguments))
            return True
        return False

    def done(self) -> Done:
        """Take over what came of the task; the process has sent it, or is gone."""
        assert self.task is not None
        try:
            (result, failure), self.resident = self.connection.recv()
        except (EOFError, OSError):
            return Done(self.task, failure=_DIED)
        return Done(self.task, result, failure)

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.join()
        self.connection.close()


def _started(ready: Callable[[], None] | None) -> _Worker:
    """Start a process; it has one thread for linear algebra, and is deaf to what the terminal sends to all."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, ready), daemon=True)
    with _signals_blocked(*_OURS):
        # The tracker of multiprocessing, which a signal would kill, and it complain. Where it starts with the first
        # process it unblocks signals that it blocked itself, and that process hears them.
        resource_tracker.ensure_running()
    with _single_threaded(), _signals_blocked(*_OURS):
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _serve(connection: Connection, ready: Callable[[], None] | None) -> None:
    """Compute what comes through the pipe, until it is closed: what a worker process does."""
    spare_the_start()
    _end_with_the_parent()
    if ready is not None:
        with suppress(Exception):  # the task that needs it says what is wrong
            ready()
    with suppress(EOFError, OSError), kept():
        while True:
            function, arguments = connection.recv()
            connection.send((attempt(function, arguments), _resident()))


def _resident() -> int:
    """Return the resident memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")


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
    """End this worker when its parent is gone: nobody else would tell it while it computes."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
