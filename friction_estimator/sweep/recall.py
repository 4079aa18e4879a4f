"""Recordings that a process has read, kept for the next configuration: reading takes as long as learning."""

from collections import OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from threading import Lock
from typing import Any

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.core.errors import about
from friction_estimator.core.fit.baselines import StaticCurve
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.tasks.identity import File

MOST_BYTES = 256 << 20
"""Kept in a process, the last recordings; one that is larger is read each time. An hour at 1 kHz is 150 MB."""

_GROUPS = ("input", "sync", "load")
"""Settings that decide which samples a recording gives."""


@dataclass(frozen=True)
class Admitted:
    """Samples of a recording, what moves, and curves fitted to parts of it (see `judged`)."""

    samples: Samples
    motion: str
    curves: dict[tuple[int, int], Mapping[str, StaticCurve]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes."""
        arrays = (getattr(self.samples, item.name) for item in fields(Samples))
        return sum(values.nbytes for values in arrays if values is not None)


def keep_only(files: Collection[File]) -> None:
    """Forget all recordings but these.

    The jobs of a sweep come recording by recording: what another one learned from is not asked for again.
    """
    needed = {file.content for file in files}
    with _lock:
        for key in [key for key in _kept if key[0] not in needed]:
            del _kept[key]


def recalled(file: File, config: Config, topics: Mapping[str, str]) -> Admitted:
    """Return the samples of a recording as a configuration admits them, read or as they were kept.

    Raises InputError and UnanswerableError as reading does, and where the recording was changed meanwhile.
    """
    settings = tuple((name, value) for name, value in config.to_mapping().items() if name.split(".")[0] in _GROUPS)
    key = (file.content, settings, tuple(sorted(topics.items())))
    with _lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]
    with about(file.path):
        file.check_unchanged()
        recording = read_recording(file.path, config.input, topics)
        admitted = Admitted(to_samples(recording, config).samples, recording.motion)
    with _lock:
        _kept[key] = admitted
        while sum(item.size for item in _kept.values()) > MOST_BYTES:
            _kept.popitem(last=False)
    return admitted


_kept: "OrderedDict[Any, Admitted]" = OrderedDict()
_lock = Lock()
