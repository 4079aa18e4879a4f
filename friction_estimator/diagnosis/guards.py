"""What a best candidate must pass before it is named: its share, and to be more than lack of fit of what is there."""

from collections.abc import Sequence

from friction_estimator.diagnosis.candidate import Candidate, Model
from friction_estimator.diagnosis.causes import (
    FORMS_SHARE,
    LATER_SHARE,
    LEAST_SHARE,
    MISFIT_SHARE,
    Cause,
    least_further_N2,
)
from friction_estimator.diagnosis.doubts import Doubts
from friction_estimator.diagnosis.views import SECOND_LEFT, Views
from friction_estimator.effects.base import REVERSAL, SLOW

SECOND_SHARE = 0.02
"""A further cause must bring this share of the first one's gain."""

ALIKE_LEFT = 0.8
"""Or `SECOND_LEFT` of what the causes before it have left above the noise floor, this share where it is an alternative
of one of them: a first cause of great power, a trait of the rig, must not hide a second one."""

NO_FORM_LEFT = 0.25
"""Of what is left above the noise floor: what a time must bring that is small, but no form of an earlier cause."""

WHOLE = 0.25
"""Of its gain: what a cause that explains all that is left may leave above the noise floor."""

PAIR = 0.95
"""Of what a cause and the next one explain: what unlike memories, which make up for both, may explain at the most."""


