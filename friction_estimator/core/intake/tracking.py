"""Velocity from position, causally: a ladder of tracking filters, of which each sample takes the longest that is right.

An encoder of q per count, sampled every T, has differences in steps of q/T: at 4096 counts over a stroke and 1 kHz that
is a good part of the drive's top speed. Tracking filters average over a memory; the right memory depends on how the
drive accelerates at that moment, which nobody has to configure:

- Each filter is the steady-state Kalman filter of position, velocity and acceleration for white jerk: an
  alpha-beta-gamma filter with the poles of a third-order Butterworth filter of corner frequency w (rad a sample), so
  its memory is some 2/w samples. It has no delay at constant acceleration: the velocity is that at its own stamp.
- The filters' corners fall from 1 to 0.001 in steps of 10^(1/6). By Lepski's rule (Lepski 1991; Goldenshluger and
  Nemirovski 1997) the longest memory whose velocity lies within the error bands of all shorter ones is still without
  bias worth mention; where it is not, its error has just come up to its noise, so the one `STEPS_BACK` steps shorter is
  taken. A band is the noise of the filter, and at least what one count more or less makes of its velocity: at less
  than a count a memory the error of an encoder is no white noise.
- Noise and count are those of the positions themselves: least second difference that repeats, and error of the
  parabola through the last three positions.

Wraps are undone first (`encoder`), and a position that is set anew moves the filters along. A gap, and a jump of the
clock, begin anew; the first `WARM_UP` samples after it have no velocity yet.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.intake import encoder, lattice
from friction_estimator.core.intake.encoder import (
    BEYOND_STEPS,
    CHANGES,
    FEWEST_CHANGES,
    LARGEST_POSITION,
    STEP,
    TURNS,
    turned,
)
from friction_estimator.core.sample import NS_PER_S, Floats, Ints

CORNERS: Floats = 10.0 ** (-np.arange(19) / 6.0)
"""Corner frequencies of the filters, rad a sample, shortest memory first."""

NOISE_GAIN, COUNT_GAIN = 1.23, 0.83
"""Of a filter with corner w, per sample period: standard deviation of its velocity over that of white positions, as a
share of w^1.5; most that a step of the position by one count moves it, as a share of w counts. Both hold in the limit
of small w and are upper bounds up to w = 1."""

BAND = 5.0
"""Standard deviations of a filter's velocity within which the longer ones are to lie."""

STEPS_BACK = 3
"""Filters by which the choice stays below the longest one that agrees, unless all do."""

WARM_UP = 8
"""Samples from which a velocity is told."""

NOISE_OF_COUNTS = 0.6
"""Share of a count that the noise of a mere encoder stays below (it is 0.29); of noise, the least difference
that repeats is a small part of it."""

ROUGHNESS_RATE = 0.02
"""Relative step of the running median of the parabola's error."""

LEAST_COUNT, LEAST_NOISE = 0.1, 1e-3
"""Shares of the parabola's largest error below which a second difference is rounding and no count, and the noise stays
no lower: it is to rise again when motion begins. The error after a step of one count is 0.67 counts."""

PEAK_DECAY = 1e-5
"""Share of that largest error which each sample forgets."""

GAP_PERIODS, PERIOD_RATE = 5.0, 0.05
"""A longer step is a gap; the period is a slow average, as in the sequencer."""

JUMP_BACK_NS = NS_PER_S

FILTERS = CORNERS.size

LAST, COUNT = 0, 1
"""Places in the clock: last stamp, samples since the last restart."""

CLOCK_SIZE = 2

PERIOD, VELOCITY, LATTICE, TIES, ROUGHNESS, PEAK, SMOOTH, MEMORY, TOLD, SHOWN_AT = range(10)
"""Places in the state: sample period, velocity told last, count and how often it came, running median and largest of
the parabola's error, positions that followed each other without jump or turn, sum of the memories used and how many,
then the last three positions and the periods between them."""

_FILTERS_AT = SHOWN_AT + 5
_ENCODER_AT = _FILTERS_AT + 3 * FILTERS
STATE_SIZE = _ENCODER_AT + encoder.STATE_SIZE


def gains(corner: float) -> tuple[float, float, float]:
    """Return alpha, beta and gamma of the tracking filter with this corner frequency, rad a sample.

    The filter corrects position, velocity (a period) and acceleration (a squared period) by alpha, beta and gamma times
    its innovation; its poles are exp(s) for the Butterworth poles s = w exp(j pi (1/2 +- 1/6)), -w.

    >>> [round(gain, 6) for gain in gains(0.1)]
    [0.181269, 0.018112, 0.000905]
    """
    poles = np.exp(corner * np.exp(1j * np.pi * np.array([2.0 / 3.0, 1.0, 4.0 / 3.0])))
    _, square, linear, constant = np.real(np.poly(poles)).tolist()
    alpha = 1.0 + constant
    beta = 0.5 * (square - linear + 6.0 - 3.0 * alpha)
    return alpha, beta, 2.0 * (square - alpha - beta + 3.0)


