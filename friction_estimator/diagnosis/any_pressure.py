"""What any dependence on the recorded pressure could make of a model's force.

Where the pressures come in one order, a slow change and a dependence on the pressure are one thing between two
pressures. What goes on within each of them is no matter of the pressure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.sample import Floats, Ints
from friction_estimator.diagnosis.forms import SHARE
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.lack_of_fit import Wider
from friction_estimator.diagnosis.pressures import recorded_steps
from friction_estimator.diagnosis.record import pressure_range
from friction_estimator.effects.features import Features
from friction_estimator.effects.shapes import SHAPES, splines
from friction_estimator.effects.whole import FirstOrder

TENTHS = 10
"""Parts of the pressures' range that count as one pressure each."""

LATE = (0.1, 0.3, 1.0)
"""Time constants, over the time for which a pressure is held on the mean, with which friction may follow a pressure."""


@dataclass(frozen=True)
class AnyPressure(Wider):
    """A model's tangent, and beside it its whole force with another share at each speed and pressure.

    The share may follow the pressure late: a seal creeps into its groove, a chamber fills behind its sensor.

    Attributes
    ----------
    model : fitted. cell : (n,), which of the pressures it was. count : number of pressures.
    behind : (n, times), how far such a pressure is behind the recorded one, over the range.
    """

    model: Joint
    cell: Ints
    count: int
    behind: Floats

    @classmethod
    def of(cls, model: Joint) -> "AnyPressure":
        """Return those of a model."""
        f = model.features
        low, high = pressure_range(f.pressure_Pa)
        span = (high - low) or 1.0
        place = np.clip((f.pressure_Pa - low) / span, 0.0, 1.0)
        there, cell = np.unique(np.minimum(TENTHS * place, TENTHS - 1).astype(np.int64), return_inverse=True)
        return cls(model, cell, there.size, _behind(place, f, there.size))

    @property
    def width(self) -> int:
        """Number of columns beside the tangent."""
        return SHAPES * (self.count + int(self.behind.shape[1]))

    def beside(self, part: slice) -> Sequence[Floats]:
        """Return the columns beside the tangent for some samples."""
        f = self.model.features[part]
        by_speed = SHARE * f.force_N[:, None] * splines(f.velocity_m_s, self.model.reference)
        here = self.cell[part, None] == np.arange(self.count)
        shares = np.column_stack([here, self.behind[part]])
        return [(shares[:, :, None] * by_speed[:, None, :]).reshape(f.size, -1)]


def _behind(place: Floats, features: Features, count: int) -> Floats:
    """Return how far first-order lags of a pressure (n,) are behind it, (n, times); none at a recording's begin."""
    apart_s = recorded_steps(features)
    held_s = float(apart_s.sum()) / count
    lags = [FirstOrder(share * held_s)([place[:, None]], apart_s) for share in LATE if held_s > 0.0]
    return np.column_stack([place[:, None] - lag for lag in lags]) if lags else np.zeros((place.size, 0))
