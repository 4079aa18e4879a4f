"""Position between its messages, and where none was recorded: the velocity carries it on."""

from typing import Any

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints

SAME_S = 1e-6
"""A position's age grows by the time between samples, to this, until a newer one has come; s."""

FEWEST, EXPLAINED = 3.0, 0.9
"""A position is carried on after so many changes, while so much of their power is what the velocity says of them."""

MEMORY = 1.0 - 1.0 / 64.0
"""Weight of a change after one more."""

WILD = 8.0
"""A change of this many times the largest before, which the velocity does not say, is a position that is set anew;
where the way is beyond all before as well, the shaft has begun to move."""

BEYOND = 0.5
"""Of the range of all positions seen, beside two of the largest change: how far beyond it one may be carried, when no
more of them come."""

LATE = 4.0
"""Samples by which a position may come late, for the way since its stamp to be told by the last two velocities."""

LINGERS, RELAX = 1.5, 1.02
"""A value that is shown again is taken for one that was not renewed, for so many times the shortest time between two
changes; that one grows by the second factor at each change."""

AGE, TRAVELLED, WAY, SURE, TOLD, VELOCITY, AT, CHANGED, SHORTEST, LARGEST, LOW, HIGH, XX, XY, YY, COUNT = range(16)
"""Places in the state: age of the position at the last sample (NaN before the first); integral of the velocity since it
was stamped, and that from its last change to the stamp; whether this is all of the way (0 over a gap); its value,
velocity and time of the last sample; time of the last change, the shortest time between two, and the largest one; the
range of the values; of changes y and ways x the sums of x^2, x y and y^2, which forget, and how many there were."""


