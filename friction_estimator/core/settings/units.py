"""Range and units from samples: whether the drive has shown itself, and the range and units that it shows.

It has where there were two reversals of at least 30 % of the largest robust speed, with motion above the noise of rest,
or 10 s of motion. Standing still does not count. `online.first_contact` asks this of the first samples.
"""

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import PARAMETERS, Config

CHOSEN_UNITS = ("learned.velocity_range", "learned.velocity_scale", "learned.force_unit")
"""Settings that are chosen so."""

REVERSALS, REVERSAL_LEVEL = 2, 0.3
"""Reversals that end the contact, and the share of the largest robust speed that each has to reach on both sides."""

MOTION_S = 10.0
"""Time in motion that ends it without reversals (one direction only)."""

NOISE_FACTOR = 6.0
"""Speeds above this many standard deviations of the velocity's noise are motion."""

LATTICE_STEPS = 1.6
"""Steps of a quantised velocity that are no motion: at rest it shows the two levels on either side of zero."""

LATTICE_REPEATS = 4
"""How often the values of a quantised velocity come on average: fast motion shows most of them once."""

LEAST_STEP = 1e-6
"""Share of the largest speed below which a difference is rounding, and no step."""

LEAST_CREEP = 0.01
"""Share of the largest robust speed above which the time in motion counts: a fast homing must not hide slow work."""

LEAST_MOTION = 0.1
"""Share of the largest robust speed above which the shaft counts as moving."""

ALONE = 20
"""Samples of largest speed of which the slowest is compared with the fastest: a wild value is no speed."""

ALONE_ABOVE = 2.0
"""Times the speed of those others above which it is one."""

MARGIN = 1.05
"""Ranges reach this much beyond the largest velocity."""

LEAST_SIDE = 0.05
"""Share of the velocity scale that a range covers at least on either side of standstill: noise at rest lies inside."""

NO_VELOCITY, NO_FORCE = 0.15, 10.0
"""Scales (m/s and N) where a recording ends without any motion, or without any friction."""


def with_units_of(config: Config, other: Config) -> Config:
    """Return a configuration with the range and units of another one."""
    return config.updated({name: PARAMETERS[name].of(other) for name in CHOSEN_UNITS})


def shown(samples: Samples) -> bool:
    """Return whether the drive has shown itself in these samples."""
    velocity = samples.velocity_m_s
    speed = np.abs(velocity)
    noise = max(NOISE_FACTOR * rest_noise(samples), LATTICE_STEPS * lattice_step(velocity))
    top = robust_top([speed])
    if not top > 0.0:
        return False
    level = REVERSAL_LEVEL * top
    if level > noise:
        side = np.sign(velocity[(speed >= level) & (speed <= ALONE_ABOVE * top)])
        if np.count_nonzero(np.diff(side)) >= REVERSALS:
            return True
    moving = np.count_nonzero(speed > max(noise, LEAST_CREEP * top))
    rate = samples.sample_rate_hz
    return bool(moving > MOTION_S * rate)


def chosen(config: Config, velocity_m_s: Floats, friction_N: Floats) -> Config:
    """Return the configuration with what is open filled in from these samples, (n,) each.

    The first contact gives it its first samples; batch fits, which know them all, give all that they fit.
    """

    def finite() -> Iterator[tuple[Floats, Floats]]:
        for part in sums.parts(velocity_m_s.size):
            velocity, friction = velocity_m_s[part], friction_N[part]
            known = np.isfinite(velocity) & np.isfinite(friction)
            yield velocity[known], friction[known]

    top = robust_top(np.abs(velocity) for velocity, _ in finite())
    values: dict[str, object] = {}
    if config.reach is None:
        scale = MARGIN * top if top > 0.0 else NO_VELOCITY
        one_way = [robust_top(np.maximum(sign * velocity, 0.0) for velocity, _ in finite()) for sign in (-1.0, 1.0)]
        low, high = (max(MARGIN * min(side, top), LEAST_SIDE * scale) for side in one_way)
        values |= {"learned.velocity_range": (-low, high), "learned.velocity_scale": scale}
    if not config.unit_N > 0.0:
        slowest = LEAST_MOTION * top
        unit = usual_magnitude(lambda: (friction[np.abs(velocity) > slowest] for velocity, friction in finite()))
        values["learned.force_unit"] = unit or usual_magnitude(lambda: (f for _, f in finite())) or NO_FORCE
    return config.updated(values)


