"""Memory that was freed: whether the C library keeps it. Nothing here has an effect where that is not glibc."""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_KEPT = ((-1, "MALLOC_TRIM_THRESHOLD_", 64 << 20), (-3, "MALLOC_MMAP_THRESHOLD_", 32 << 20))
"""Parameters of mallopt (malloc.h), what sets them in the environment, and bytes, the most that glibc itself comes to:
free ones at the end of the heap from which on they go back, and those of an array that is asked of the system alone."""

_USUAL = 128 << 10
"""What glibc begins with, both, and stays at where the environment sets one."""


def give_back() -> None:
    """Return to the machine what was freed.

    What works through a long record in parts leaves free space between what is kept, which longer arrays do not fit
    into: 60 MB of 530 where a record of 1e7 samples was read and fitted.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextmanager
def kept() -> Iterator[None]:
    """Within the block what is freed is kept for what is wanted next, whatever the environment says; then given back.

    glibc learns how large an array is that comes and goes, and gives its pages back all the same where they end the
    heap: the next array is made of pages that have to be cleared first. A replay of 1e7 samples took a tenth longer.
    Dask starts its workers with MALLOC_TRIM_THRESHOLD_ of 64 KiB, where each array goes back: a diagnosis took a third
    more processor time.
    """
    for parameter, _, size in _KEPT:
        _set(parameter, size)
    try:
        yield
    finally:
        if any(variable in os.environ for _, variable, _ in _KEPT):  # else glibc would have come to the same
            for parameter, variable, _ in _KEPT:
                _set(parameter, _asked(variable))
        give_back()


def _set(parameter: int, size: int) -> None:
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(parameter, size)


def _asked(variable: str) -> int:
    """Return what the environment says."""
    with suppress(ValueError):
        return int(os.environ.get(variable, ""))
    return _USUAL
