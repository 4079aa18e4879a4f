"""What a process of this package leaves out of its start.

Half of a start's time is Python making objects that stay: modules, functions, classes. Looking for garbage among them
finds none, and one library loads another that is used by nobody here.
"""

import gc
import sys

START_OBJECTS = 10_000
"""Objects made between two searches for unreachable cycles, Python's own being 700: a start makes some 100,000, nearly
all of which stay, and a search looks at them again and again."""


def spare_the_start() -> None:
    """Search for unreachable cycles seldom, and keep numba from importing `coverage`; before anything else is imported.

    numba imports `coverage` wherever it is installed, to tell it of compiled lines: a twentieth of a start.
    """
    gc.set_threshold(START_OBJECTS)
    sys.modules.setdefault("coverage", None)  # type: ignore[arg-type]