@njit(cache=True, nogil=True)
def carry(stamp, velocity, restart, position, age, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add to each `position` what the shaft moved since it was stamped, in place; see `CarriedPosition`."""
    for k in range(velocity.size):
        now, v, told = stamp[k] / NS_PER_S, velocity[k], position[k]
        if np.isnan(told) or np.isnan(age[k]):
            state[AGE] = np.nan
            continue
        step = now - state[AT] if not (restart[k] or np.isnan(state[AGE])) else 0.0
        known = step > 0.0  # also where stamps are closer than seconds since 1970 tell as a float
        moved = 0.5 * (v + state[VELOCITY]) * step
        until = step - age[k]  # from the last sample to the stamp
        newer = not age[k] > state[AGE] + step - SAME_S  # also where there was none before
        again = told == state[TOLD]
        if again and newer and known and state[SHORTEST] > LINGERS * step:
            newer = now - state[CHANGED] > LINGERS * state[SHORTEST]
            if newer:  # it stands: what a biased velocity says meanwhile is no way
                state[SURE] = 0.0
        if again and not newer:
            state[TRAVELLED] += moved
            state[SURE] = state[SURE] if known else 0.0
        elif known and newer and until >= -LATE * step:
            # What of the way lies before the new stamp belongs to the change since the former one.
            before = (state[VELOCITY] + 0.5 * (v - state[VELOCITY]) * until / step) * until
            state[WAY] += state[TRAVELLED] + before
            if not again:
                if state[SURE] > 0.0:
                    _learn(told - state[TOLD], state[WAY], state)
                state[WAY], state[SURE] = 0.0, 1.0
            state[TRAVELLED] = moved - before if age[k] > 0.0 else 0.0
        else:
            state[TRAVELLED] = state[WAY] = state[SURE] = 0.0
        if not again:
            between = now - age[k] - state[CHANGED]
            if known and between > 0.0 and np.isfinite(between):
                state[SHORTEST] = min(between, RELAX * state[SHORTEST]) if state[SHORTEST] > 0.0 else between
            state[CHANGED] = now - age[k]
        if not known:
            state[CHANGED] = -np.inf
        state[AGE], state[TOLD], state[VELOCITY], state[AT] = age[k], told, v, now
        state[LOW], state[HIGH] = min(state[LOW], told), max(state[HIGH], told)
        if state[COUNT] >= FEWEST and state[XY] * state[XY] > EXPLAINED * state[XX] * state[YY]:
            there = told + state[XY] / state[XX] * state[TRAVELLED]
            margin = BEYOND * (state[HIGH] - state[LOW]) + 2.0 * state[LARGEST]
            position[k] = min(max(there, state[LOW] - margin), state[HIGH] + margin)


@njit(cache=True)
def _learn(change, way, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take in a change of the position, and the way that the velocity told meanwhile."""
    size = abs(change)
    begins = way * way > state[XX]
    said = abs(change * state[XX] - state[XY] * way) <= 0.5 * size * state[XX]
    if state[COUNT] >= FEWEST and size > WILD * state[LARGEST] and not (begins or said):
        return
    state[LARGEST] = max(state[LARGEST], size)
    state[XX] = MEMORY * state[XX] + way * way
    state[XY] = MEMORY * state[XY] + way * change
    state[YY] = MEMORY * state[YY] + change * change
    state[COUNT] += 1.0


class CarriedPosition:
    """Position at the time of each sample, from messages that come more slowly, or not any more.

    Formula::

        x(t) = x_m + r int_{t_m}^{t} v dt,    t_m <= t the stamp of the last message

    by trapezoids; r, the position's way over that of the velocity (1 where their units and scales agree), is learned
    from message to message by least squares that forget. So is how often a position is renewed: a drive may send a
    value again that it took earlier. One that is as old as its sample, and renewed as often, is left as it is, to the
    bit. It is held where the way since the stamp is not known (over a gap, of a message that came late), and while the
    velocity does not say its changes: noise at a standstill, a position that was set anew, few counts. Where none come
    any more it stays near the positions seen. Causal: live and replay alike.

    Examples
    --------
    >>> ms = np.arange(1000)
    >>> speed = np.cos(2e-3 * np.pi * ms)
    >>> position = np.sin(2e-3 * np.pi * ms) / (2.0 * np.pi)
    >>> came = ms // 20 * 20  # of 1000 samples a second, 50 positions
    >>> held = position[came]
    >>> float(np.abs(held - position).max().round(4))
    0.019
    >>> CarriedPosition().push(1_000_000 * ms, speed, ms == 0, held, 1e-3 * (ms - came))
    >>> float(np.abs(held - position)[220:].max().round(4))
    0.0
    """

    def __init__(self) -> None:
        self._state = np.zeros(16)
        self._state[AGE], self._state[CHANGED] = np.nan, -np.inf
        self._state[LOW], self._state[HIGH] = np.inf, -np.inf

    def push(self, stamp_ns: Ints, velocity_m_s: Floats, restart: Bools, position_m: Floats, age_s: Floats) -> None:
        """Carry `position_m` (n,) on in place; `age_s` (n,) is how much earlier than its sample it was stamped."""
        carry(*self.arguments(stamp_ns, velocity_m_s, restart, position_m, age_s))

    def arguments(
        self, stamp_ns: Ints, velocity_m_s: Floats, restart: Bools, position_m: Floats, age_s: Floats
    ) -> tuple[Any, ...]:
        """Return what `carry` takes."""
        return stamp_ns, velocity_m_s, restart, position_m, age_s, self._state


@njit(cache=True)
def _integrate(stamp_ns, velocity, restart, position, state, stamp):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `position` where it is no number; `state` is the last position and velocity, `stamp` the last stamp."""
    for k in range(velocity.size):
        since = 0.0 if restart[k] else (stamp_ns[k] - stamp[0]) / NS_PER_S
        state[0] += 0.5 * (velocity[k] + state[1]) * since
        state[1], stamp[0] = velocity[k], stamp_ns[k]
        if np.isnan(position[k]):
            position[k] = state[0]


class PositionIntegral:
    """Fill in the position from velocity where none was recorded (trapezoid, from 0 at the first sample)."""

    def __init__(self) -> None:
        self._state = np.zeros(2)
        self._stamp = np.zeros(1, np.int64)

    def fill(self, stamp_ns: Ints, velocity_m_s: Floats, restart: Bools, position_m: Floats) -> None:
        """Fill NaN in `position_m` in place."""
        _integrate(stamp_ns, velocity_m_s, restart, position_m, self._state, self._stamp)
