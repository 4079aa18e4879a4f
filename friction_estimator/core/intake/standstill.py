"""Standstill known, causally: the force on a shaft that is stuck is no sample of the curve F(v).

Below breakaway the friction of a standing shaft is whatever holds it. Such samples are predicted but not learned from,
and a diagnosis fits no F(v) to them; it keeps them for breakaway and presliding. A shaft stands where its speed stays
below what its velocity channel resolves, for longer than a smooth passage through zero would, and without drifting; or
where its position stays the same to the last bit, at a velocity that is next to nothing.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.intake import lattice
from friction_estimator.core.sample import Bools, Floats, Samples
from friction_estimator.core.settings.units import LATTICE_STEPS

REST_SHARE = 5e-4
"""Share of the velocity scale below which the speed is none: a sixteenth of the finest cell of the curve."""

LEAST_CHANGE = 1e-6
"""Share of the velocity scale below which a change is rounding, and no step of a lattice."""

NOISE_FACTOR = 4.0
"""Standard deviations of the velocity's noise within which it stays at rest."""

LARGEST_SHARE = 0.05
"""Share of the velocity scale above which no noise is taken for rest."""

FEWEST = 10
"""Samples that a rest lasts at least."""

APPROACH, LONGEST_APPROACH = 4.0, 1000.0
"""A rest lasts longer than the approach to it, from this many times its level: at constant deceleration that takes
half as long again as the passage through zero. Beyond that many samples the approach counts no longer."""

MEAN_OVER, MEAN_WITHIN = 256.0, 3.0
"""Samples over which the mean speed at rest is taken, and its standard errors within which it is none (creep is
motion)."""

MOST_OUTSIDE = 2.0
"""Samples in a row by which noise may leave the level without ending the rest."""

ROUGHNESS_RATE = 0.02
"""Relative step of the running median of |v[k] - 2 v[k-1] + v[k-2]|, from which the noise is known."""

_NOISE_OF_ROUGHNESS = 1.0 / (0.6745 * 6.0**0.5)

PREVIOUS, BEFORE, AGE, ROUGHNESS, LATTICE, TIES, NEAR, RUN, NEEDED, MEAN, OUTSIDE = range(11)
"""Places in the state: the last two velocities and how many there are since a restart, the running median, least change
and how often it came, samples since the speed was above the approach, samples at rest level, how many are needed, mean
velocity over them, and samples in a row outside."""

PLACE, STEADY, RESTS, FAST = range(11, 15)
"""Places in the state of the position: its last value, samples in a row at it, 1 where it shows rest, and samples in a
row that are faster."""

STATE_SIZE = 15

WITHOUT_POSITION = 11
"""Size of the state in former versions."""

CREEP_SHARE = 2e-3
"""Share of the velocity scale above which a velocity is believed, whatever the position shows: a quarter of the finest
cell of the curve is what a position that tells nothing (a coarse encoder, one that is read now and then, or not
connected) can withhold."""


