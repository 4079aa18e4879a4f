"""The static curve of the base beside the theory: odd splines of velocity."""

import numpy as np
from scipy.interpolate import BSpline

from friction_estimator.core.sample import Floats
from friction_estimator.core.sums import parts

SPLINES = 12
BEND = 60.0
"""Knots are asinh-spaced in velocity: v_max / BEND is where the spacing begins to grow."""


class OddCurve:
    """Odd cubic splines of velocity, finest near standstill.

    >>> curve = OddCurve(0.1, 12)
    >>> v = np.linspace(-0.1, 0.1, 11)
    >>> bool(np.allclose(curve(v), -curve(-v)))
    True
    """

    def __init__(self, top_m_s: float, count: int = SPLINES) -> None:
        self.top = top_m_s
        self.bend = top_m_s / BEND
        self.count = count
        inside = np.linspace(-1.0, 1.0, 2 * count - 1)
        self._knots = np.concatenate([[-1.0] * 3, inside, [1.0] * 3])

    def __call__(self, velocity_m_s: Floats) -> Floats:
        """Return (n, count)."""
        place = np.arcsinh(np.clip(velocity_m_s, -self.top, self.top) / self.bend) / np.arcsinh(BEND)
        out = np.empty((place.size, self.count))
        for part in parts(place.size):
            full = BSpline.design_matrix(np.clip(place[part], -1.0, 1.0), self._knots, 3).toarray()
            out[part] = (full - full[:, ::-1])[:, full.shape[1] - self.count :]
        return out
