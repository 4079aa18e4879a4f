"""A wrapped encoder unwrapped, causally: the modulus is learned from the jumps.

An absolute encoder shows the position modulo its span: at +12.5 rad it goes on at -12.5, at 2 pi it goes on at 0, while
velocity says that the shaft moved on. `unwrap` adds the turns. It needs no look ahead, so a recording and a live stream
of the same samples get the same positions.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints, Samples

LARGEST_POSITION = 1e12
"""No encoder shows more (m or rad): such values are left as they are."""

FEWEST_CHANGES = 10
"""Changes of the position that must have been seen before one of them can be called a jump."""

BEYOND_STEPS = 8.0
"""A jump is at least this many times the largest change that was none: far beyond what the speed allows. As far the
shaft must have moved before: the position of a shaft that stands is set to zero, but does not wrap."""

STEP_GROWTH = 2.0
"""Factor by which that largest change may grow at once: a wild value must not hide all jumps that follow."""

SPAN_SHARE = 1.05
"""The first jump spans all positions seen, to this factor: an encoder wraps from one end of its span to the other. A
position that is set anew on the way does not."""

REPEATS_WITHIN = 0.02
"""A jump that spans less is learned from when it comes again, within this share."""

WRAP_WITHIN = 0.1
"""Once the modulus M is known: a change within this share of M about a multiple of it is a wrap."""

KNOWN_TRAVEL = 0.25
"""Over a gap the travel that velocity tells is believed up to this share of M; beyond, the nearest turn is taken."""

SHOWN, LOW, HIGH, RATE, CHANGED_AT, TRAVELLED, STEP, MODULUS, JUMPS, TURNS, SUSPECT, VELOCITY, CHANGES, LAST = range(14)
"""Places in the state: raw position shown last, its range, its rate at the last change, when that was, displacement by
velocity since, largest change that was no jump, modulus (0 while unknown), jumps and net turns so far, a jump that may
be one, velocity, changes and stamp of the last sample."""

STATE_SIZE = 14


@njit(cache=True)
def _is_first_wrap(state, change, excess):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether a change of position is the first wrap: far beyond the speed, against it, over the whole span."""
    size, far = abs(change), BEYOND_STEPS * state[STEP]
    if state[CHANGES] < FEWEST_CHANGES or size <= far or state[HIGH] - state[LOW] < far:
        return False
    if np.isnan(state[RATE]) or change * state[TRAVELLED] >= 0.0 or change * state[RATE] >= 0.0:
        return False
    if abs(state[TRAVELLED]) > KNOWN_TRAVEL * size:
        return False
    after = state[SHOWN] + change
    if max(state[HIGH], after) - min(state[LOW], after) <= SPAN_SHARE * size:
        return True
    repeated = abs(abs(excess) - state[SUSPECT]) < REPEATS_WITHIN * state[SUSPECT]
    state[SUSPECT] = abs(excess)
    return repeated


