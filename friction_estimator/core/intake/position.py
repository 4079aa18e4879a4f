"""Position between its messages, and where none was recorded: the velocity carries it on."""

from typing import Any

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints

SAME_S = 1e-6
"""A position's age grows by the time between samples, to this, until a newer one has come; s."""

MEMORY = 256.0
"""Changes of the position over which their ratio to the integral of the velocity is taken."""

FEWEST = 3.0
"""Changes of the position from which its way over that of the velocity is known: before, it is held."""

USUAL, WILD, GROWTH = 10.0, 8.0, 2.0
"""After the first number of changes one of the second number times the largest before is a position that is set anew,
and no motion; that largest one may grow by the third factor at once."""

LATE = 4.0
"""Samples by which a position may come late, for the way since its stamp to be told by the last two velocities."""

LINGERS, RELAX = 1.5, 1.02
"""A value that is shown again is taken for one that was not renewed, for so many times the shortest time between two
changes; that one grows by the second factor at each change."""

AGE, TRAVELLED, WAY, SURE, TOLD, VELOCITY, AT, RATIO, POWER, COUNT, LARGEST, CHANGED, SHORTEST = range(13)
"""Places in the state: age of the position at the last sample (NaN before the first); integral of the velocity since it
was stamped, and that from its last change to the stamp; whether these are all of the way (0 over a gap); its value,
velocity and time of the last sample; changes of the position over those integrals, mean square of these, and their
number; the largest change, the time of the last one, and the shortest time between two."""


@njit(cache=True, nogil=True)
def carry(stamp, velocity, restart, position, age, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add to each `position` what the shaft moved since it was stamped, in place; see `CarriedPosition`."""
    for k in range(velocity.size):
        now, v, told = stamp[k] / NS_PER_S, velocity[k], position[k]
        if np.isnan(told) or np.isnan(age[k]):
            state[AGE] = np.nan
            continue
        known = not (restart[k] or np.isnan(state[AGE]))
        step = now - state[AT] if known else 0.0
        moved = 0.5 * (v + state[VELOCITY]) * step
        until = step - age[k]  # from the last sample to the stamp
        newer = not age[k] > state[AGE] + step - SAME_S  # also where there was none before
        again = told == state[TOLD]
        if again and newer and known and state[SHORTEST] > LINGERS * step:
            newer = now - state[CHANGED] > LINGERS * state[SHORTEST]
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
        if state[COUNT] >= FEWEST:
            position[k] = told + state[RATIO] * state[TRAVELLED]


@njit(cache=True)
def _learn(change, travelled, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take a change of the position into its ratio to the way that the velocity tells: least squares that forget."""
    size = abs(change)
    wild = state[COUNT] >= USUAL and size > WILD * state[LARGEST]
    if state[COUNT] >= USUAL:
        size = min(size, GROWTH * state[LARGEST])
    state[LARGEST] = max(state[LARGEST], size)
    if wild:
        return
    state[COUNT] = min(state[COUNT] + 1.0, MEMORY)
    state[POWER] += (travelled * travelled - state[POWER]) / state[COUNT]
    if state[POWER] > 0.0:
        error = change - state[RATIO] * travelled
        state[RATIO] += error * travelled / (state[COUNT] * state[POWER])


class CarriedPosition:
    """Position at the time of each sample, from messages that come more slowly, or not any more.

    Formula::

        x(t) = x_m + r int_{t_m}^{t} v dt,    t_m <= t the stamp of the last message

    by trapezoids; r, the position's way over that of the velocity (1 where their units and scales agree), is learned
    from message to message, and the position held until it is. So is how often it is renewed: a drive may send a value
    again that it took earlier. A position that is as old as its sample, and renewed as often, is left as it is, to the
    bit. Where the way since the stamp is not known (over a gap, of a message that came late) it is held. Causal: live
    and replay alike.

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
        self._state = np.zeros(13)
        self._state[AGE], self._state[CHANGED] = np.nan, -np.inf

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
