"""Kinks of the velocity: where a drive of ramps changes its acceleration within a sample.

Trapezoids and triangles of the velocity have them, and steps of the speed (decision 0219).
"""

import numpy as np

from friction_estimator.core.sample import Bools, Floats

KINK = 8.0
"""Times the second difference elsewhere, from which the velocity is taken to have a kink."""
ROUNDING = 1e-6
"""Of the largest velocity: a second difference of less is rounding."""
BESIDE = (2, 3)
"""Samples to each side of a kink that are compared with it: one between two samples shows in both."""
BACK = 0.5
"""Of a second difference, what its neighbour must have against it for both to be a jump."""
AROUND = 5
"""Samples to each side of a kink in which it may show in a force: a time of the force, or a memory, shifts it there."""
MOST_KINKED = 0.15
"""Share of the samples at kinks beyond which they are no exceptions."""


def bends(velocity_m_s: Floats, restart: Bools) -> tuple[Floats, Bools]:
    """Return the second difference of the velocity about each sample, (n,), m/s, and where it has a kink, (n,) bool.

    It is 0 where a sample has no neighbours. At a kink it is far above the usual one, which noise has, and above
    rounding. Where it goes back in the next sample the velocity jumps, by a step of its lattice or by what the drive
    does within a sample: that is one pulse of the acceleration, and no kink.
    """
    v, whole = velocity_m_s, ~restart
    bend = np.zeros(v.size)
    bend[1:-1] = (v[2:] - 2.0 * v[1:-1] + v[:-2]) * (whole[2:] & whole[1:-1])
    size = np.abs(bend)
    some = size > 0.0
    usual = float(np.median(size[some])) if some.any() else 0.0
    found = size > max(KINK * usual, ROUNDING * float(np.abs(v).max(initial=0.0)))
    back = (bend[1:] * bend[:-1] < 0.0) & (np.minimum(size[1:], size[:-1]) > BACK * np.maximum(size[1:], size[:-1]))
    found[1:] &= ~back
    found[:-1] &= ~back
    return bend, found


def at_kinks(velocity_m_s: Floats, restart: Bools) -> Bools:
    """Return the samples at kinks of the velocity, (n,); none where they are no exceptions.

    Which of two accelerations holds there lies between two samples: what acts on it is unknown, and looks late. The
    second difference stands out from that nearby, too: a faster part of the drive bends more everywhere.
    """
    bend, found = bends(velocity_m_s, restart)
    padded = np.pad(np.abs(bend), BESIDE[-1])
    nearby = np.max([padded[BESIDE[-1] + k :][: bend.size] for d in BESIDE for k in (-d, d)], axis=0)
    found &= np.abs(bend) > KINK * nearby
    return found if found.mean() < MOST_KINKED else np.zeros(found.size, np.bool_)


def about(kinks: Bools) -> Bools:
    """Return the samples in which a kink may show in a force, (n,): itself, and `AROUND` to each side.

    >>> about(np.arange(20) == 3).nonzero()[0].tolist()
    [0, 1, 2, 3, 4, 5, 6, 7, 8]
    """
    return np.asarray(np.convolve(kinks, np.ones(2 * AROUND + 1), "same") > 0.5)
