"""From two stamped streams to samples: pairing by stamp, then admission in time order.

The live node and replay push the same events through the same two objects, so both see the same samples.

`Pairer` joins a velocity and a friction message of equal stamp (or of nearest stamp within `sync.slop`).
`Sequencer` looks at each joined sample: it refuses what cannot be used, by reason, and marks where the delay
lines must start anew. Both are compiled loops over arrays; one event at a time and a whole recording at once
give the same result.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.intake.tracking import Tracker, track
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints
from friction_estimator.core.settings.groups import InputConfig, SyncConfig

VELOCITY, FRICTION, PRESSURE, TEMPERATURE, POSITION = range(5)
"""Stream numbers of `Pairer.push`; the last three are held channels."""

STREAMS = ("velocity", "friction", "pressure", "temperature", "position")

HELD = 3
AGE = HELD
"""Place of the position's age beside the held channels of a sample."""

HELD_MEMORY = 256
"""Values kept of each held channel, so that one that arrives early can wait for its samples."""

USED, NAN, INFINITE, DUPLICATE_STAMP, BACKWARD_STAMP, ZERO_STAMP, UNMATCHED = range(7)
"""Status of a sample; `REASONS` has their names."""

REASONS = ("used", "nan", "infinite", "duplicate_stamp", "backward_stamp", "zero_stamp", "unmatched")

LARGEST_VALUE = 1e12
"""No sensor reads more (m/s, N, Pa, degC, m): larger magnitudes are refused as `infinite`, their squares would
overflow. A held channel passes over them, as it does over what is no number."""

SMALLEST_VALUE = 1e-30
"""Smaller magnitudes are zero, which no sensor tells them from: their squares would underflow."""


FROM_EITHER, FROM_TOPIC, FROM_POSITION = range(3)
"""Where the velocity comes from: the topic from its first message on and position before, one of them always."""

SOURCES_OF_VELOCITY = {"auto": FROM_EITHER, "topic": FROM_TOPIC, "position": FROM_POSITION}
"""By `input.velocity_from`."""

WAIT_NS = NS_PER_S
"""Time for which positions come alone before they are taken for velocities: another topic may be found later."""

MODE, HEARD, WAIT, FIRST = range(4)
"""Places in the choice of the velocity: where it comes from, whether a velocity message has come, how long to wait for
one, and the stamp of the first position."""


@dataclass(frozen=True)
class Pairs:
    """Joined samples: stamp of the friction message (ns), velocity (m/s), friction (N), each (n,).

    `held` is (n, 4): pressure (absolute Pa), temperature (degC) and position (m), the last value stamped at or before
    the sample, and how much earlier the position was stamped (s); NaN before the first, the age also where a position
    came without a stamp.
    """

    stamp_ns: Ints
    velocity_m_s: Floats
    friction_N: Floats
    held: Floats

    def __len__(self) -> int:
        return int(self.stamp_ns.size)


