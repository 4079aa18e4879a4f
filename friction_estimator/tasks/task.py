"""A piece of work, what comes of it, and who computes it."""

import traceback
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from friction_estimator.core.errors import FrictionEstimatorError, exit_code, sentence

LOST = "its worker process ended twice while it was computed, for want of memory perhaps"
"""Why a task has no result that ended two workers: the second time nothing else was computed."""


@dataclass(frozen=True)
class Task:
    """A pure function of a module, and its arguments; the key names it among those of a run.

    Tasks of one `kin` look at the same thing, such as a recording, which a process that has read it keeps.
    """

    key: Hashable
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    kin: Hashable = None


@dataclass(frozen=True)
class Failure:
    """Why a task has no result: in one line, with the exit code that it would end a program with, and the trace."""

    problem: str
    code: int
    trace: str = ""


@dataclass(frozen=True)
class Done:
    """A task with its result; where there is none, `failure` says why."""

    task: Task
    result: Any = None
    failure: Failure | None = None


class TaskError(FrictionEstimatorError):
    """A task that failed, where all are needed: the failure's words and its exit code."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.problem)
        self.exit_code = failure.code
        if failure.trace:
            self.__cause__ = RemoteTrace(failure.trace)


class RemoteTrace(Exception):
    """The trace of a failure in another process, for `--debug`."""


class Workers(AbstractContextManager["Workers"], Protocol):
    """Processes that compute tasks, for as long as the block lasts."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Done]:
        """Yield each task once it is done, in whatever order; one that fails stops no other.

        A task whose worker is lost is computed again at the end, alone; if it loses a worker again, it has failed.
        """


def attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Any, Failure | None]:
    """Return what a function returns, or why it fails: runs where the task is computed."""
    try:
        return function(*arguments), None
    except Exception as error:
        return None, Failure(sentence(error), exit_code(error), "".join(traceback.format_exception(error)))
