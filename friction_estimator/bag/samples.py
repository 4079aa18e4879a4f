"""From the streams of a recording to samples, by the path that the live node takes."""

from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import PurePath
from threading import Lock

import numpy as np

from friction_estimator.bag.merge import Events, OutOfOrderError
from friction_estimator.bag.read import Progress, Reading, read_recording
from friction_estimator.bag.recording import Outline, Recorded, Recording
from friction_estimator.bag.source import Source
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.growing import Column
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.encoder import Wraps
from friction_estimator.core.intake.tracking import Tracker
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.config import Config

CHUNK = 32768
"""Events paired at a time."""

LOAD_CHANNELS = {
    "position": ["position_m"],
    "acceleration": ["acceleration_m_s2", "acceleration_variance", "acceleration_doubt"],
}
"""What load terms need, made at admission where it was not recorded."""


_ALWAYS = ("stamp_ns", "velocity_m_s", "friction_N", "restart")

_HELD = {"pressure": "pressure_Pa", "temperature": "temperature_degC", "position": "position_m"}

_TYPES: Mapping[str, type[np.generic]] = {"stamp_ns": np.int64, "restart": np.bool_}


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


@dataclass(frozen=True)
class Begins:
    """A recording begins; what came of it before is void.

    Attributes
    ----------
    motion : "linear" or "rotary".
    """

    motion: str


@dataclass(frozen=True)
class Piece:
    """Samples that were admitted; they stay where all of them are kept until they are asked for.

    Attributes
    ----------
    admission : that keeps them. part : of its samples.
    """

    admission: "Admission"
    part: slice

    def samples(self) -> Samples:
        """Return them, with the channels that are kept; in any thread."""
        return self.admission.kept(self.part)


@dataclass(frozen=True)
class Read:
    """A recording is read."""

    recording: Recorded
    admitted: Admitted


def read_samples(
    path: str | PurePath | Source,
    config: Config,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> tuple[Recorded, Admitted]:
    """Read a recording and admit its samples, as `read_recording` and `to_samples` do, in less memory.

    Raises as `read_recording` and `to_samples`.
    """
    for item in sample_pieces(path, config, topics, progress):
        if isinstance(item, Read):
            return item.recording, item.admitted
    raise AssertionError


def sample_pieces(
    path: str | PurePath | Source,
    config: Config,
    topics: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> Generator[Begins | Piece | Read, None, None]:
    """Read a recording and admit its samples; yield them as they are admitted, and what was found at the end.

    Messages are paired as they are read and then let go. Where the recording is not as it says (messages out of order,
    an input that turns out to hold nothing), it begins anew and is read whole.

    Raises as `read_recording` and `to_samples`.
    """
    with Reading(path, config.input, topics, progress) as reading:
        yield Begins(reading.motion)
        admission = Admission(config, reading.names, _is_one_message(reading.topics))
        try:
            for events in reading.events():
                yield from admission.push(events)
            outline: Outline | None = reading.outline()
        except OutOfOrderError:
            outline = None
    if outline is None or set(outline.streams) != set(reading.names):
        admission.let_go()
        recording = read_recording(path, config.input, topics, progress)
        yield Begins(recording.motion)
        yield Read(recording, to_samples(recording, config))
        return
    yield from admission.last()
    yield Read(outline, admission.admitted(outline))


def to_samples(recording: Recording, config: Config) -> Admitted:
    """Pair and admit the messages of a recording, by the path that the live node takes.

    Raises UnanswerableError where no sample is usable; the message counts the reasons.
    """
    topics = {name: stream.topic for name, stream in recording.streams.items()}
    admission = Admission(config, topics, _is_one_message(topics))
    for _ in chain(admission.push(recording.events()), admission.last()):
        pass
    return admission.admitted(recording)


class Admission:
    """Pairs and admits events piece by piece.

    Parameters
    ----------
    names : the inputs that there are.
    one_message : whether position and friction come in one message (see `Pairer.follow`).
    """

    def __init__(self, config: Config, names: Iterable[str], one_message: bool) -> None:
        self._names = frozenset(names)
        alone = {"input.mode": "joint_state"} if one_message and "velocity" not in self._names else {}
        self._intake = Intake(config.updated(alone))
        held = [field for name, field in _HELD.items() if name in self._names]
        made = [field for name, fields in LOAD_CHANNELS.items() if self._intake.load.needs(name) for field in fields]
        shift = ["position_shift_m"] if "position" in self._names else []
        names = dict.fromkeys([*_ALWAYS, *held, *made, *shift])
        self._columns = {name: Column(_TYPES.get(name, np.float64)) for name in names}
        self._count = 0
        self._whole: Samples | None = None
        self._lock = Lock()  # a column that grows may be moved while another thread looks at it

    def push(self, events: Events) -> Iterator[Piece]:
        """Take events in recorded order; yield the samples that they complete."""
        for start in range(0, len(events), CHUNK):
            part = slice(start, start + CHUNK)
            yield self._keep(self._intake.push(events.stream[part], events.stamp_ns[part], events.value[part]))

    def last(self) -> Iterator[Piece]:
        """Yield the samples that wait for others that will not come; all events have come."""
        self._intake.flush()
        last = self._intake.drain()
        if last is not None:
            yield self._keep(last)

    def _keep(self, samples: Samples) -> Piece:
        with self._lock:
            for name, column in self._columns.items():
                column.extend(getattr(samples, name))
        first, self._count = self._count, self._count + len(samples)
        return Piece(self, slice(first, self._count))

    def kept(self, part: slice) -> Samples:
        """Return some of the samples that are kept; in any thread."""
        with self._lock:
            if self._whole is not None:
                return self._whole[part]
            return Samples(**{name: column.copied(part) for name, column in self._columns.items()})

    def let_go(self) -> None:
        """Keep no sample any longer: pieces are empty from now on."""
        with self._lock:
            self._whole = Samples(**{name: column.taken()[:0] for name, column in self._columns.items()})

    def admitted(self, recording: Recorded) -> Admitted:
        """Return the samples of the recording, of which all are kept. Raises UnanswerableError as `to_samples`."""
        intake = self._intake
        counts = dict(intake.counts)
        used = counts.pop("used", 0)
        if not used:
            raise UnanswerableError(f"{recording.path}: no usable sample: {_why_none(recording.whole(), counts)}")
        with self._lock:
            self._whole = Samples(**{name: column.taken() for name, column in self._columns.items()})
        breaks = intake.sequencer
        return Admitted(
            self._whole if intake.encoder.wraps.count else replace(self._whole, position_shift_m=None),
            used + sum(counts.values()),
            counts,
            breaks.gaps,
            breaks.jumps,
            intake.encoder.wraps,
            None if "velocity" in self._names else intake.pairer.tracker,
        )


def _is_one_message(topics: Mapping[str, object]) -> bool:
    """Return whether position and friction come in one message."""
    return "position" in topics and topics["position"] == topics["friction"]


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
