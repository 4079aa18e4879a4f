"""What a live view shows: the last of what a node published, at one moment."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from friction_estimator.core.decimation import MONITOR_WIDTH
from friction_estimator.core.quantities import LINEAR, Quantities
from friction_estimator.core.sample import Floats

TOLD = ("samples per second", "running error rms", "learned part of the velocity range", "arrival to prediction p99")
"""How the names of those values of the status begin that a view shows."""

SILENT_S = 2.0
"""A node that learns publishes twenty batches a second; none for so long is said."""


@dataclass
class Seen:
    """What was last heard, at one moment.

    Attributes
    ----------
    rows : (n, 5), the columns of `MONITOR_COLUMNS`, in order of arrival; the newest only.
    count : rows heard in all; it grows by what is new.
    round : how often the stamps went back (a recording in a loop, a clock that was set): rows are of the last one.
    silent_s : time since the last row; infinite before the first.
    curve : (m, 4), velocity, friction, low, high; None before the first.
    status : the node's own words, "" before the first.
    level : of the status, 0 where all is well, 1 warning, 2 error, 3 stale.
    values : of the status, by name.
    publishers : nodes that publish the monitor.
    quantities : of the drive.
    """

    rows: Floats = field(default_factory=lambda: np.empty((0, MONITOR_WIDTH)))
    count: int = 0
    round: int = 0
    silent_s: float = float("inf")
    curve: Floats | None = None
    status: str = ""
    level: int = 0
    values: Mapping[str, str] = field(default_factory=dict)
    publishers: int = 0
    quantities: Quantities = field(default_factory=lambda: Quantities(LINEAR))

    def since(self, count: int) -> Floats:
        """Return the rows that came after so many."""
        new = min(self.count - count, len(self.rows))
        return self.rows[len(self.rows) - new :]

    @property
    def told(self) -> list[tuple[str, str]]:
        """Name and value of what a view shows of the status."""
        return [(name, value) for begin in TOLD for name, value in self.values.items() if name.startswith(begin)]

    @property
    def silence(self) -> str:
        """Why nothing moves, "" where something does."""
        if not self.publishers:
            return "no node publishes this topic; it is not started, or its name or joint is another (--node, --joint)"
        if self.silent_s == float("inf"):
            return "the node is there, and has not predicted anything yet"
        if self.silent_s > SILENT_S:
            return f"nothing was predicted for {self.silent_s:.0f} s"
        return ""


Look: TypeAlias = Callable[[], Seen]
"""Returns what is known now."""
