"""Which candidate explains a model's remainder best: joint refits, other forms, and a look one cause ahead."""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from friction_estimator.core.sample import Bools
from friction_estimator.diagnosis.candidate import (
    PLAIN,
    Candidate,
    Model,
    equals,
    equals_on,
    gain_parts,
    needs_memory,
    plainest,
    within_errors,
)
from friction_estimator.diagnosis.causes import Cause
from friction_estimator.diagnosis.guards import Guards, later_N2, second_N2
from friction_estimator.diagnosis.rivals import alike, closest
from friction_estimator.diagnosis.views import Views
from friction_estimator.effects.base import REVERSAL, SLOW, Effect

CANDIDATES = 6
"""Effects that are compared by joint refit."""

CONTENDER = 0.25
"""Share of the best gain below which an effect is not refitted, and is no rival."""

MEASURED_SHARE = 0.25
"""Of the best gain: what a recorded variable must explain to be preferred to an unrecorded one."""

EQUAL_SHARE = 0.9
"""Of the best gain: what a recorded variable must explain to be named instead of what does not go with time."""

MOSTLY = 0.75
"""Share of the blocks in which no recording begins, from which they say enough without those in which one does."""

CLOSE = 0.6
"""Of the best gain: what a candidate of another family must bring to be compared with the best one cause ahead."""

FLOOR_KNOWN = 0.04
"""Share of the error power to which the noise floor is known, and so what no cause explains (decision 0190)."""

OPTIONS = 4
"""Candidates that are compared so, the best included."""

MOST_ALIKE = 3
"""Effects that only the angles between columns call rivals, and that are fitted to confirm it."""

SET_ERRORS, SET_SHARE = 2.0, 0.03
"""Standard errors, and share of the effect, within which the angles call two effects alike."""