class Guards:
    """Says of candidates whether they may be named.

    Parameters
    ----------
    views : what is seen beside each model. smoothed : a noisy velocity was smoothed: what is gained by smoothing it
        further is no cause.
    """

    def __init__(self, views: Views, smoothed: bool) -> None:
        self._views, self._fits, self._smoothed = views, views.fits, smoothed
        self.doubts = Doubts(views.record, views.context, views.seed)

    def admit(self, model: Model, best: Candidate, by_data: bool, causes: Sequence[Cause]) -> bool:
        """Return whether the best candidate may be named."""
        if not (by_data or best.by_evidence) or not self.enough(model, best, causes):
            return False
        if not by_data:
            return True
        if self._smoothed and self.doubts.undone(model, best):
            return False
        if best.term.beyond(self._views.context):
            return False
        if best.name in self._views.with_pressure(model) and not self.beyond_pressure(model, best):
            return False
        return self._stands(model, best) and self._known(best) and self._beyond_memory(model, best, causes)

    def _known(self, best: Candidate) -> bool:
        """Return whether something is told of the size of a cause.

        Forces that cannot be negative lie on one side of nothing by themselves: where they leave more than they
        explain, they must be told beside what that may make of them, too.
        """
        if not self._fits.known_sign(best):
            return False
        left = self._views.left_N2(best.model)
        return not best.term.one_sided.any() or left < best.gain or self._fits.known_sign(best, left)

    def _stands(self, model: Model, best: Candidate) -> bool:
        """Return whether a cause gains elsewhere than at reversals: alone, or beside the one that would come after it.

        Where two causes are left one may take there what belongs to the other, and be wrong by as much elsewhere.
        """
        if self.doubts.stands(model, best.effect, best.model, self._whole(best)):
            return True
        for one in self._views.followers(best.model):
            alone = self._fits.without(one.model, len(model.joint.terms))
            if self.doubts.stands(alone, best.effect, one.model):
                return True
        return False

    def _beyond_memory(self, model: Model, best: Candidate, causes: Sequence[Cause]) -> bool:
        """Return whether a cause, or it with the one that would come after it, is more than unlike memories would be.

        Where two causes are left the memories make up for both. Beside a much larger one that says of a recorded
        variable that the curve is another one it must be clearly more: the memory of that curve may be another, too.
        """
        recorded_N2 = max((c.gain for c in causes if self._views.catalogue[c.name].recorded), default=0.0)
        ample = is_ample(model, best) and best.gain >= MISFIT_SHARE * recorded_N2
        if self.doubts.beyond_memory(model, best, best.gain, ample):
            return True
        after = [one.gain for one in self._views.followers(best.model)]
        return bool(after) and self.doubts.beyond_memory(model, best, PAIR * (best.gain + max(after)), ample)

    def beyond_pressure(self, model: Model, best: Candidate) -> bool:
        """Return whether a cause goes on within each pressure.

        A model that still misses as much as that says nothing of it, nor does a record that holds no pressure.
        """
        if not self._views.held:
            return False
        least = max(later_N2(model), self._views.left_N2(best.model))
        return self.doubts.within_pressures(model, best, least)

    def enough(self, model: Model, best: Candidate, causes: Sequence[Cause]) -> bool:
        """Return whether a cause brings its share, and more than what other forms of the earlier causes explain."""
        if not self.brings_share(model, best, causes):
            return False
        if not causes or self._views.lattice_N > 0.0:
            return True
        ample = is_ample(model, best)
        one_number = best.effect.delays or best.effect.in_theory
        whole = ample and one_number and self._whole(best)
        return self.doubts.beyond_forms(model, best, ample, whole)

    def _whole(self, best: Candidate) -> bool:
        """Return whether a cause explains all that is left."""
        return self._views.left_N2(best.model) < WHOLE * best.gain

    def brings_share(self, model: Model, best: Candidate, causes: Sequence[Cause]) -> bool:
        """Return whether a cause brings enough beside the first one, or of what is left above the floor.

        Alone it must bring its share with what it costs the prior of the memory, too.
        """
        loss_N2 = float(model.loss.sum())
        if not causes:
            return best.by_evidence or best.gain >= LEAST_SHARE * loss_N2
        if self.in_time_alone(model, best.model):
            return best.held_N2 >= LEAST_SHARE * loss_N2
        left = self._views.left_N2(model)
        if best.gain < second_N2(causes[0].gain, left):
            return False
        if (
            best.effect.family in {self._views.catalogue[c.name].family for c in causes}
            and best.gain < ALIKE_LEFT * left
        ):
            return False
        later = best.effect.delays or best.effect.acts == REVERSAL or self._views.lattice_N > 0.0
        least = least_further_N2(LATER_SHARE if later else FORMS_SHARE, loss_N2, causes)
        if best.by_evidence or best.gain >= least:
            return True
        some = best.effect.delays and best.gain >= max(FORMS_SHARE * loss_N2, NO_FORM_LEFT * left)
        return some and self._views.lattice_N == 0.0 and self.doubts.no_form(model, best)

    def in_time_alone(self, fewer: Model, more: Model) -> bool:
        """Return whether the cause that a model has beyond another one is a function of the time that no other makes.

        Beside one that is itself a function of the time it may be what the form of that one lacks.
        """
        slow = [term.name for term in more.joint.terms if term.effect.acts == SLOW]
        there = {term.name for term in fewer.joint.terms}
        return len(slow) == 1 and slow[0] not in there and self.doubts.in_time(fewer, more)

    def apart(self, best: Candidate, weak: Sequence[Candidate]) -> bool:
        """Return whether a cause brings its share beside the better ones that may be another form of an earlier cause.

        What it shares with them may be that form as well.
        """
        better = [one for one in weak if one.gain > best.gain]
        if best.by_evidence or not better:
            return True
        beside = ((one, self._fits(one.model, best.name, best.term.params)) for one in better)
        return all(both is not None and both.gain > later_N2(one.model) for one, both in beside)


def second_N2(first_N2: float, left_N2: float) -> float:
    """Return what a further cause must bring, N^2: a share of the first one's gain, or of what is left above the floor.

    >>> second_N2(870.0, 20.0), second_N2(100.0, 20.0)
    (4.0, 2.0)
    """
    return min(SECOND_SHARE * first_N2, SECOND_LEFT * left_N2)


def later_N2(model: Model) -> float:
    """Return the gain that a cause beside the others of this model must bring, N^2."""
    return LATER_SHARE * float(model.loss.sum())


def is_ample(model: Model, best: Candidate) -> bool:
    """Return whether a cause gains what one beside the others of this model must bring, by held-out data alone."""
    return best.held_N2 >= later_N2(model)
