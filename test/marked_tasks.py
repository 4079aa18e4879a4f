"""Tasks that leave a mark for each time they are computed; worker processes import them from here."""

import os
import signal
import time

from friction_estimator.core.errors import InputError


def twice(value, folder):
    """Add a mark for each call, and end the process at 13: always; at 7: the first time."""
    mark = folder / f"{value}.{len(list(folder.glob(f'{value}.*')))}"
    mark.write_text(f"{os.environ['OPENBLAS_NUM_THREADS']} {os.getpid()}")
    if value == 13 or (value == 7 and mark.suffix == ".0"):
        os.kill(os.getpid(), signal.SIGKILL)
    if value == 5:
        raise InputError("five", where="here", remedy="take six")
    if value == 6:
        return 1 / 0
    return 2 * value


def loaded():
    """Mark a process as ready, for `was_loaded`."""
    os.environ["MARKED_TASKS"] = "loaded"


def was_loaded():
    """Return whether `loaded` was called here."""
    return os.environ.get("MARKED_TASKS")


def not_loaded():
    """Fail while a process starts."""
    raise ImportError("nothing to load")


def process_after(pause_s):
    """Return the number of the process after a while."""
    time.sleep(pause_s)
    return os.getpid()
