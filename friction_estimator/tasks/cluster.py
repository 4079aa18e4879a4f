"""Workers of a Dask cluster: what is computed where, and what becomes of a worker that is lost, is Dask's.

Each worker checks that it runs this very code, so that its results are those of this machine to the last bit, as far
as its processor rounds alike.
"""

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from time import monotonic, sleep
from types import TracebackType
from typing import Any

from friction_estimator.core.errors import InputError
from friction_estimator.core.memory import kept
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.tasks import identity
from friction_estimator.tasks.task import LOST, Done, Failure, Task, attempt
from friction_estimator.threads import VARIABLES

CONNECT_S = 10.0
"""Time in which a scheduler must answer."""

WORKERS_S = 30.0
"""Time in which a first worker must be there, and after which it is noticed that there is none any more."""

POLL_S = 0.01
"""Time between two looks for results; the workers have others to compute meanwhile."""

AHEAD, AHEAD_EACH = 64, 4
"""Tasks that the scheduler holds at the least, and for each thread of its workers: no more of them are in memory."""


class Cluster:
    """The workers of a Dask scheduler (context manager).

    Parameters
    ----------
    address : of the scheduler, such as tcp://host:8786.

    Raises
    ------
    ModuleNotFoundError on entry where dask.distributed is not installed, InputError where no scheduler answers or it
    has no workers.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._client: Any = None

    def __enter__(self) -> "Cluster":
        """Connect."""
        from distributed import Client  # noqa: PLC0415 - optional at run time

        # It prints its log on stderr; beside ours it is quiet, and with --debug it is not.
        logger = logging.getLogger("distributed")
        logger.handlers, logger.propagate = [], True
        try:
            self._client = Client(self._address, timeout=CONNECT_S)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {self._address}: no Dask scheduler answers there; start one with `dask scheduler`, or "
                "leave the option out"
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except OSError as error:
            self._close()
            raise self._without_workers() from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let the scheduler forget what is not done."""
        self._close()

    def run(self, tasks: Iterable[Task]) -> Iterator[Done]:
        """Yield each task once it is done; see `Workers.run`."""
        ahead = max(AHEAD, AHEAD_EACH * sum(self._client.nthreads().values()))
        suspects: list[Task] = []
        for done in self._computed(iter(tasks), ahead):
            if done.failure is _KILLED:
                suspects.append(done.task)
            else:
                yield done
        # Dask blames all that a worker held when it died: alone, each is blamed for itself.
        for done in self._computed(iter(suspects), 1):
            yield Done(done.task, failure=Failure(LOST, 2)) if done.failure is _KILLED else done

    def _computed(self, tasks: Iterator[Task], ahead: int) -> Iterator[Done]:
        """Yield tasks as they are done; the failure is `_KILLED` where Dask has given a task up."""
        from distributed import as_completed  # noqa: PLC0415

        pending: dict[Any, Task] = {}
        completed = as_completed(loop=self._client.loop)
        code = identity.code()
        while True:
            for task in islice(tasks, ahead - len(pending)):
                future = self._client.submit(_compute, code, task.function, task.arguments, pure=False)
                pending[future] = task
                completed.add(future)
            if not pending:
                return
            self._await(completed)
            for future in completed.next_batch(block=False):
                if future.status in ("pending", "lost"):  # its result went with its worker: it is computed again
                    completed.add(future)
                else:
                    yield self._done(future, pending.pop(future))

    def _await(self, completed: Any) -> None:
        """Return when a task is done. Raises InputError where nothing computes any more."""
        until = monotonic() + WORKERS_S
        while not completed.has_ready():
            if monotonic() > until:
                self._check_alive()
                until = monotonic() + WORKERS_S
            sleep(POLL_S)  # what waits on all futures at once costs each result some time for every one of them

    def _done(self, future: Any, task: Task) -> Done:
        from distributed import KilledWorker  # noqa: PLC0415

        if future.status == "finished":
            result, failure = future.result()
            return Done(task, result, failure)
        if future.status != "error":
            raise self._lost()
        error = future.exception()
        if isinstance(error, KilledWorker):
            return Done(task, failure=_KILLED)
        if isinstance(error, InputError):
            raise InputError(f"--scheduler {self._address}: {error}") from error
        # Tasks name functions of this package: scheduler and workers unpack them.
        raise InputError(
            f"--scheduler {self._address}: scheduler and workers need friction_estimator and its libraries as they are "
            f"here ({type(error).__name__}: {shown(str(error).partition(chr(10))[0], LONGEST_NAME)})"
        ) from error

    def _check_alive(self) -> None:
        """Raise InputError where nothing computes any more."""
        try:
            workers = self._client.scheduler_info()["workers"]
        except OSError as error:
            raise self._lost() from error
        if self._client.status != "running":
            raise self._lost()
        if not workers:
            raise self._without_workers()

    def _lost(self) -> InputError:
        return InputError(f"--scheduler {self._address}: the connection is lost; run it again, what is done is kept")

    def _without_workers(self) -> InputError:
        return InputError(
            f"--scheduler {self._address}: it has no workers; start some with `dask worker {self._address} "
            "--nthreads 1 --nworkers auto`"
        )

    def _close(self) -> None:
        if self._client is not None:
            with suppress(OSError):
                self._client.close(timeout=CONNECT_S)
            self._client = None


_KILLED = Failure("", 0)


def _compute(code: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Any, Failure | None]:
    """Compute a task on a worker. Raises InputError where its results would not be those of the client."""
    where = os.uname().nodename
    if identity.code() != code:
        raise InputError(
            f"the worker on {where} runs another friction_estimator, or other versions of Python or of "
            f"{', '.join(identity.LIBRARIES)}: install there what is here"
        )
    if any(os.environ.get(name) != "1" for name in VARIABLES):
        raise InputError(
            f"the worker on {where} may use several threads for linear algebra, which changes last bits: start it with "
            f"{'=1 '.join(VARIABLES)}=1, which `dask worker` itself sets unless it is told --no-nanny"
        )
    with kept():
        return attempt(function, arguments)
