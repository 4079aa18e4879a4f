"""What explains a record beside a model without being a cause: it is held against what a cause would explain."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Self

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.record import Record

WITHIN = 0.4
"""Of its gain: what a cause that explains no more than such columns must bring beside them."""


class Wider(ABC):
    """A model's tangent with columns after it, in units of their prior's deviation, made piece by piece as that is."""

    model: Joint

    @classmethod
    @abstractmethod
    def of(cls, model: Joint) -> Self:
        """Return those of a model."""

    @property
    @abstractmethod
    def width(self) -> int:
        """Number of columns beside the tangent."""

    @abstractmethod
    def beside(self, part: slice) -> Sequence[Floats]:
        """Return them for some samples, (n_part, c) each, `width` in all."""

    @property
    def shape(self) -> tuple[int, int]:
        """(n, q)."""
        n, q = self.model.tangent.shape
        return n, q + self.width

    def __getitem__(self, part: slice, /) -> Floats:
        """Return the columns of some samples, (n_part, q)."""
        return np.concatenate([self.model.tangent[part], *self.beside(part)], axis=1)


class LackOfFit:
    """Columns of no cause beside a model: what they explain, and what a cause explains beside them, held out.

    Parameters
    ----------
    columns : the model's tangent and they. model : fitted. loss_N2 : its held-out error power, summed.
    """

    def __init__(self, columns: Wider, model: Joint, loss_N2: float, record: Record, seed: int) -> None:
        variance = model.coefficients.variance
        penalty = np.concatenate([model.penalty, np.full(columns.width, variance)])
        self._evidence = Evidence(columns, penalty, model.residual_N, record.used, record.block, seed)
        found = self._evidence.base_alone(np.ones(self._evidence.blocks, np.bool_))[-columns.width :]
        self.alone_N2 = loss_N2 - float(self._evidence.base_loss().sum()) - variance * float(found @ found)
        """Decrease of the error power by these columns, less what their prior takes, N^2."""

    def beside(self, force_N: Floats) -> float:
        """Return the decrease of the error power by a force (n,) of free size beside them, summed, N^2."""
        moments = self._evidence.moments(force_N[:, None])
        return float(self._evidence.cross_validated(moments, Rule((0,))).sum())

    def is_less(self, force_N: Floats, gain_N2: float, clearly: float = 1.0) -> bool:
        """Return whether these columns cannot stand for a cause of this force (n,) and gain.

        They explain less than this share of what it does; or it brings `WITHIN` of its gain beside them.
        """
        return self.alone_N2 < clearly * gain_N2 or self.beside(force_N) >= WITHIN * gain_N2
