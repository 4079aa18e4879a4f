"""The work of a fleet's table as it is handed out: the diagnosis is loaded by whoever computes it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from friction_estimator.core.settings.setting import Value
from friction_estimator.tasks.identity import File


@dataclass(frozen=True)
class Job:
    """What a row follows from: the recording, the settings that differ from the defaults, topics by input, the seed."""

    recording: File
    settings: Mapping[str, Value]
    topics: Mapping[str, str]
    seed: int


def diagnosed(job: Job) -> dict[str, Any]:
    """Return the row of a job; see `diagnosed.row_of`."""
    from friction_estimator.fleet.diagnosed import row_of  # noqa: PLC0415 - a second of imports

    return row_of(job)


def ready() -> None:
    """Load what `diagnosed` needs."""
    import friction_estimator.fleet.diagnosed  # noqa: F401, PLC0415
