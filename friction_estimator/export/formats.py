"""The registry of formats: what a new one has to offer."""

from dataclasses import dataclass
from typing import ClassVar, Protocol

from friction_estimator.core.registry import Registry
from friction_estimator.export.learned import Learned


@dataclass(frozen=True)
class Exported:
    """A text, and what using it costs.

    Attributes
    ----------
    text : of the file.
    error_rms_N : rms error of what the file can say over the recording, N; None where there is no recording.
    """

    text: str
    error_rms_N: float | None


class Format(Protocol):
    """One format of export."""

    summary: ClassVar[str]
    """What it holds, for the help."""

    needs_recording: ClassVar[bool]
    """Whether its figures are fitted to a recording."""

    @staticmethod
    def write(learned: Learned) -> Exported:
        """Return the file's text; raises ConfigError where the model has no such form."""


FORMATS: Registry[type[Format]] = Registry("format")
