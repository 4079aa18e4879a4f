"""Memory that was freed: whether the C library keeps it. Nothing here has an effect where that is not glibc."""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt, of malloc.h."""

LARGEST_KEPT, USUAL = 32 << 20, 128 << 10
"""Bytes from which on memory is asked of the system and given back by itself: what glibc may raise that to, and what it
begins with."""


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

    Dask starts its workers with MALLOC_TRIM_THRESHOLD_ of 64 KiB: each array that is freed goes back to the system, and
    the next one is made of pages that it has to clear first. A diagnosis took a third more processor time.
    """
    _set(TRIM_THRESHOLD, 2 * LARGEST_KEPT)
    _set(MMAP_THRESHOLD, LARGEST_KEPT)
    try:
        yield
    finally:
        _set(TRIM_THRESHOLD, _asked("MALLOC_TRIM_THRESHOLD_"))
        _set(MMAP_THRESHOLD, _asked("MALLOC_MMAP_THRESHOLD_"))
        give_back()


def _set(parameter: int, size: int) -> None:
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(parameter, size)


def _asked(name: str) -> int:
    """Return what the environment says."""
    with suppress(ValueError):
        return int(os.environ.get(name, ""))
    return USUAL
