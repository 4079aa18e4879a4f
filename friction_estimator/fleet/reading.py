"""A recording as a diagnosis takes it: a steady offset of the stamps taken out, and told as a fault."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.bag.read import Progress, read_recording
from friction_estimator.bag.recording import Recording
from friction_estimator.bag.samples import Admitted, to_samples
from friction_estimator.core.errors import UnanswerableError, about
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis import streams
from friction_estimator.effects.detection import Fault


@dataclass(frozen=True)
class Read:
    """A recording, its usable samples, and the faults of its stamps."""

    recording: Recording
    admitted: Admitted
    faults: list[Fault]


def read_to_diagnose(path: str, config: Config, topics: Mapping[str, str], progress: Progress | None = None) -> Read:
    """Return a recording for `diagnosis.diagnose`; see `bag.read.read_recording` for the parameters.

    Raises InputError and UnanswerableError as reading does, and where no sample is usable.
    """
    with about(path):
        recording = read_recording(path, config.input, topics, progress)
    velocity = recording.streams.get("velocity") or recording.streams["position"]
    friction = recording.streams["friction"]
    offset = 0
    if velocity.stamped and friction.stamped and velocity.topic != friction.topic:
        offset = streams.offset_ns(velocity.stamp_ns, friction.stamp_ns)
    if offset:
        moved = replace(friction, stamp_ns=friction.stamp_ns - offset)
        recording = replace(recording, streams={**recording.streams, "friction": moved})
    admitted = to_samples(recording, config)
    rate_hz = admitted.samples.sample_rate_hz
    facts = {**admitted.rejected, "read": admitted.read, "stamp_offset_s": offset / NS_PER_S, "period_s": 1.0 / rate_hz}
    if not len(admitted.samples) or not np.isfinite(admitted.samples.velocity_m_s).any():
        raise UnanswerableError(f"{path}: no usable sample; see `friction_estimator info {path}`")
    return Read(recording, admitted, streams.counted(facts))
