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
from friction_estimator.effects.shapes import HATS, hats

TENTHS = 10
"""Parts of the pressures' range that count as one pressure each."""


@dataclass(frozen=True)
class AnyPressure(Wider):
    """A model's tangent, and beside it its whole force with another share at each speed and pressure.

    Attributes
    ----------
    model : fitted. cell : (n,), which of the pressures it was. count : number of pressures.
    """

    model: Joint
    cell: Ints
    count: int

    @classmethod
    def of(cls, model: Joint) -> "AnyPressure":
        """Return those of a model."""
        pressure_Pa = model.features.pressure_Pa
        span = float(np.ptp(pressure_Pa)) or 1.0
        tenth = np.minimum(TENTHS * (pressure_Pa - pressure_Pa.min()) / span, TENTHS - 1).astype(np.int64)
        there, cell = np.unique(tenth, return_inverse=True)
        return cls(model, cell, there.size)

    @property
    def width(self) -> int:
        """Number of columns beside the tangent."""
        return HATS * self.count

    def beside(self, part: slice) -> Sequence[Floats]:
        """Return the columns beside the tangent for some samples."""
        f = self.model.features[part]
        by_speed = SHARE * f.force_N[:, None] * hats(f.velocity_m_s, self.model.reference)
        here = self.cell[part, None] == np.arange(self.count)
        return [(here[:, :, None] * by_speed[:, None, :]).reshape(f.size, -1)]
