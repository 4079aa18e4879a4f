"""Position as the integral of velocity, where none was recorded."""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints


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