@njit(cache=True, forceinline=True)
def stands(state, velocity, begins, scale):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether the shaft stands at this sample, given those before.

    Parameters
    ----------
    state : (STATE_SIZE,), zeros before the first sample. begins : whether a gap lies before. scale : velocity scale.
    """
    if begins:
        state[AGE] = state[RUN] = state[NEAR] = state[OUTSIDE] = 0.0
    if state[AGE] >= 1.0:
        change = abs(velocity - state[PREVIOUS])
        if change > LEAST_CHANGE * scale:
            lattice.learn_step(state, LATTICE, change)
    if state[AGE] >= 2.0:
        second = abs(velocity - 2.0 * state[PREVIOUS] + state[BEFORE])
        if state[ROUGHNESS] == 0.0:
            state[ROUGHNESS] = second
        state[ROUGHNESS] *= 1.0 + ROUGHNESS_RATE if second > state[ROUGHNESS] else 1.0 - ROUGHNESS_RATE
        state[ROUGHNESS] = max(state[ROUGHNESS], LEAST_CHANGE * scale)
    state[BEFORE], state[PREVIOUS] = state[PREVIOUS], velocity
    state[AGE] += 1.0

    noise = _NOISE_OF_ROUGHNESS * state[ROUGHNESS]
    resolved = REST_SHARE * scale
    if state[TIES] >= lattice.TIES:
        resolved = max(resolved, LATTICE_STEPS * state[LATTICE])
    resolved = min(resolved, LARGEST_SHARE * scale)
    level = min(max(resolved, NOISE_FACTOR * noise), LARGEST_SHARE * scale)
    speed = abs(velocity)
    if speed > APPROACH * level:
        state[NEAR] = state[RUN] = state[OUTSIDE] = 0.0
        return False
    state[NEAR] += 1.0
    if speed > level:
        state[OUTSIDE] += 1.0
        if state[OUTSIDE] > MOST_OUTSIDE or state[RUN] <= state[NEEDED]:
            state[RUN] = 0.0
        return False
    state[OUTSIDE] = 0.0
    if state[RUN] == 0.0:
        state[NEEDED] = min(max(FEWEST, state[NEAR]), LONGEST_APPROACH)
        state[MEAN] = 0.0
    state[RUN] += 1.0
    count = min(state[RUN], MEAN_OVER)
    state[MEAN] += (velocity - state[MEAN]) / count
    drift = resolved + MEAN_WITHIN * noise / np.sqrt(count)
    return state[RUN] > state[NEEDED] and abs(state[MEAN]) <= drift


@njit(cache=True, forceinline=True)
def stays(state, position, velocity, begins, scale):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether the position shows that the shaft stands: it is the same to the last bit for `FEWEST` samples.

    A velocity channel that is off by a count, or a little biased, never shows rest. One change, by which a load bends
    what stands, ends no rest; two within `FEWEST` samples do.

    Parameters
    ----------
    position : NaN where there is none. The others as of `stands`.
    """
    state[FAST] = state[FAST] + 1.0 if abs(velocity) > CREEP_SHARE * scale else 0.0
    if np.isnan(position) or state[FAST] > MOST_OUTSIDE:
        state[STEADY] = state[RESTS] = 0.0
        return False
    if begins or state[STEADY] == 0.0 or position != state[PLACE]:
        if begins or state[STEADY] <= FEWEST:
            state[RESTS] = 0.0
        state[STEADY] = 0.0
    state[STEADY] += 1.0
    state[PLACE] = position
    if state[STEADY] > FEWEST:
        state[RESTS] = 1.0
    return state[RESTS] == 1.0


@njit(cache=True, forceinline=True)
def stopping(state, velocity, scale):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return whether a rest may have begun, after `stands` of this sample: no speed for a second sample in a row.

    The first is learned from all the same: at a fast passage the force at zero tells the memory of the contact.
    """
    least = REST_SHARE * scale
    return state[AGE] >= 2.0 and abs(velocity) <= least and abs(state[BEFORE]) <= least


@njit(cache=True, nogil=True)
def _marked(velocity, position, restart, scale, state, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `out` with whether the shaft stands; a rest that is known late is marked from its first sample."""
    for k in range(velocity.size):
        begins = restart[k] or k == 0
        steady = position.size > 0 and stays(state, position[k], velocity[k], begins, scale)
        out[k] = stands(state, velocity[k], begins, scale) or steady
        if out[k]:
            run = max(state[RUN], state[STEADY]) if steady else state[RUN]
            place = k - 1
            while place >= 0 and k - place < run and not out[place] and not restart[place + 1]:
                out[place] = True
                place -= 1


def standstill(samples: Samples, velocity_scale_m_s: float) -> Bools:
    """Return where the shaft stands, (n,), of a whole recording.

    The rule is that of the live estimator; a rest is marked from its beginning though, and noise and lattice of the
    velocity channel are those of the whole recording (a first pass learns them).

    >>> time = np.arange(3000) / 500
    >>> velocity = np.where(time < 3.0, np.sin(2.0 * time), 0.0)
    >>> one = Samples(np.arange(3000), velocity, velocity, np.arange(3000) == 0)
    >>> found = standstill(one, 1.0)
    >>> int(found[:1500].sum()), int(found[1500:].sum())
    (0, 1500)
    """
    state: Floats = np.zeros(STATE_SIZE)
    out = np.zeros(len(samples), np.bool_)
    position = np.zeros(0) if samples.position_m is None else np.ascontiguousarray(samples.position_m)
    for _ in range(2):
        out[:] = False
        _marked(samples.velocity_m_s, position, samples.restart, velocity_scale_m_s, state, out)
    return out