_GAINS: Floats = np.array([gains(corner) for corner in CORNERS.tolist()])
_NOISE: Floats = NOISE_GAIN * CORNERS**1.5
_COUNT: Floats = COUNT_GAIN * CORNERS


def new_state() -> Floats:
    """Return the state before the first position, (STATE_SIZE,)."""
    state = np.zeros(STATE_SIZE)
    state[_ENCODER_AT:] = encoder.new_state()
    return state


@njit(cache=True)
def _parabola_error(x, a, b, c, first, second, third):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the error of the parabola through a, b, c in predicting x, over that of white noise of deviation 1.

    `first`, `second` and `third` are the periods between a, b, c and x.
    """
    at_b, at_a = third + second, third + second + first  # distances from x back
    to_a = third * at_b / ((at_a - third) * (at_a - at_b))
    to_b = -third * at_a / ((at_b - third) * (at_a - at_b))
    to_c = at_b * at_a / ((at_b - third) * (at_a - third))
    return abs(x - to_a * a - to_b * b - to_c * c) / np.sqrt(1.0 + to_a**2 + to_b**2 + to_c**2)


@njit(cache=True)
def _learn_noise(x, step_s, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Learn noise and count of the positions from a new one, `step_s` after three that it follows smoothly."""
    a, b, c = state[SHOWN_AT], state[SHOWN_AT + 1], state[SHOWN_AT + 2]
    error = _parabola_error(x, a, b, c, state[SHOWN_AT + 3], state[SHOWN_AT + 4], step_s)
    state[PEAK] = max(error, (1.0 - PEAK_DECAY) * state[PEAK])
    if state[ROUGHNESS] == 0.0:
        state[ROUGHNESS] = error
    state[ROUGHNESS] *= 1.0 + ROUGHNESS_RATE if error > state[ROUGHNESS] else 1.0 - ROUGHNESS_RATE
    state[ROUGHNESS] = max(state[ROUGHNESS], LEAST_NOISE * state[PEAK])
    least = LEAST_COUNT * state[PEAK]
    if state[LATTICE] < least:
        state[LATTICE], state[TIES] = 0.0, 0.0
    second = abs(x - 2.0 * c + b)
    if second > least:
        lattice.learn_step(state, LATTICE, second)


