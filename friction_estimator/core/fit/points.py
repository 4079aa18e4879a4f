"""Velocity and friction of the samples that a static curve is fitted to: read piece by piece, gathered by velocity."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.sample import Bools, Floats

TOP_SPEED = 0.995
"""Quantile of the speeds above zero that is the unit of speed: one wild sample does not move it."""

BINS = 1500
"""Bins of each direction, by logarithm of the speed from SLOWEST top speeds to the top speed: 1 % wide each."""

SLOWEST = 1e-6
"""Below this share of the top speed, a hundredth of the narrowest width, all samples share a bin and S is linear."""

LEAST_WAY = 0.01
"""Share of the way that must be travelled in the lesser direction before the two are told apart.

Below it the offset and the half differences stay 0 and the unseen direction is the other's mirror image: a constant
fits one direction as well as Coulomb's law does and has the wrong sign in the other.
"""


@dataclass(frozen=True)
class Bins:
    """Samples gathered by velocity, in units of speed and force.

    Attributes
    ----------
    x, y, share : (b,) mean velocity, mean friction and share of the samples.
    scatter : mean square of friction about the mean of its bin, which no curve explains.
    samples : number of samples n.
    """

    x: Floats
    y: Floats
    share: Floats
    scatter: float
    samples: int

    @property
    def both_ways(self) -> bool:
        """Whether each direction has travelled `LEAST_WAY` of the way."""
        way = self.share * self.x
        return bool(min(way[way > 0].sum(), -way[way < 0].sum()) >= LEAST_WAY * np.abs(way).sum())


@dataclass(frozen=True)
class Points:
    """Some samples of a record, of which no copy is made: memory does not grow with their number.

    Attributes
    ----------
    velocity, friction : (n,), of the record; of any unit.
    use : (n,), which samples count; all of them where None.
    """

    velocity: Floats
    friction: Floats
    use: Bools | None = None

    def __iter__(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield velocity and friction of the samples in order, a piece at a time."""
        for part in sums.parts(self.velocity.size):
            velocity, friction = self.velocity[part], self.friction[part]
            if self.use is None or self.use[part].all():
                yield velocity, friction
            else:
                yield velocity[self.use[part]], friction[self.use[part]]

    @cached_property
    def size(self) -> int:
        """Number of samples that count."""
        return self.velocity.size if self.use is None else int(np.count_nonzero(self.use))

    @property
    def finite(self) -> bool:
        """Whether every number is finite."""
        return all(np.isfinite(values).all() for piece in self for values in piece)

    @cached_property
    def top_speed(self) -> float:
        """The robust largest speed; 0 where nothing moves (or less than the smallest normal number).

        No sample is faster than a million times of it, so that squares of their ratio stay finite.
        """

        def speeds() -> Iterator[Floats]:
            for velocity, _ in self:
                speed = np.abs(velocity)
                yield speed[speed > np.finfo(np.float64).tiny]

        n = sum(piece.size for piece in speeds())
        if not n:
            return 0.0
        largest = max(float(np.max(piece, initial=0.0)) for piece in speeds())
        return max(sums.upper_quantile(speeds(), n, TOP_SPEED), 1e-6 * largest)

    @cached_property
    def largest_force(self) -> float:
        """The largest magnitude of friction; 1 where all of it is 0."""
        return max((float(np.max(np.abs(friction), initial=0.0)) for _, friction in self), default=0.0) or 1.0

    def gathered(self, speed: float = 1.0, force: float = 1.0) -> Bins:
        """Return the samples, over these units of speed and force, gathered into at most 2 `BINS` + 1 bins."""
        per_bin = BINS / np.log(1.0 / SLOWEST)
        count, sum_x, sum_y, power = *np.zeros((3, 2 * BINS + 1)), 0.0
        for velocity, friction in self:
            x, y = velocity / speed, friction / force
            rank = 1.0 + np.floor(per_bin * np.log(np.maximum(np.abs(x), 0.5 * SLOWEST) / SLOWEST))
            place = BINS + (np.sign(x) * np.clip(rank, 0, BINS)).astype(np.int64)
            count += np.bincount(place, None, 2 * BINS + 1)
            sum_x += np.bincount(place, x, 2 * BINS + 1)
            sum_y += np.bincount(place, y, 2 * BINS + 1)
            power += float(y @ y)
        some = count > 0
        count, mean_x, mean_y = count[some], sum_x[some] / count[some], sum_y[some] / count[some]
        scatter = max(power - float(count @ mean_y**2), 0.0) / self.size
        return Bins(mean_x, mean_y, count / self.size, scatter, self.size)
