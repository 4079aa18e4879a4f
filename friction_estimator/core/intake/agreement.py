"""Do the channels agree? Velocity against the derivative of position."""

import numpy as np

from friction_estimator.core.sample import Samples

SPAN_S = 0.1
"""Displacements are compared over this time (and at least four samples): noise of a position's derivative is large."""

FEWEST_SPANS = 20


def velocity_over_position_rate(samples: Samples) -> tuple[float, float] | None:
    """Return the velocity over the derivative of position, least squares over displacements, and its standard error.

    None where no position was recorded or too little of it. Channels that are off by a factor of two exist.

    Parameters
    ----------
    samples : with the position unwrapped (`encoder`).

    >>> t = np.arange(2000) / 200
    >>> v = np.cos(t)
    >>> one = Samples((t * 1e9).astype(np.int64), 0.5 * v, v, t == 0.0, position_m=np.sin(t))
    >>> round(velocity_over_position_rate(one)[0], 3)
    0.5
    """
    position, v = samples.position_m, samples.velocity_m_s
    rate = samples.sample_rate_hz
    if position is None or not np.isfinite(rate):
        return None
    span = max(4, round(SPAN_S * rate))
    step = np.where(samples.restart, 0.0, np.diff(samples.time_s, prepend=0.0))
    before = np.concatenate([v[:1], v[:-1]])
    travelled, piece = np.cumsum(0.5 * (before + v) * step), np.cumsum(samples.restart)
    a = np.arange(0, v.size - span, span)
    b = a + span
    whole = (piece[a] == piece[b]) & np.isfinite(position[a]) & np.isfinite(position[b])
    moved, integrated = (position[b] - position[a])[whole], (travelled[b] - travelled[a])[whole]
    power = float(moved @ moved)
    if moved.size < FEWEST_SPANS or not power > 0.0:
        return None
    ratio = float(moved @ integrated) / power
    rest = integrated - ratio * moved
    return ratio, float(np.sqrt(rest @ rest / (moved.size - 1) / power))