@njit(cache=True)
def _remember(x, step_s, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Shift the last three positions and the two periods between them."""
    h = SHOWN_AT
    state[h], state[h + 1], state[h + 2] = state[h + 1], state[h + 2], x
    state[h + 3], state[h + 4] = state[h + 4], step_s


@njit(cache=True)
def _filtered(x, step_s, age, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Bring all filters to the new position, the `age`-th since they began; return the chosen velocity."""
    period = state[PERIOD]
    if age == 2:  # a straight line
        grown = (1.0, 1.0, 0.0)
    else:  # a parabola through all positions since: the gains of a memory that grows (Brookner 1998, section 6)
        volume = age * (age + 1.0) * (age + 2.0)
        grown = (3.0 * (3.0 * age * age - 3.0 * age + 2.0) / volume, 18.0 * (2.0 * age - 1.0) / volume, 60.0 / volume)
    count = state[LATTICE]  # of positions without one it becomes next to nothing
    noise = max(state[ROUGHNESS] / 0.6745, count / np.sqrt(12.0))
    low, high, agreeing = -np.inf, np.inf, -1
    for i in range(FILTERS):
        p = _FILTERS_AT + 3 * i
        state[p] += (state[p + 1] + 0.5 * state[p + 2] * step_s) * step_s
        state[p + 1] += state[p + 2] * step_s
        innovation = x - state[p]
        state[p] += max(_GAINS[i, 0], grown[0]) * innovation
        state[p + 1] += max(_GAINS[i, 1], grown[1]) * innovation / period
        if age > 2:
            state[p + 2] += max(_GAINS[i, 2], grown[2]) * innovation / (period * period)
        if agreeing == i - 1:
            band = max(BAND * _NOISE[i] * noise, _COUNT[i] * count) / period
            low, high = max(low, state[p + 1] - band), min(high, state[p + 1] + band)
            if low <= high:
                agreeing = i
    chosen = agreeing if agreeing == FILTERS - 1 else max(agreeing - STEPS_BACK, 0)
    state[MEMORY] += 2.0 / CORNERS[chosen]
    state[TOLD] += 1.0
    return state[_FILTERS_AT + 3 * chosen + 1]


@njit(cache=True)
def track(stamp, shown, clock, state):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take one position; return whether the velocity at its stamp is known, and the velocity.

    It is NaN where the position is none, and the last one where the stamp is not later than the last.
    """
    if stamp == 0 or not abs(shown) <= LARGEST_POSITION:
        return True, np.nan
    step = stamp - clock[LAST]
    begins = (
        clock[COUNT] == 0
        or step <= -JUMP_BACK_NS
        or (state[PERIOD] > 0.0 and step > GAP_PERIODS * state[PERIOD] * NS_PER_S)
    )
    if step <= 0 and not begins:
        return clock[COUNT] >= WARM_UP, state[VELOCITY]
    known = state[_ENCODER_AT + CHANGES] >= FEWEST_CHANGES
    far = BEYOND_STEPS * state[_ENCODER_AT + STEP]
    turns = state[_ENCODER_AT + TURNS]
    x = shown + turned(stamp / NS_PER_S, state[VELOCITY], begins, shown, state[_ENCODER_AT:])
    clock[LAST] = stamp
    if begins:
        clock[COUNT] = 1
        state[_FILTERS_AT:_ENCODER_AT] = 0.0
        state[_FILTERS_AT:_ENCODER_AT:3] = x
        state[SMOOTH] = 1.0
        _remember(x, 0.0, state)
        return False, state[VELOCITY]
    step_s = step / NS_PER_S
    clock[COUNT] += 1
    if state[PERIOD] == 0.0:
        state[PERIOD] = step_s
    bounded = min(max(step_s, 0.5 * state[PERIOD]), 2.0 * state[PERIOD])
    state[PERIOD] += PERIOD_RATE * (bounded - state[PERIOD])
    change = x - state[SHOWN_AT + 2]
    if known and abs(change) > far:  # set anew, or wild: the filters move along
        moved = change - state[VELOCITY] * step_s
        state[_FILTERS_AT:_ENCODER_AT:3] += moved
        state[SHOWN_AT : SHOWN_AT + 3] += moved
        state[SMOOTH] = 0.0
    elif turns != state[_ENCODER_AT + TURNS]:
        state[SMOOTH] = 0.0
    elif state[SMOOTH] >= 3.0:
        _learn_noise(x, step_s, state)
    state[SMOOTH] += 1.0
    _remember(x, step_s, state)
    state[VELOCITY] = _filtered(x, step_s, clock[COUNT], state)
    return clock[COUNT] >= WARM_UP, state[VELOCITY]


@njit(cache=True)
def _tracked(stamp, position, clock, state, velocity):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill `velocity` with what is known, NaN where nothing is."""
    for k in range(stamp.size):
        known, velocity[k] = track(stamp[k], position[k], clock, state)
        if not known:
            velocity[k] = np.nan


class Tracker:
    """The velocity of consecutive positions.

    Examples
    --------
    >>> stamps = np.arange(1, 3001) * 1_000_000
    >>> time = stamps / NS_PER_S
    >>> shown = 1e-5 * np.floor(1e5 * 0.02 * np.sin(6.0 * time))  # an encoder of 10 um
    >>> error = Tracker().push(stamps, shown)[1000:] - 0.12 * np.cos(6.0 * time[1000:])
    >>> bool(np.std(error) < 0.01 * 0.12)  # differences would err by 0.034 of the amplitude
    True
    """

    def __init__(self) -> None:
        self.clock = np.zeros(CLOCK_SIZE, np.int64)
        self.state = new_state()

    def push(self, stamp_ns: Ints, position: Floats) -> Floats:
        """Return the velocity at each position, (n,); NaN where none is known."""
        velocity = np.empty(position.size)
        _tracked(np.ascontiguousarray(stamp_ns), np.ascontiguousarray(position), self.clock, self.state, velocity)
        return velocity

    @property
    def told(self) -> int:
        """Velocities found so far."""
        return int(self.state[TOLD])

    @property
    def memory_s(self) -> float:
        """Mean time over which the filters chosen average, s; NaN before the first."""
        told = float(self.state[TOLD])
        return float(self.state[MEMORY] * self.state[PERIOD] / told) if told else float("nan")

    @property
    def count(self) -> float:
        """Least step of the positions, m or rad; 0 where there is none to see."""
        count, noise = float(self.state[LATTICE]), float(self.state[ROUGHNESS]) / 0.6745
        return count if self.state[TIES] >= lattice.TIES and noise < NOISE_OF_COUNTS * count else 0.0

    def words(self, unit: str) -> str:
        """Return what was found, in words; `unit` is that of the positions."""
        counts = f"counts of {self.count:.3g} {unit}, " if self.count else ""
        return (
            f"tracking filter, {counts}memory of {1e3 * self.memory_s:.3g} ms on average, no delay at constant "
            "acceleration"
        )