def rest_noise(samples: Samples) -> float:
    """Return the standard deviation of the white noise of velocity, m/s, from its second differences.

    Of a motion that is smooth over three samples, v[k] - 2 v[k-1] + v[k-2] holds only noise, of six times its power;
    the median is that of rest even where the shaft moves for a part of the time.
    """
    velocity = samples.velocity_m_s
    if velocity.size < 3:
        return 0.0
    second = velocity[2:] - 2.0 * velocity[1:-1] + velocity[:-2]
    follows = ~(samples.restart[2:] | samples.restart[1:-1])
    second = second[follows]
    return float(np.median(np.abs(second))) / 0.6745 / math.sqrt(6.0) if second.size else 0.0


def lattice_step(velocity_m_s: Floats) -> float:
    """Return the least step between the values of a quantised channel that shows few of them, m/s; 0 for any other.

    At rest such a channel shows the value or two next to zero, exactly, over and over. Where it shows one value only,
    that is the step: nothing says that it is more.

    >>> round(lattice_step(np.tile([0.1, -0.1, 0.1, 0.3], 8)), 3), lattice_step(np.linspace(-1.0, 1.0, 32))
    (0.2, 0.0)
    """
    values = np.unique(velocity_m_s)
    if values.size * LATTICE_REPEATS > velocity_m_s.size:
        return 0.0
    largest = float(np.abs(values).max())
    step = np.diff(values)
    return float(step[step > largest * LEAST_STEP].min(initial=largest))


def robust_top(speeds: Iterable[Floats]) -> float:
    """Return the largest of the speeds, which come in pieces, passing over values that stand more than twice above the
    others.

    >>> robust_top([np.linspace(0.0, 1.0, 1000), np.array([50.0])]) < 1.0
    True
    """
    count, largest = 0, np.empty(0)
    for piece in speeds:
        count += piece.size
        most = np.partition(piece, -ALONE)[-ALONE:] if piece.size > ALONE else piece
        largest = np.sort(np.concatenate([largest, most]))[-ALONE:]
    if not count:
        return 0.0
    usual, top = float(largest[-min(ALONE, max(1, count // 50))]), float(largest[-1])
    return usual if top > ALONE_ABOVE * usual > 0.0 else top


def usual_magnitude(frictions: Callable[[], Iterable[Floats]]) -> float:
    """Return the rms of friction while there is some, N; 0 where there is none.

    Spikes (the largest 2 %) are cut off, and what is below a tenth of the rest is left out, so that neither a wild
    sensor nor a long standstill decides.

    `frictions` : gives the values in pieces, anew at each call.
    """

    def magnitudes() -> Iterator[Floats]:
        for piece in frictions():
            yield np.abs(piece[np.isfinite(piece)])

    count, largest = 0, 0.0
    for piece in magnitudes():
        count, largest = count + piece.size, max(largest, float(piece.max(initial=0.0)))
    top = (sums.upper_quantile(magnitudes(), count, 0.98) if count else 0.0) or largest
    if not top > 0.0:
        return 0.0
    moving = sum(int(np.count_nonzero(piece >= 0.1 * top)) for piece in magnitudes())
    squares = (np.square(np.minimum(piece[piece >= 0.1 * top], top) / top) for piece in magnitudes())
    return top * float(np.sqrt(sums.total(squares, moving) / moving))