@njit(cache=True)
def _drop(stamp, last_matched, dropped):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Count a message that will never be joined: a repeat of the last joined stamp, a zero, or unmatched."""
    if stamp == 0:
        dropped[ZERO_STAMP] += 1
    elif stamp == last_matched:
        dropped[DUPLICATE_STAMP] += 1
    else:
        dropped[UNMATCHED] += 1


@njit(cache=True, nogil=True)
def pair(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    stream,
    stamp,
    value,
    slop_ns,
    queue_stamp,
    queue_value,
    queue,
    held_stamp,
    held_value,
    held_count,
    held_now,
    held_at,
    dropped,
    choice,
    velocity_gain,
    clock,
    tracked,
    out_stamp,
    out_velocity,
    out_friction,
    out_held,
):
    """Join events in arrival order; `queue` holds head and count of both rings and the last joined stamp.

    A position is a velocity too where none is measured: the one that `track` finds at its stamp. One that is measured
    is divided by `velocity_gain`, (1,).
    """
    size = queue_stamp.shape[1]
    joined = 0
    for k in range(stamp.size):
        own = stream[k]
        given = 0.0 if abs(value[k]) < SMALLEST_VALUE else value[k]
        if own > FRICTION:
            channel = own - PRESSURE
            if abs(given) <= LARGEST_VALUE:
                place = held_count[channel] % HELD_MEMORY
                held_stamp[channel, place], held_value[channel, place] = stamp[k], given
                held_count[channel] += 1
            if own != POSITION or choice[MODE] == FROM_TOPIC or choice[HEARD]:
                continue
            known, given = track(stamp[k], value[k], clock, tracked)
            if choice[FIRST] == 0:
                choice[FIRST] = stamp[k]
            if not known or (choice[MODE] == FROM_EITHER and abs(stamp[k] - choice[FIRST]) < choice[WAIT]):
                continue
            if abs(given) < SMALLEST_VALUE:
                given = 0.0
            own = VELOCITY
        elif own == VELOCITY:
            if choice[MODE] == FROM_POSITION:
                continue
            choice[HEARD] = 1
            given /= velocity_gain[0]
        other = 1 - own
        best, best_distance = -1, slop_ns + 1
        for position in range(queue[2 + other]):
            distance = abs(queue_stamp[other, (queue[other] + position) % size] - stamp[k])
            if distance < best_distance:
                best, best_distance = position, distance
                if distance == 0:
                    break
        if best < 0:
            if queue[2 + own] == size:
                _drop(queue_stamp[own, queue[own]], queue[4], dropped)
                queue[own] = (queue[own] + 1) % size
                queue[2 + own] -= 1
            place = (queue[own] + queue[2 + own]) % size
            queue_stamp[own, place] = stamp[k]
            queue_value[own, place] = given
            queue[2 + own] += 1
            continue
        # Both streams are past everything older than this match.
        for position in range(best):
            _drop(queue_stamp[other, (queue[other] + position) % size], queue[4], dropped)
        for position in range(queue[2 + own]):
            _drop(queue_stamp[own, (queue[own] + position) % size], queue[4], dropped)
        queue[2 + own] = 0
        place = (queue[other] + best) % size
        queue[other] = (place + 1) % size
        queue[2 + other] -= best + 1
        if own == FRICTION:
            out_stamp[joined] = stamp[k]
            out_velocity[joined], out_friction[joined] = queue_value[other, place], given
        else:
            out_stamp[joined] = queue_stamp[other, place]
            out_velocity[joined], out_friction[joined] = given, queue_value[other, place]
        queue[4] = out_stamp[joined]
        for channel in range(HELD):
            newest = held_count[channel] - 1
            oldest = max(0, held_count[channel] - HELD_MEMORY)
            for position in range(newest, oldest - 1, -1):
                if held_stamp[channel, position % HELD_MEMORY] <= out_stamp[joined]:
                    held_now[channel] = held_value[channel, position % HELD_MEMORY]
                    held_at[channel] = held_stamp[channel, position % HELD_MEMORY]
                    break
            out_held[joined, channel] = held_now[channel]
        at = held_at[POSITION - PRESSURE]
        out_held[joined, AGE] = (out_stamp[joined] - at) / NS_PER_S if at != 0 else np.nan
        joined += 1
    return joined


class Pairer:
    """Join velocity and friction messages by header stamp; each message is used at most once.

    A message waits in its stream's queue (at most `capacity`) until the other stream brings its stamp. A match
    drops what waits before it in both queues. Where no velocity is measured, positions stand for it (`follow`): as long
    as no velocity message has come, or always. Nothing depends on the time of day or on how the two topics
    interleave, so bag loops and clock jumps need no special case here.

    Parameters
    ----------
    sync : slop and queue length.
    capacity : messages kept per stream; `sync.queue` unless given (offline reading can afford more).

    Attributes
    ----------
    tracker : makes velocities of positions.
    """

    def __init__(self, sync: SyncConfig, capacity: int | None = None) -> None:
        size = sync.queue if capacity is None else capacity
        self._slop_ns = round(sync.slop * NS_PER_S)
        self._stamp = np.zeros((2, size), np.int64)
        self._value = np.zeros((2, size))
        self._queue = np.zeros(5, np.int64)
        self._queue[4] = np.iinfo(np.int64).min
        self._held_stamp = np.zeros((HELD, HELD_MEMORY), np.int64)
        self._held_value = np.zeros((HELD, HELD_MEMORY))
        self._held_count = np.zeros(HELD, np.int64)
        self._held_now, self._held_at = np.full(HELD, np.nan), np.zeros(HELD, np.int64)
        self._dropped = np.zeros(len(REASONS), np.int64)
        self._choice, self._velocity_gain = np.zeros(4, np.int64), np.ones(1)
        self.tracker = Tracker()

    def follow(self, config: InputConfig) -> None:
        """Take the velocity as `velocity_from` and `velocity_gain` say, from now on; see `WAIT_NS` where the former
        leaves it open.

        A JointState needs no wait: its position is handed over only where its velocity is empty. Messages without
        stamps are paired by time of receipt, which no position has.
        """
        mode = FROM_TOPIC if config.mode == "float64" else SOURCES_OF_VELOCITY[config.velocity_from]
        if mode != self._choice[MODE]:
            self._choice[:] = 0
        self._choice[MODE] = mode
        self._velocity_gain[0] = config.velocity_gain
        self._choice[WAIT] = 0 if config.mode == "joint_state" else WAIT_NS

    @property
    def tracks(self) -> bool:
        """Whether a position is taken for a velocity."""
        mode, heard, _, _ = self._choice.tolist()
        return mode == FROM_POSITION or (mode == FROM_EITHER and not heard)

    def retune(self, sync: SyncConfig) -> None:
        """Pair by other settings from now on; what waits goes on waiting, the oldest dropped where room is less."""
        self._slop_ns = round(sync.slop * NS_PER_S)
        size, former = sync.queue, self._stamp.shape[1]
        if size == former:
            return
        stamps, values = np.zeros((2, size), np.int64), np.zeros((2, size))
        for stream in (VELOCITY, FRICTION):
            head, count = int(self._queue[stream]), int(self._queue[2 + stream])
            places = (head + np.arange(count)) % former
            for place in places[: max(0, count - size)]:
                _drop(self._stamp[stream, place], self._queue[4], self._dropped)
            kept = places[max(0, count - size) :]
            stamps[stream, : kept.size] = self._stamp[stream, kept]
            values[stream, : kept.size] = self._value[stream, kept]
            self._queue[stream], self._queue[2 + stream] = 0, kept.size
        self._stamp, self._value = stamps, values

    def push(self, stream: ArrayLike, stamp_ns: ArrayLike, value: ArrayLike) -> Pairs:
        """Take events in arrival order; return the samples that they complete.

        Parameters
        ----------
        stream : VELOCITY, FRICTION, PRESSURE, TEMPERATURE or POSITION for each event, (n,) or a scalar for all.
        stamp_ns, value : (n,) or scalar; header stamp in ns, and the value in SI units (pressure absolute).
        """
        stamps = np.atleast_1d(np.asarray(stamp_ns, np.int64))
        values = np.atleast_1d(np.asarray(value, np.float64))
        streams = np.broadcast_to(np.asarray(stream, np.int64), stamps.shape)
        out_stamp = np.empty(stamps.size, np.int64)
        velocity, friction = np.empty(stamps.size), np.empty(stamps.size)
        held = np.empty((stamps.size, HELD + 1))
        n = pair(np.ascontiguousarray(streams), stamps, values, *self.arguments(out_stamp, velocity, friction, held))
        return Pairs(out_stamp[:n], velocity[:n], friction[:n], held[:n])

    def arguments(
        self, out_stamp: Ints, out_velocity: Floats, out_friction: Floats, out_held: Floats
    ) -> tuple[Any, ...]:
        """Return what `pair` takes after the events, to fill the `out` arrays."""
        return (
            self._slop_ns,
            self._stamp,
            self._value,
            self._queue,
            self._held_stamp,
            self._held_value,
            self._held_count,
            self._held_now,
            self._held_at,
            self._dropped,
            self._choice,
            self._velocity_gain,
            self.tracker.clock,
            self.tracker.state,
            out_stamp,
            out_velocity,
            out_friction,
            out_held,
        )

    @property
    def waiting(self) -> tuple[int, int]:
        """Messages that wait for a partner: (velocity, friction)."""
        return int(self._queue[2]), int(self._queue[3])

    def flush(self) -> None:
        """Count what still waits as dropped, and empty the queues (end of a recording, reset)."""
        size = self._stamp.shape[1]
        for stream in (VELOCITY, FRICTION):
            for position in range(self._queue[2 + stream]):
                _drop(
                    self._stamp[stream, (self._queue[stream] + position) % size],
                    self._queue[4],
                    self._dropped,
                )
            self._queue[2 + stream] = 0

    @property
    def dropped(self) -> dict[str, int]:
        """Messages that were never joined, by reason; only reasons that occurred."""
        return {REASONS[i]: int(n) for i, n in enumerate(self._dropped) if n}


@njit(cache=True, nogil=True)
def admit(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    stamp, velocity, friction, gap_factor, jump_ns, clock, events, counts, status, restart
):
    """Classify samples in order; `clock` is [last stamp, samples seen], `events` [period, gaps, jumps]."""
    for k in range(stamp.size):
        restart[k] = False
        reason = USED
        if stamp[k] == 0:
            reason = ZERO_STAMP
        elif np.isnan(velocity[k]) or np.isnan(friction[k]):
            reason = NAN
        elif abs(velocity[k]) > LARGEST_VALUE or abs(friction[k]) > LARGEST_VALUE:
            reason = INFINITE
        elif clock[1] == 0:
            restart[k] = True
        else:
            step = stamp[k] - clock[0]
            if step == 0:
                reason = DUPLICATE_STAMP
            elif step <= -jump_ns:
                restart[k] = True
                events[2] += 1
            elif step < 0:
                reason = BACKWARD_STAMP
            elif events[0] == 0.0:
                events[0] = step
            else:
                if step > gap_factor * events[0]:
                    restart[k] = True
                    events[1] += 1
                # Slow average of the sample period; bounded steps, so that one odd stamp does not move it. Gaps count
                # too, or a sensor that becomes five times slower would be all gaps for ever.
                events[0] += 0.05 * (min(max(step, 0.5 * events[0]), 2.0 * events[0]) - events[0])
        if reason == USED:
            clock[0] = stamp[k]
            clock[1] += 1
        status[k] = reason
        counts[reason] += 1


class Sequencer:
    """Admit samples in time order: refuse by reason, mark restarts.

    Refused are zero, duplicate and late stamps, NaN, infinite and absurd values. A step forward of more than
    `sync.gap_factor` sample periods is a gap; a step back of at least `sync.jump_back` is a jump of the clock
    (a bag that loops). Both restart the delay lines and keep everything that was learned. The sample period is
    a running average, so the rule needs no look ahead.
    """

    def __init__(self, sync: SyncConfig) -> None:
        self.retune(sync)
        self._clock = np.zeros(2, np.int64)
        self._events = np.zeros(3)
        self._counts = np.zeros(len(REASONS), np.int64)

    def retune(self, sync: SyncConfig) -> None:
        """Judge by other settings from now on."""
        self._gap_factor = sync.gap_factor
        self._jump_ns = max(1, round(sync.jump_back * NS_PER_S))

    def admit(self, stamp_ns: Ints, velocity_m_s: Floats, friction_N: Floats) -> tuple[NDArray[np.int8], Bools]:
        """Return (status, restart) for samples in arrival order, each (n,); status indexes `REASONS`."""
        status = np.empty(stamp_ns.size, np.int8)
        restart = np.empty(stamp_ns.size, np.bool_)
        admit(*self.arguments(stamp_ns, velocity_m_s, friction_N, status, restart))
        return status, restart

    def arguments(
        self, stamp_ns: Ints, velocity_m_s: Floats, friction_N: Floats, status: NDArray[np.int8], restart: Bools
    ) -> tuple[Any, ...]:
        """Return what `admit` takes to fill `status` and `restart`."""
        return (
            stamp_ns,
            velocity_m_s,
            friction_N,
            self._gap_factor,
            self._jump_ns,
            self._clock,
            self._events,
            self._counts,
            status,
            restart,
        )

    def forget(self) -> None:
        """Start anew: the next sample restarts the delay lines. The counters stay."""
        self._clock[:] = 0
        self._events[0] = 0.0

    @property
    def counts(self) -> dict[str, int]:
        """Samples by reason (`used` among them); only those that occurred."""
        return {REASONS[i]: int(n) for i, n in enumerate(self._counts) if n}

    @property
    def admitted(self) -> int:
        """Samples admitted."""
        return int(self._counts[USED])

    @property
    def gaps(self) -> int:
        """Gaps seen."""
        return int(self._events[1])

    @property
    def jumps(self) -> int:
        """Backward jumps of the clock seen."""
        return int(self._events[2])

    @property
    def period_s(self) -> float:
        """Running sample period, s; NaN before the second sample."""
        return float(self._events[0] / NS_PER_S) if self._events[0] else float("nan")
