"""Figures of a record that do not depend on its prediction: scales, rivals, standstill; formed before it is there."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from friction_estimator.core import metrics, sums
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.baselines import StaticCurve, fitted_in_turn
from friction_estimator.core.fit.frozen_score import CURVES
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Bools, Samples


@dataclass(frozen=True, eq=False)
class RecordFigures:
    """Samples with what any prediction of them is judged by. Each figure is formed once, when it is first asked for.

    Attributes
    ----------
    samples : all n of them.
    learned : (n,), which were learned from.
    top_speed_m_s : of the range learned.
    memory : samples that the model's delay lines hold: as many after a restart are not judged on.
    starts : index of the first sample of each recording.
    model : whose theory is a rival, and whose range has the top speed; None where that is said apart.
    """

    samples: Samples
    learned: Bools
    top_speed_m_s: float
    memory: int = 0
    starts: tuple[int, ...] = (0,)
    model: Model | None = None

    @classmethod
    def of(cls, samples: Samples, learned: Bools, starts: tuple[int, ...], model: Model) -> "RecordFigures":
        """Return those of what a model learned from, or was to."""
        top_speed = max(abs(end) for end in model.basis.reach)
        return cls(samples, learned, top_speed, model.config.fir.order, starts, model)

    def formed(self) -> Iterator[None]:
        """Form all that takes a while, a step at a time; what is asked for afterwards is there."""
        costly = (
            "standing", "spread_N", "sample_rate_hz", "duration_s", "persistence", "cycles", "theory_nrmse", "one_way",
            "scored_spread_N", "spread_in_motion_N",
        )  # fmt: skip
        for name in costly:
            getattr(self, name)
            yield
        yield from self._rivals_in_turn()

    @property
    def theory_in(self) -> metrics.Prediction | None:
        """Gives the theoretical curve at the samples of a part, N; None for Hammerstein."""
        model = self.model
        return model.theory_over(self.samples) if model is not None and model.config.is_parallel else None

    @cached_property
    def spread_N(self) -> float:
        """Standard deviation of the measured friction, N."""
        return metrics.spread(self.samples.friction_N)

    @cached_property
    def scored(self) -> Bools:
        """Which are judged on, (n,): those not learned from, all where all were, with delay lines that are filled."""
        scored = metrics.settled(self.samples.restart, self.memory)
        if not self.learned.all():
            scored &= ~self.learned
        return scored

    @cached_property
    def scored_spread_N(self) -> float:
        """The same over the samples that are judged on, N."""
        return metrics.spread(self.samples.friction_N, self.scored)

    @cached_property
    def sample_rate_hz(self) -> float:
        """Median sample rate, Hz."""
        return self.samples.sample_rate_hz

    @cached_property
    def duration_s(self) -> float:
        """Time that passed in the recordings, s; what lies between them does not count."""
        return sum(self.samples[part].duration_s for part in self.parts)

    @property
    def parts(self) -> list[slice]:
        """The samples of each recording."""
        return [slice(a, b) for a, b in pairwise([*self.starts, len(self.samples)])]

    @cached_property
    def persistence(self) -> float:
        """Nrmse of the guess f[k-1]."""
        return metrics.nrmse_persistence(self.samples.friction_N, self.samples.restart)

    @cached_property
    def theory_nrmse(self) -> float | None:
        """Nrmse of the theoretical curve alone; None for Hammerstein."""
        theory = self.theory_in
        return None if theory is None else metrics.nrmse(self.samples.friction_N, theory, scale=self.spread_N)

    @cached_property
    def cycles(self) -> list[slice]:
        """The drive cycles of each recording; tenths of one without."""
        return metrics.cycles_or_tenths(self.samples.velocity_m_s, self.starts)

    @cached_property
    def standing(self) -> Bools:
        """Where the shaft stands, (n,); without an array where it never does."""
        found = standstill(self.samples, self.top_speed_m_s)
        return found if found.any() else np.broadcast_to(np.bool_(False), found.shape)

    @cached_property
    def one_way(self) -> int:
        """The only direction that was learned from, 1 or -1; 0 where both were, or nothing."""
        velocity, learned, standing = self.samples.velocity_m_s, self.learned, self.standing
        parts = sums.parts(velocity.size)
        return metrics.one_way(velocity[part][learned[part] > standing[part]] for part in parts)  # >: and not

    @property
    def standing_share(self) -> float:
        """Share of the samples judged on at which the shaft stands."""
        standing, scored = self.standing, self.scored
        still = sum(int(np.count_nonzero(standing[part] & scored[part])) for part in sums.parts(standing.size))
        return still / max(1, int(np.count_nonzero(scored)))

    @property
    def in_motion(self) -> Bools:
        """Where samples are judged on and the shaft does not stand, (n,)."""
        return self.scored > self.standing if self.standing.any() else self.scored  # >: and not

    @cached_property
    def spread_in_motion_N(self) -> float:
        """Standard deviation of the measured friction there, N."""
        if not self.standing.any():
            return self.scored_spread_N
        return metrics.spread(self.samples.friction_N, self.in_motion)

    @property
    def rivals_in_motion(self) -> dict[str, float]:
        """Nrmse there of each of `CURVES`, fitted to what moved of the samples learned from; none where none can be."""
        for _ in self._rivals_in_turn():
            pass
        return self._rivals

    @property
    def curves_in_motion(self) -> dict[str, StaticCurve]:
        """`CURVES` fitted to what moved of the samples learned from; none where none can be."""
        for _ in self._curves_in_turn():
            pass
        return self._curves

    @cached_property
    def _rivals(self) -> dict[str, float]:
        return {}

    @cached_property
    def _curves(self) -> dict[str, StaticCurve]:
        return {}

    def _curves_in_turn(self) -> Iterator[None]:
        if self._curves:
            return
        fitted = self.learned > self.standing if self.standing.any() else self.learned
        if not np.count_nonzero(fitted):
            return
        found: dict[str, StaticCurve] = {}
        try:
            for name, curve in fitted_in_turn(self.samples.velocity_m_s, self.samples.friction_N, CURVES, fitted):
                found[name] = curve
                yield
        except UnanswerableError:
            return
        self._curves.update(found)

    def _rivals_in_turn(self) -> Iterator[None]:
        measured, velocity, moves = self.samples.friction_N, self.samples.velocity_m_s, self.in_motion
        if not np.count_nonzero(moves) > 1:
            return
        yield from self._curves_in_turn()
        for name, curve in self._curves.items():
            if name not in self._rivals:
                self._rivals[name] = metrics.nrmse(measured, curve.over(velocity), moves, self.spread_in_motion_N)
                yield
