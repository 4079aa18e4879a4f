"""What may stand behind a candidate's gain instead of a cause.

Chance, the samples at reversals, other forms of the causes before it, unlike memories of the base, the pressure, or
noise of the velocity.
"""

from functools import cached_property

import numpy as np

from friction_estimator.diagnosis.any_pressure import AnyPressure
from friction_estimator.diagnosis.candidate import Candidate, Model
from friction_estimator.diagnosis.capacity import UnlikeMemories
from friction_estimator.diagnosis.forms import OtherForms, power_N2
from friction_estimator.diagnosis.held_out import gains_beyond_chance
from friction_estimator.diagnosis.lack_of_fit import WITHIN, LackOfFit, Wider
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.time_alone import TimeAlone
from friction_estimator.effects.base import REVERSAL, Effect
from friction_estimator.effects.features import Context

EARLY = 2.5
"""Sample periods after a reversal without which an effect that acts everywhere must still gain."""

CLEARLY = 0.85
"""Of a cause's gain: what other forms of earlier ones may explain at the most where it is much the same as they, and
unlike memories of the base where it is small."""

TIME_BESIDE_FORMS = 0.03
"""Of its gain: what a time of the whole force must bring beside them."""

NO_FORM = 0.5
"""Of its gain on held-out data: what a time that is no form of an earlier cause brings beside all of these."""

UNDONE = 0.5
"""Of a time that the force is ahead by: what the base's memory may not take back."""


class Doubts:
    """Says of candidates on one record whether they are more than what is no cause.

    Parameters
    ----------
    record : repaired. context : facts about it. seed : of folds.
    """

    def __init__(self, record: Record, context: Context, seed: int) -> None:
        self._record, self._context, self._seed = record, context, seed
        self._lacks: dict[tuple[Model, type[Wider]], LackOfFit] = {}
        self._in_time: dict[tuple[Model, Model], bool] = {}

    def stands(self, model: Model, effect: type[Effect], after: Model, whole: bool = False) -> bool:
        """Return whether an effect, beyond which a model has it, gains in most of the record and not only at reversals.

        A sharp model error there depends on the phase of the sampling; a name that lives on it alone names that. What
        is a function of time need not gain in most of the record (`held_out.chance_alone`). Nor need what acts at
        reversals and explains the `whole` of what is left, if it gains without its best block, too.
        """
        record = self._record
        counted = np.ones(record.used.size, np.bool_)
        sharp = effect.acts == REVERSAL
        if not sharp:
            counted = record.features.since_reversal_s >= EARLY * self._context.step_s
        errors = model.joint.residual_N, after.joint.residual_N
        return gains_beyond_chance(*errors, record, counted, effect, but_best=whole and sharp)

    @cached_property
    def _time_alone(self) -> TimeAlone:
        return TimeAlone(self._record)

    def in_time(self, model: Model, after: Model) -> bool:
        """Return whether what a model explains beyond another one is a function of the time (`time_alone`)."""
        if (model, after) not in self._in_time:
            found = self._time_alone.explains(model.joint.residual_N, after.joint.residual_N)
            self._in_time[model, after] = found
        return self._in_time[model, after]

    def beyond_memory(self, model: Model, one: Candidate, gain_N2: float, ample: bool) -> bool:
        """Return whether an effect of this gain is more than unlike memories of the base, which are lack of fit.

        Clearly more, where its gain is not ample: what grows with the speed and is late by a little is a mass. A time
        of the whole force is compared with the memory that there is.
        """
        if one.effect.delays or not model.joint.base.taps.size:
            return True
        lack = self._beside(model, UnlikeMemories)
        return lack.is_less(one.model.joint.parts_N[-1], gain_N2, 1.0 if ample else CLEARLY)

    def taken_back_s(self, model: Model, after: Model) -> float:
        """Return what the base's memory takes back of a time that the force is ahead by, s; 0 for any other last term.

        Together they smooth: of a noisy velocity they explain the noise. Elsewhere a true time beside a true memory
        looks the same.
        """
        last = after.joint.terms[-1]
        if not last.effect.delays or last.effect.late_s(last.params) >= 0.0:
            return 0.0
        before, now = (m.joint.base.problem.mean_delay(m.joint.coefficients) for m in (model, after))
        return max(0.0, min(now, now - before)) * self._context.step_s

    def undone(self, model: Model, one: Candidate) -> bool:
        """Return whether most of a time that the force is ahead by is taken back (`taken_back_s`)."""
        back = self.taken_back_s(model, one.model)
        return back > 0.0 and back >= -UNDONE * one.effect.late_s(one.term.params)

    def beyond_forms(self, model: Model, one: Candidate, ample: bool, whole: bool) -> bool:
        """Return whether an effect is more than other forms of the causes in the model, one at least, would be.

        Where its gain is ample it may be much the same as they, if it explains clearly more. A time of the whole force
        does to all of it what other forms do to their part; it must bring a trace beside them. Beside it the base and
        its memory are others, too: what the whole fit takes off the residual may bring its share instead. What it saves
        of the memory's prior they cannot make up for. And a time or a film's lag that explains the `whole` of what is
        left, and so more than all of these columns, does by one number what they do by many.
        """
        if one.gain > power_N2(model.joint):
            return True
        lack, force_N = self._beside(model, OtherForms), one.model.joint.parts_N[-1]
        if not one.effect.delays:
            clearly = 1.0 if whole else CLEARLY
            return lack.is_less(force_N, one.gain, clearly if ample else 0.0)
        if one.saved_N2 > one.held_N2 or lack.beside(force_N) >= TIME_BESIDE_FORMS * one.gain:
            return True
        taken_off_N = model.joint.residual_N - one.model.joint.residual_N
        return lack.beside(taken_off_N) >= WITHIN * one.gain or (whole and lack.alone_N2 < one.gain)

    def no_form(self, model: Model, one: Candidate) -> bool:
        """Return whether an effect brings most of what it gains beside other forms of the causes in the model, too.

        On held-out data: what it saves of the memory's prior they cannot make.
        """
        return self._beside(model, OtherForms).beside(one.model.joint.parts_N[-1]) >= NO_FORM * one.held_N2

    def within_pressures(self, model: Model, one: Candidate, least_N2: float) -> bool:
        """Return whether an effect brings as much as this beside any dependence on the recorded pressure."""
        return self._beside(model, AnyPressure).beside(one.model.joint.parts_N[-1]) >= least_N2

    def keep_only(self, model: Model | None) -> None:
        """Forget what columns of no cause explain beside other models: those are as long as the record."""
        self._lacks = {known: lack for known, lack in self._lacks.items() if known[0] is model}

    def _beside(self, model: Model, columns: type[Wider]) -> LackOfFit:
        """Return what these columns explain beside a model; they are kept for one model alone, for their size."""
        key = model, columns
        if key not in self._lacks:
            self.keep_only(model)
            wider, loss_N2 = columns.of(model.joint), float(model.loss.sum())
            self._lacks[key] = LackOfFit(wider, model.joint, loss_N2, self._record, self._seed)
        return self._lacks[key]
