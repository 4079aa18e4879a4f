"""The work of a sweep as it is handed out: the estimator is loaded by whoever computes it, not by who asks for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from friction_estimator.core.settings.setting import Value
from friction_estimator.tasks.identity import File

FEWEST_BLOCKS, MOST_BLOCKS = 8, 64
"""Blocks of what is judged: one a cycle of two strokes, within these bounds; a row keeps a figure for each."""


@dataclass(frozen=True)
class Job:
    """What a row follows from.

    Attributes
    ----------
    recording : learned from. others : judged on; none: what follows the share that is learned.
    settings : by dotted name, all that differ from the defaults. topics : by input, where the user names them.
    learned_share : of the samples of `recording` where there are no others, above 0 and below 1.
    """

    recording: File
    others: tuple[File, ...]
    settings: Mapping[str, Value]
    topics: Mapping[str, str]
    learned_share: float


def judge(job: Job) -> dict[str, Any]:
    """Return the row of a job; see `judged.row_of`."""
    from friction_estimator.sweep.judged import row_of  # noqa: PLC0415 - a second of imports

    return row_of(job)


def ready() -> None:
    """Load what `judge` needs."""
    import friction_estimator.sweep.judged  # noqa: F401, PLC0415
