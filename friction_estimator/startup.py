"""What a process of this package leaves out of its start.

Half of a start's time is Python making objects that stay: modules, functions, classes. Looking for garbage among them
finds none, and one library loads another that is used by nobody here.
"""

import gc
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader

LAZY = ("numpy.f2py", "numpy.testing", "scipy.linalg._decomp_interpolative", "scipy.spatial.transform")
"""Modules that nobody uses here and others import: scipy takes all of numpy's names, and its solvers of linear programs
have Fourier transforms and rotations loaded, a seventh of the start of a diagnosis."""

START_OBJECTS = 10_000
"""Objects made between two searches for unreachable cycles, Python's own being 700: a start makes some 100,000, nearly
all of which stay, and a search looks at them again and again."""


class _WhenUsed:
    """Finds `LAZY`, and has each loaded where its first attribute is asked for."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: object = None) -> ModuleSpec | None:  # noqa: ARG004
        """Return the spec of those modules alone; the arguments are those that Python hands over."""
        if name not in LAZY:
            return None
        spec = PathFinder.find_spec(name, path)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def spare_the_start() -> None:
    """Search for unreachable cycles seldom, and leave out two imports; to be called before anything else is imported.

    numba imports `coverage` wherever it is installed, to tell it of compiled lines: a twentieth of a start. As much
    goes with `LAZY`, which is loaded when somebody uses it.
    """
    gc.set_threshold(START_OBJECTS)
    sys.modules.setdefault("coverage", None)  # type: ignore[arg-type]
    if _WhenUsed not in sys.meta_path:
        sys.meta_path.insert(0, _WhenUsed)
