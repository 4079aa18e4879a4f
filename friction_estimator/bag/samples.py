"""From the streams of a recording to samples, by the path that the live node takes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.bag.read import Recording
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.encoder import Wraps
from friction_estimator.core.intake.tracking import Tracker
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config

CHUNK = 65536
"""Events paired at a time."""

LOAD_CHANNELS = {"position": "position_m", "acceleration": "acceleration_m_s2"}
"""What load terms need, made at admission where it was not recorded."""


@dataclass(frozen=True)
class Admitted:
    """Samples of a recording, and what became of its messages.

    Attributes
    ----------
    samples : usable samples; channels that were not recorded are None.
    read : samples and unpaired messages seen, used and rejected together.
    rejected : by reason (see `pairing.REASONS`).
    gaps, jumps : gaps in time, and backward jumps of the clock.
    wraps : wraps of the position's encoder, which were undone.
    tracker : what made velocities of positions; None where they were recorded.
    """

    samples: Samples
    read: int
    rejected: Mapping[str, int]
    gaps: int
    jumps: int
    wraps: Wraps
    tracker: Tracker | None = None


def to_samples(recording: Recording, config: Config) -> Admitted:
    """Pair and admit the messages of a recording, by the path that the live node takes.

    Raises UnanswerableError where no sample is usable; the message counts the reasons.
    """
    intake = Intake(config if "velocity" in recording.streams else config.updated(_position_alone(recording)))
    events = recording.events()
    parts = [
        intake.push(events.stream[part], events.stamp_ns[part], events.value[part])
        for start in range(0, len(events), CHUNK)
        for part in [slice(start, start + CHUNK)]
    ]
    intake.flush()
    last = intake.drain()
    parts += [last] if last is not None else []
    counts = dict(intake.counts)
    used = counts.pop("used", 0)
    if not used:
        raise UnanswerableError(f"{recording.path}: no usable sample: {_why_none(recording, counts)}")

    def joined(name: str) -> NDArray[np.generic]:
        return np.concatenate([getattr(part, name) for part in parts])

    held = {
        field: joined(field) if name in recording.streams else None
        for name, field in (
            ("pressure", "pressure_Pa"),
            ("temperature", "temperature_degC"),
            ("position", "position_m"),
        )
    }
    for name in ("position", "acceleration"):
        if intake.load.needs(name):
            held[LOAD_CHANNELS[name]] = joined(LOAD_CHANNELS[name])
    if intake.encoder.wraps.count:
        held["position_shift_m"] = joined("position_shift_m")
    samples = Samples(
        *(joined(name) for name in ("stamp_ns", "velocity_m_s", "friction_N", "restart")),  # type: ignore[arg-type]
        **held,  # type: ignore[arg-type]
    )
    breaks = intake.sequencer
    return Admitted(
        samples,
        used + sum(counts.values()),
        counts,
        breaks.gaps,
        breaks.jumps,
        intake.encoder.wraps,
        None if "velocity" in recording.streams else intake.pairer.tracker,
    )


def _position_alone(recording: Recording) -> dict[str, object]:
    """Return the settings by which a recording without velocity is taken as the live node takes it."""
    one_message = recording.streams["position"].topic == recording.streams["friction"].topic
    return {"input.mode": "joint_state"} if one_message else {}


def _why_none(recording: Recording, counts: Mapping[str, int]) -> str:
    """Say why no sample is usable."""
    words = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts.items()) or "no messages"
    streams = recording.streams
    velocity, friction = streams.get("velocity", streams.get("position")), streams["friction"]
    if velocity is None:
        return words
    if counts.get("unmatched") and len(velocity) and len(friction):
        size = min(len(velocity), len(friction))
        apart = np.median(np.abs(friction.stamp_ns[:size] - velocity.stamp_ns[:size])) / NS_PER_S
        words += (
            f"; stamps of {velocity.topic} and {friction.topic} differ by about {apart:.3g} s, "
            "set sync.slop below half the sample period to pair by the nearest stamp"
        )
    return words
