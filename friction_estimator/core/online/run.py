"""The estimator over samples that come piece by piece: first contact, prediction and learning, what is kept of both."""

import time
from collections.abc import Callable

import numpy as np

from friction_estimator.compiling import COMPILATION
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.growing import Column
from friction_estimator.core.model.structure import Extension, Parameters
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import Contact, FirstContact
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config

SNAPSHOTS = 200
"""Snapshots of the parameters kept over a run at the most, beside those at the end of each recording."""

FIRST_STEP = 16
"""Samples between two of them at first; where they become too many every second is let go."""

BLOCK = 65536
"""Samples between two reports of progress at the most."""


class Run:
    """Predicts and learns samples in order. Where one piece of them ends and the next begins makes no difference.

    Parameters
    ----------
    config : where range or units are open the first contact chooses them, as in the live node (`settings.units`).
    extension : terms that a diagnosis added.
    deviation : keep the standard deviation of each prediction.
    freeze_after, total : learn on this first fraction of so many samples only; None learns throughout, and needs no
        total.
    advance : told the number of samples just done.
    told : is told the predictions, (m,) N, as they come: none is kept then.

    Attributes
    ----------
    snapshots : parameters after the sample of an index among those predicted.
    seconds : wall-clock time of prediction and learning, without that of a first compilation.

    Raises
    ------
    ConfigError : `freeze_after` outside [0, 1]; here and at each piece, what the estimator raises.
    """

    def __init__(
        self,
        config: Config,
        *,
        extension: Extension | None = None,
        deviation: bool = True,
        freeze_after: float | None = None,
        total: int = 0,
        advance: Callable[[int], None] = lambda _: None,
        told: Callable[[Floats], None] | None = None,
    ) -> None:
        if freeze_after is not None and not 0.0 <= freeze_after <= 1.0:
            raise ConfigError(f"freeze-after is {freeze_after:g}: give the fraction of the record to learn on, 0 to 1")
        self.snapshots: dict[int, Parameters] = {}
        self.seconds = 0.0
        self._extension, self._advance = extension, advance
        self._share, self._total = freeze_after, total
        self._predicted = Column(np.float64)
        self._take = told or self._predicted.extend
        self._done = 0
        self._spread = Column(np.float64) if deviation else None
        self._begins: list[int] = []
        self._seen = 0
        self._step = FIRST_STEP
        self._estimator: Estimator | None = None
        self._contact: Contact | None = None
        self._first = FirstContact(config)
        if config.is_met:
            self._meet(config, ended=True)

    @property
    def estimator(self) -> Estimator:
        """The estimator, once range and units are known."""
        assert self._estimator is not None
        return self._estimator

    @property
    def contact(self) -> Contact:
        """How range and units were met, once they are known."""
        assert self._contact is not None
        return self._contact

    @property
    def known_contact(self) -> Contact | None:
        """The same, None before."""
        return self._contact

    @property
    def starts(self) -> list[int]:
        """Index of the first sample of each recording among those predicted."""
        return [max(0, begin - self.contact.dropped) for begin in self._begins]

    @property
    def learned_until(self) -> int | None:
        """Index from which on nothing is learned; None where all is."""
        if not self.contact.config.model.adapt:
            return 0
        return None if self._share is None else round(self._share * (self._total - self.contact.dropped))

    def begin(self) -> None:
        """Say that the samples that follow are those of another recording."""
        self._begins.append(self._seen)
        self._note()

    def push(self, samples: Samples) -> None:
        """Take the next samples."""
        self._seen += len(samples)
        if self._contact is not None:
            self._learn(samples)
        elif (met := self._first.push(samples)) is not None:
            self._meet(met, ended=True)

    def finish(self) -> tuple[Floats, Floats | None]:
        """Return predictions and their standard deviations, (n,) N each: no sample will follow.

        Predictions that were told are not among them.
        """
        if self._contact is None:
            self._meet(self._first.finish(), ended=False)
        self._note()
        spread = None if self._spread is None else self._spread.taken()
        return self._predicted.taken(), spread

    def _meet(self, config: Config, *, ended: bool) -> None:
        first = self._first
        self._estimator = Estimator(config, self._extension)
        self._contact = Contact(config, first.chosen_from, first.dropped, ended)
        if len(first):
            self._learn(first.queue())
        self._first = FirstContact(config)

    def _learn(self, samples: Samples) -> None:
        estimator, starts, until = self.estimator, self.starts, self.learned_until
        edges = [*starts] if until is None else [*starts, until]
        done = 0
        while done < len(samples):
            at = self._done
            end = min(at + min(len(samples) - done, BLOCK), at - at % self._step + self._step)
            end = min([end, *(edge for edge in edges if at < edge)])
            part = samples[done : done + end - at]
            spread = None if self._spread is None else np.empty(len(part))
            begin = time.perf_counter() - COMPILATION.seconds
            predicted = estimator.run(part, until is None or at < until, spread)
            self.seconds += time.perf_counter() - COMPILATION.seconds - begin
            self._take(predicted)
            self._done = end
            if self._spread is not None and spread is not None:
                self._spread.extend(spread)
            done += len(part)
            if end % self._step == 0 or end in starts:
                self._note()
                self._thin(starts)
            self._advance(len(part))

    def _note(self) -> None:
        """Take a snapshot behind the last sample predicted."""
        if self._done:
            self.snapshots.setdefault(self._done - 1, self.estimator.parameters)

    def _thin(self, starts: list[int]) -> None:
        if len(self.snapshots) > SNAPSHOTS + len(starts):
            self._step *= 2
            kept = [index for index in self.snapshots if (index + 1) % self._step == 0 or index + 1 in starts]
            self.snapshots = {index: self.snapshots[index] for index in kept}
