"""First contact: what the configuration leaves open, from the first samples, by one causal rule for replay and node.

Where the configuration leaves `basis.velocity_range` or `force_unit` open, samples are kept until the drive has shown
itself (`settings.units`). The choice depends on the samples up to there only, so a recording and a live
stream of the same samples choose alike; then all that waited are predicted in order. What was chosen is learned
(`learned.velocity_range`, `learned.velocity_scale`, `learned.force_unit`): it wins over the rule until a reset.

So is the theoretical curve of a parallel model: what `theory.kind` auto comes to (`learned.theory`), and the Stribeck
curve where nobody gave one (`learned.stribeck`).
"""

import math
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.fit.stribeck import found_stribeck, unknown_stribeck
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.load import friction_alone
from friction_estimator.core.model.theory_choice import choice, has_pressure
from friction_estimator.core.sample import Samples, in_sequence
from friction_estimator.core.settings import units
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import shown

LARGEST_QUEUE = 2**19
"""Samples that wait at the most (some nine minutes at 1 kHz, 30 MB); then the oldest quarter is let go."""

FIRST_LOOK, LOOK_GROWTH = 32, 1.02
"""Samples before the rule is first asked, and growth of their number until it is asked again: the work stays
proportional to the samples, and the end is found at most 2 % late."""


@dataclass(frozen=True)
class Contact:
    """What the first samples say.

    Attributes
    ----------
    config : with range and units known.
    samples : number that the choice was made from.
    dropped : number that had to be let go before.
    ended : whether the drive showed itself; otherwise the recording ended first and its samples are all there was.
    """

    config: Config
    samples: int
    dropped: int
    ended: bool


class FirstContact:
    """Samples that wait until range and units are known.

    Parameters
    ----------
    config : of which `is_met` is not true yet.

    Attributes
    ----------
    dropped : samples that were let go because too many waited.

    Examples
    --------
    >>> contact = FirstContact(Config())
    >>> v = 0.1 * np.sin(np.arange(4000) / 150)
    >>> samples = Samples(np.arange(4000) * 1_000_000 + 1, v, 5.0 * np.sign(v), np.arange(4000) == 0)
    >>> config = contact.push(samples)
    >>> round(config.velocity_scale, 3), config.unit_N
    (0.105, 5.0)
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._waiting: list[Samples] = []
        self._count = 0
        self._look = FIRST_LOOK
        self._chosen_from = 0
        self.dropped = 0

    def __len__(self) -> int:
        return self._count

    def push(self, samples: Samples) -> Config | None:
        """Take samples; return the configuration with range and units as soon as they are known, else None."""
        self._waiting.append(samples)
        self._count += len(samples)
        while self._look <= self._count:
            kept = self.queue()
            first = kept[: self._look]
            if shown(first) or seal_at_once(self._config, first):
                self._chosen_from = self._look
                return chosen(self._config, first)
            self._look = max(self._look + FIRST_LOOK, math.ceil(LOOK_GROWTH * self._look))
            if self._look > LARGEST_QUEUE:
                self._let_go(kept)
        return None

    def finish(self) -> Config:
        """Return the configuration from what there is: no sample will follow."""
        kept = self.queue()
        self._chosen_from = len(kept)
        return chosen(self._config, kept)

    def queue(self) -> Samples:
        """Return the samples that wait, in order."""
        if len(self._waiting) != 1:
            self._waiting = [in_sequence(self._waiting)]
        return self._waiting[0]

    @property
    def chosen_from(self) -> int:
        """Number of samples that the choice was made from; 0 before."""
        return self._chosen_from

    def _let_go(self, kept: Samples) -> None:
        old = LARGEST_QUEUE // 4
        self._waiting = [kept[old:]]
        self._count -= old
        self.dropped += old
        self._look -= old


def meet(config: Config, samples: Samples) -> Contact:
    """Return the first contact of a whole recording: what the live node would choose from the same samples.

    Parameters
    ----------
    config : returned as it is where range and units are known.
    samples : admitted samples, in order. Those that the result calls dropped are not to be predicted: a live node that
        waits that long has let them go.
    """
    if config.is_met:
        return Contact(config, 0, 0, True)
    contact = FirstContact(config)
    met = contact.push(samples)
    return Contact(met or contact.finish(), contact.chosen_from, contact.dropped, met is not None)


def chosen(config: Config, samples: Samples) -> Config:
    """Return the configuration with what is open filled in from these samples: range, units, theoretical curve.

    The first contact gives it its first samples; batch fits, which know them all, give all that they fit.
    """
    met = units.chosen(config, samples.velocity_m_s, friction_alone(config, samples))
    if not met.is_parallel or met.has_theory:
        return met
    if met.theory_kind == "auto":
        met = met.updated({"learned.theory": choice(met, has_pressure(samples)).kind})
    return refined(met, samples) if met.finds_stribeck else met


def refined(config: Config, samples: Samples) -> Config:
    """Return the configuration with the Stribeck curve that these samples say."""
    moving = ~standstill(samples, config.velocity_scale)
    found = found_stribeck(samples.velocity_m_s, friction_alone(config, samples), moving)
    return config.updated({"learned.stribeck": (found or unknown_stribeck(config)).values})


def seal_at_once(config: Config, samples: Samples) -> bool:
    """Return whether nothing is open but the curve, and that is the seal: nothing of the drive need be seen."""
    if not config.has_units or config.theory_kind != "auto":
        return False
    return choice(config, has_pressure(samples)).kind == "seal"


NO_SAMPLES = Samples(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0, np.bool_))