class Comparison:
    """Compares what passes the gate beside a model.

    Parameters
    ----------
    views : what is seen beside each model. guards : what may be named.
    """

    def __init__(self, views: Views, guards: Guards) -> None:
        self._views, self._guards, self._fits = views, guards, views.fits

    def winner(
        self, model: Model, causes: Sequence[Cause], out: Collection[str]
    ) -> tuple[Candidate, tuple[str, ...], dict[str, float]] | None:
        """Return the best candidate in its best form, the names of its equals, and how far behind it others are."""
        compared = self._compared(model, out)
        while True:
            shaped = self._fits.in_best_forms(model, compared, CLOSE)
            fits = {c.name: c for c in shaped.values() if not c.belied}
            if not fits:
                return None
            best = self._best(model, causes, fits, compared)
            like_it = self._alike(model, best, {*compared, *out})
            sharp = [c for c in like_it if c.effect.acts == REVERSAL and c.gain > best.gain]
            better = {c.name: c for c in sharp if self._views.passes(model, c)}
            if not better:
                break
            # What shows at reversals is badly screened; where what it was taken for finds it, it is the better one.
            compared |= better
        fits |= {c.name: c for c in like_it}
        same = _equals(best, fits.values())
        # What goes with time is made as well as that of a recorded variable by many a shape; anything else is not.
        slow = best.effect.acts == SLOW
        measured = next((c for c in same if c.effect.recorded and (slow or _as_well(c, best))), None)
        if measured is not None and not best.effect.recorded:
            # Of equals the one whose cause was recorded is named: it needs no cause that nobody saw.
            best = measured
            same = _equals(best, fits.values())
        same += [c for c in fits.values() if c not in same and self._not_told_apart(model, best, c)]
        others = [c for c in (*fits.values(), *(c for c in shaped.values() if c.belied)) if c.name != best.name]
        close = [c for c in others if c.gain > CLOSE * best.gain and not needs_memory(best, c)]
        behind = sorted(((c.name, _behind_N2(best, c)) for c in close), key=lambda item: item[1])
        return best, tuple(dict.fromkeys([*(c.name for c in same), *self._by_design(best.effect)])), dict(behind)

    def _best(
        self, model: Model, causes: Sequence[Cause], fits: Mapping[str, Candidate], plain: Mapping[str, Candidate]
    ) -> Candidate:
        """Return the one of these candidates that may be the cause, in its best form; `plain` are their plain ones."""
        best = plainest(max(fits.values(), key=lambda c: c.gain), list(fits.values()))
        best = self._measured(model, best, list(fits.values()), causes)
        best = self._fits.shaped(model, best)
        options = self._options(best, fits, plain)
        if len(options) > 1 and any(self._guards.brings_share(model, option, causes) for option in options):
            best = self._ahead(model, options)
        return self._fits.resettled(model, best)

    def _alike(self, model: Model, best: Candidate, known: Collection[str]) -> list[Candidate]:
        """Return what the angles between columns say cannot be told from the best candidate, fitted to confirm it."""
        view = self._views.of(model)
        found = alike(view.evidence, view.library, best.model.joint.parts_N[-1], CONTENDER)
        names = [name for name in closest(found, SET_ERRORS, SET_SHARE) if name not in known][:MOST_ALIKE]
        fits = [self._fits(model, name, found[name].params) for name in names]
        return [one for one in fits if one is not None]

    def _compared(self, model: Model, out: Collection[str]) -> dict[str, Candidate]:
        """Refit the best candidates jointly with base and earlier causes."""
        passing = self._views.passing(model, out)
        top = [s for s in passing[:CANDIDATES] if s.gain > CONTENDER * passing[0].gain]
        known = {s.name for s in top}
        # What shows at reversals is badly screened while the base model has bent towards it.
        top += [s for s in passing if s.hypothesis.effect.acts == REVERSAL and s.name not in known][:3]
        known = {s.name for s in top}
        top += [s for s in passing if s.hypothesis.effect.delays and s.name not in known]
        fitted = [self._fits.in_some_form(model, s.name, s.params) for s in top]
        found = {c.name: c for c in fitted if c is not None}
        enough = CLOSE * max((c.gain for c in found.values()), default=0.0)
        # What comes close is looked at in its best form anyway.
        more = [*self._views.unscreened(model, {*out, *(c.name for c in found.values() if c.gain > enough)})]
        # So is what was fitted as like one that is out by now, and that screening may not see.
        sharp = (c for c in self._fits.beside(model) if c.effect.acts == REVERSAL and c.name not in out)
        more += [c for c in sharp if self._views.passes(model, c)]
        for one in more:
            if one.name not in found or one.gain > found[one.name].gain:
                found[one.name] = one
        return found

    def _measured(
        self, model: Model, best: Candidate, others: Sequence[Candidate], causes: Sequence[Cause]
    ) -> Candidate:
        """Return the recorded cause, where the best one would have had to change with it.

        Where the pressures come in one order a slow change may be theirs; one that goes on within each of them is not.
        """
        for one in others if self._views.ordered and best.effect.acts == SLOW else ():
            enough = one.gain > MEASURED_SHARE * best.gain and self._guards.enough(model, one, causes)
            if one.effect.recorded and enough and not self._guards.beyond_pressure(model, best):
                return one
        return best

    def _options(
        self, best: Candidate, fits: Mapping[str, Candidate], plain: Mapping[str, Candidate]
    ) -> list[Candidate]:
        """Return the candidates of which one may be the cause, the best one first.

        Others only where another family or time of the whole force comes close, or the best one in its `plain` form,
        and the best one leaves what a later cause must bring: another form of a cause may make up for half of what a
        second cause does. What was recorded is not given up for what nobody saw.
        """
        if best.effect.recorded:
            return [best]
        close = [
            c
            for c in sorted(fits.values(), key=lambda c: -c.gain)
            if c.name != best.name and c.gain > CLOSE * best.gain
            if c.effect.family != best.effect.family or c.effect.delays
        ]
        first = plain.get(best.name, best)
        options = [best] if first is best else [best, first]
        options += close[: OPTIONS - len(options)]
        return [best] if self._views.left_N2(best.model) < later_N2(best.model) else options

    def _ahead(self, model: Model, options: Sequence[Candidate]) -> Candidate:
        """Return the one that explains most together with the cause that would come after it.

        A cause more must bring what it must to be named, and a parameter more what it brings beyond chance.
        """
        return max(options, key=lambda option: self._worth(model, option, options[0]))

    def _worth(self, model: Model, option: Candidate, best: Candidate) -> float:
        """Return the gain of an option with the best cause after it, less what further parameters bring by chance.

        Or with another form of an earlier cause, which was chosen before the option was known. What the memory saves
        counts in the variance that both leave: the option alone may leave far more, by which its memory would be worth
        as much more.
        """
        chance_N2 = PLAIN * best.samples_N2
        alone = option.gain - chance_N2 * option.freedom
        share_N2 = second_N2(best.gain, self._views.left_N2(option.model))
        more = [
            sum(gain_parts(model, c.model)) - chance_N2 * (option.freedom + c.freedom) - share_N2
            for c in self._views.followers(option.model)
        ]
        if option is not best:
            self._views.forget(option.model)
        formed = self._fits.reformed(option.model, 0.0, earlier=True)
        if formed is not None:
            place, other = formed
            further = other.joint.terms[place].weights.size - option.model.joint.terms[place].weights.size
            more.append(sum(gain_parts(model, other)) - chance_N2 * (option.freedom + further))
        return max([alone, *more])

    def _not_told_apart(self, model: Model, best: Candidate, other: Candidate) -> bool:
        """Return whether the record does not tell another candidate from the best one, although it explains less.

        Times of the whole force below a sample period differ by what lies between two samples. And one that makes worse
        what a recording begins with, alone, is not refuted: what is stretched there nobody saw begin.
        """
        if other.name == best.name or needs_memory(best, other):
            return False
        if best.effect.delays and other.effect.delays:
            ahead = any(c.effect.late_s(c.term.params) < 0.0 for c in (best, other))
            short = best.term.params[best.effect.refined[0]] < self._views.context.step_s
            return short and not ahead and other.gain > CLOSE * best.gain
        later = self._later_blocks()
        if later.mean() < MOSTLY or (other.model.loss <= model.loss)[~later].all():
            return False
        gains = [float((model.loss - c.model.loss)[later].sum()) for c in (best, other)]
        return gains[1] > CONTENDER * gains[0] and equals_on(later, model, best, other)

    def _later_blocks(self) -> Bools:
        """Return in which blocks no recording begins, (blocks,)."""
        record = self._views.record
        first = record.block[np.unique(record.recording, return_index=True)[1]]
        return ~np.isin(np.arange(record.blocks), first)

    def _by_design(self, effect: type[Effect]) -> list[str]:
        """Return what a recorded cause that only changed in one order cannot be told from: whatever goes with time."""
        if not self._views.ordered:
            return []
        if effect.recorded:
            return [name for name, cls in self._views.catalogue.items() if cls.acts == SLOW]
        if effect.acts == SLOW:
            recorded = [name for name, cls in self._views.catalogue.items() if cls.recorded]
            return [name for name in recorded if self._views.catalogue[name].channel in self._views.context.channels]
        return []


def _equals(best: Candidate, others: Iterable[Candidate]) -> list[Candidate]:
    """Return the contenders that explain the record as well as the best one does, best first."""
    return equals(best, [c for c in others if c.gain > CONTENDER * best.gain])


def _as_well(one: Candidate, best: Candidate) -> bool:
    """Return whether one explains a record as well as the best: the record does not tell, and one brings hardly less.

    A short record, whose errors are large, does not tell causes apart of which one explains a third more.
    """
    return within_errors(best, one) and one.gain > EQUAL_SHARE * best.gain


def _behind_N2(best: Candidate, other: Candidate) -> float:
    """Return by how much less another candidate explains, N^2.

    A likeness has another cause's shape, of which a model that misses more than the two differ by says nothing; what it
    explains beyond the best one counts as nothing.
    """
    behind_N2 = best.gain - other.gain
    return max(behind_N2, 0.0) + FLOOR_KNOWN * float(best.model.loss.sum()) if other.belied else behind_N2