@njit(cache=True)
def turned(now, v, begins, shown, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the turns to add to the position `shown` at the time `now` (s) and velocity v; `begins` after a gap.

    The change that is expected is the last one carried on (velocity channels that are off by a factor of two exist).
    A channel that is slower than the samples shows the same value for a while: then nothing is decided.
    """
    if not abs(shown) <= LARGEST_POSITION:
        return state[TURNS] * state[MODULUS]
    wild = False
    if begins or np.isnan(state[SHOWN]):
        since = now - state[LAST]
        if since < 0.0:
            state[TURNS] = 0.0
        elif state[MODULUS] > 0.0:
            travel = 0.5 * (v + state[VELOCITY]) * since
            if abs(travel) > KNOWN_TRAVEL * state[MODULUS]:
                travel = 0.0
            state[TURNS] -= np.round((shown - state[SHOWN] - travel) / state[MODULUS])
        state[RATE], state[TRAVELLED], state[CHANGED_AT] = np.nan, 0.0, now
    else:
        state[TRAVELLED] += 0.5 * (v + state[VELOCITY]) * (now - state[LAST])
        change = shown - state[SHOWN]
        if change != 0.0:
            since = now - state[CHANGED_AT]
            expected = state[TRAVELLED] if np.isnan(state[RATE]) else state[RATE] * since
            excess = change - expected
            turns = 0.0
            if state[MODULUS] > 0.0:
                turns = np.round(excess / state[MODULUS])
                if abs(excess - turns * state[MODULUS]) > WRAP_WITHIN * state[MODULUS]:
                    turns = 0.0
            elif _is_first_wrap(state, change, excess):
                turns = 1.0 if excess > 0.0 else -1.0
            if turns != 0.0:
                state[JUMPS] += abs(turns)
                state[MODULUS] += (abs(excess / turns) - state[MODULUS]) / state[JUMPS]
                state[TURNS] -= turns
            else:
                step = abs(change)
                wild = state[CHANGES] >= FEWEST_CHANGES and step > BEYOND_STEPS * state[STEP]
                if state[CHANGES] >= FEWEST_CHANGES:
                    step = min(step, STEP_GROWTH * state[STEP])
                state[STEP] = max(state[STEP], step)
                state[RATE] = np.nan if wild or since <= 0.0 else change / since
                state[CHANGES] += 1.0
            state[TRAVELLED], state[CHANGED_AT] = 0.0, now
    if not wild:  # a wild value tells nothing of the span, and the change that follows it is no wrap
        state[LOW], state[HIGH] = min(state[LOW], shown), max(state[HIGH], shown)
    state[SHOWN], state[VELOCITY], state[LAST] = shown, v, now
    return state[TURNS] * state[MODULUS]


@njit(cache=True, nogil=True)
def unwrap(stamp, velocity, restart, position, shift, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add the turns to `position` in place; `shift` is filled with what was added. Nothing is added to no number."""
    for k in range(position.size):
        shift[k] = turned(stamp[k] / NS_PER_S, velocity[k], restart[k], position[k], state)
        position[k] += shift[k]


def new_state() -> Floats:
    """Return the state before the first position, (STATE_SIZE,)."""
    state = np.zeros(STATE_SIZE)
    state[[SHOWN, RATE]] = np.nan
    state[LOW], state[HIGH] = np.inf, -np.inf
    return state


@dataclass(frozen=True)
class Wraps:
    """Wraps that were undone: how many, and the modulus, m or rad; 0 where there were none."""

    count: int
    modulus_m: float


class Encoder:
    """Unwrap the position channel of consecutive samples.

    Examples
    --------
    >>> time = np.arange(400)
    >>> turning = 0.05 * time
    >>> shown = (turning + 1.0) % 6.0
    >>> shift = Encoder().push(time * NS_PER_S, np.full(400, 0.05), time == 0, shown)
    >>> bool(np.allclose(shown, turning + 1.0))
    True
    """

    def __init__(self) -> None:
        self._state = new_state()

    def push(self, stamp_ns: Ints, velocity_m_s: Floats, restart: Bools, position_m: Floats) -> Floats:
        """Unwrap `position_m` in place; return what was added, (n,)."""
        shift = np.empty(position_m.size)
        unwrap(*self.arguments(stamp_ns, velocity_m_s, restart, position_m, shift))
        return shift

    def arguments(
        self, stamp_ns: Ints, velocity_m_s: Floats, restart: Bools, position_m: Floats, shift_m: Floats
    ) -> tuple[Any, ...]:
        """Return what `unwrap` takes."""
        return stamp_ns, velocity_m_s, restart, position_m, shift_m, self._state

    @property
    def wraps(self) -> Wraps:
        """What was undone so far."""
        return Wraps(int(self._state[JUMPS]), float(self._state[MODULUS]))


def wraps_undone(samples: Samples) -> Wraps:
    """Return the wraps that were undone in these samples, by `Samples.position_shift_m`."""
    if samples.position_shift_m is None:
        return Wraps(0, 0.0)
    change = np.abs(np.diff(np.nan_to_num(samples.position_shift_m))[~samples.restart[1:]])
    change = change[change > 0.0]
    if not change.size:
        return Wraps(0, 0.0)
    # With the modulus its mean over the jumps, a change is M and the correction of the turns before.
    return Wraps(int(change.size), float(np.median(change)))
