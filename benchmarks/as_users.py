"""The environment that a user's processes have, for those that a benchmark starts."""

import os


def prepare() -> None:
    """Let every process from here on keep the compiled modules of Python.

    PYTHONDONTWRITEBYTECODE, which test machines set, makes each start compile all modules anew: a third of `info`.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
