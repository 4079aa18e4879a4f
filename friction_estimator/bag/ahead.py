"""Reading that runs ahead of what is done with what was read, in a thread of its own."""

import threading
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class _End:
    """No item follows: the last one was made, or `error` came."""

    error: BaseException | None = None


@contextmanager
def ahead(items: Generator[Item, None, None]) -> Iterator[Iterator[Item]]:
    """Yield the items of a generator, which runs in a thread while the block works on those before.

    What the generator raises is raised where its next item is taken. However the block is left, the generator is
    closed in its thread at its next item, and the thread has ended then.

    Parameters
    ----------
    items : not begun yet: files and connections that it opens belong to one thread. Small ones: as many wait as the
        block is behind.

    Examples
    --------
    >>> with ahead(number * number for number in range(4)) as squares:
    ...     print(list(squares))
    [0, 1, 4, 9]
    """
    made: SimpleQueue[Item | _End] = SimpleQueue()
    left = threading.Event()

    def make() -> None:
        end = _End()
        try:
            with closing(items):
                for item in items:
                    if left.is_set():
                        break
                    made.put(item)
        except BaseException as error:  # whatever it is, the block has to know
            end = _End(error)
        made.put(end)

    def taken() -> Iterator[Item]:
        while not isinstance(item := made.get(), _End):
            yield item
        if item.error is not None:
            raise item.error

    thread = threading.Thread(target=make, name="reading", daemon=True)
    thread.start()
    try:
        yield taken()
    finally:
        left.set()
        thread.join()
