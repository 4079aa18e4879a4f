"""Candidates for a cause: effects fitted beside a model and judged by held-out loss. Each fit is made once."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.candidate import (
    PLAIN,
    SET_SHARE,
    Candidate,
    Model,
    as_sharp,
    beyond_chance,
    gain_parts,
    signs_kept,
)
from friction_estimator.diagnosis.causes import LATER_SHARE
from friction_estimator.diagnosis.intervals import Estimate, estimates
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import Term, time_of
from friction_estimator.effects.base import SLOW, Effect
from friction_estimator.effects.features import Context

RESETTLED = 10.0
"""Variances of the residual that an earlier term's other place must save: a probability ratio of exp(5)."""

RESETTLINGS = 2
"""Most times that an earlier term is sought anew beside the same later one."""

MOVABLE = 0.3
"""Mean delay of the base's memory, in samples, from which it may be what a time of the whole force should have: a
comb of minima a sample apart. Less is the rig's own."""

SHORT, LESS = 0.1, 0.5
"""Samples, and share of the time, from which another form of a long time is begun, too."""


def _cost(one: Candidate) -> float:
    return one.model.joint.coefficients.cost


class Candidates:
    """Fits effects beside models of one base problem, and remembers what it has fitted."""

    def __init__(
        self, problem: BaseProblem, context: Context, catalogue: Mapping[str, type[Effect]], seed: int
    ) -> None:
        self.problem, self.context, self.catalogue, self.seed = problem, context, catalogue, seed
        self._fit = JointFit(problem, context)
        self._known: dict[tuple[Model, str, tuple[tuple[str, float], ...]], Candidate | None] = {}
        self._shaped: dict[tuple[Model, str], Candidate] = {}
        self._estimates: dict[tuple[Model, float | None], list[dict[str, Estimate]]] = {}

    @cached_property
    def _alone(self) -> Model:
        return self._judged(self._fit())

    def base(self) -> Model:
        """Return the base model alone."""
        return self._alone

    def __call__(self, model: Model, name: str, params: Mapping[str, float], search: bool = True) -> Candidate | None:
        """Return the effect beside the model, or None where its signs or its values cannot be.

        `search` looks for what it refines over the whole bracket, else from where it is.
        """
        key = model, name, tuple(sorted(params.items()))
        if key not in self._known:
            self._known[key] = self._fitted(model, name, params, search)
        return self._known[key]

    def in_some_form(self, model: Model, name: str, params: Mapping[str, float]) -> Candidate | None:
        """Return the effect beside the model, in its best other form where this one cannot be; None where none can."""
        one = self(model, name, params)
        if one is not None:
            return one
        others = (self(model, name, form) for form in self.catalogue[name].variants(params))
        return max((other for other in others if other is not None), key=lambda other: other.gain, default=None)

    def beside(self, model: Model) -> list[Candidate]:
        """Return what was fitted beside a model so far and can be a cause, by its name and its form, oldest first."""
        return [one for (known, _, _), one in self._known.items() if known is model and one is not None]

    def shaped(self, model: Model, best: Candidate) -> Candidate:
        """Return the candidate in that functional form of its cause which the data ask for."""
        key = model, best.name
        if key not in self._shaped:
            best = self._in_variant(model, best)
            self._shaped[key] = self._with_further(model, best)
        return self._shaped[key]

    def _in_variant(self, model: Model, best: Candidate) -> Candidate:
        """Return the candidate in its variant that explains more than its further parameters do by chance.

        One that is `belied` by that has its name in that form only.
        """
        for form in best.effect.plainer(best.term.params):
            plain = self(model, best.name, form)
            if plain is not None and best.gain - plain.gain <= beyond_chance(plain, best):
                best = plain
        for form in best.effect.variants(best.term.params):
            # Each time of a film, or of the whole force, forms the base's products anew, and its other form is late
            # by the same time: that of the whole, the base's memory with it.
            moved = self.moved_over(best.model.joint) if best.effect.delays else {}
            if any(value <= 0.0 for value in moved.values()):
                continue  # the memory takes back more than the time: it is not late at all
            search = not (best.effect.in_theory or best.effect.delays)
            fits = [self(model, best.name, start, search) for start in (form | moved, *self._shorter(best, form))]
            other = max((fit for fit in fits if fit is not None), key=lambda fit: fit.gain, default=None)
            if other is None:
                continue
            better = other.gain - best.gain > beyond_chance(best, other)
            if better and other.belied:
                return other
            # A form of which nothing can be told is refused: the cause with it, although a plainer one tells it.
            if better and (self.known_sign(other) or not self.known_sign(best)):
                best = other
        return self._in_best_well(model, best)

    def _in_best_well(self, model: Model, best: Candidate) -> Candidate:
        """Return the candidate in the best of its minima that lead to each other.

        All have the same parameters: their costs are compared. What is held out is worked out on a line through each
        fit, which between two wells promises more than there is. Where the fit has run away, forces of either sign that
        nearly cancel fit as well: no well of which nothing can be told is taken.
        """
        while True:
            fits = [self(model, best.name, place, search=False) for place in best.effect.wells(best.term.params)]
            better = [fit for fit in fits if fit is not None and _cost(fit) < _cost(best) and self.known_sign(fit)]
            if not better:
                return best
            best = min(better, key=_cost)

    def _shorter(self, best: Candidate, form: Mapping[str, float]) -> list[dict[str, float]]:
        """Return a form of a time of more than a sample at shorter ones, or nothing.

        In the plainer form the base's memory may have made up for samples that are no part of the time.
        """
        if not best.effect.delays:
            return []
        name, step = best.effect.refined[0], self.context.step_s
        time = best.term.params[name]
        return [dict(form) | {name: shorter} for shorter in (SHORT * step, LESS * time) if time > step]

    def _with_further(self, model: Model, best: Candidate) -> Candidate:
        """Return the candidate with more of the same in it, where that brings what a further cause must."""
        joint = best.model.joint
        left = joint.residual_N * self.problem.record.used
        for form in best.effect.further(best.term.params, left, joint.features, self.context):
            other = self(model, best.name, form)
            least = LATER_SHARE * float(best.model.loss.sum())
            if other is not None and other.gain - best.gain > max(least, beyond_chance(best, other)):
                best = other
        return best

    def in_best_forms(self, model: Model, fits: Mapping[str, Candidate], close: float) -> dict[str, Candidate]:
        """Return candidates by name, those near the best in their best forms; what only looks like a cause is `belied`.

        Near is what brings this share of the best one's gain; times of the whole force are with one of them, too: where
        the base's memory has taken up nearly all, what a plain form gets wrong is all that is left. So is what jumps
        beside another that acts at reversals: where the drive's periods are whole numbers of samples, a plain gap takes
        a whole sample of each stroke or nothing.
        """
        best = max(fits.values(), key=lambda c: c.gain, default=None)
        if best is None or best.gain <= 0.0:
            return {}
        near = [c for c in fits.values() if c.gain > close * best.gain or as_sharp(best.effect, c.effect)]
        shaped = dict(fits) | {c.name: self.shaped(model, c) for c in near}
        likenesses = {name: c for name, c in shaped.items() if c.belied}
        if not likenesses:
            return shaped
        # Without them others are near.
        left = {name: c for name, c in shaped.items() if name not in likenesses}
        return likenesses | self.in_best_forms(model, left, close)

    def _told(self, joint: Joint) -> list[dict[str, float]]:
        """Return the quantities of each term of a fit."""
        told = (t.effect.told(t.params, t.weights, self.context, joint.reference) for t in joint.terms)
        return [{name: value for name, (value, _) in values.items()} for values in told]

    def moved_by(self, model: Model, one: Candidate) -> list[dict[str, float]]:
        """Return by how much the quantities of each term of a model differ where the candidate stands beside them.

        More may stand beside them there, and less.
        """
        names = (term.name for term in one.model.joint.terms[:-1])
        beside = dict(zip(names, self._told(one.model.joint)[:-1], strict=True))
        pairs = [
            (told, beside.get(t.name, {})) for t, told in zip(model.joint.terms, self._told(model.joint), strict=True)
        ]
        return [{n: abs(b[n] - value) for n, value in a.items() if n in b} for a, b in pairs]

    def apart(self, model: Model, after: Model, left_N2: float) -> dict[str, float]:
        """Return by how much the quantities of the last term differ in other fits of it that explain nearly as much.

        Those are all that were made beside the same model, also before an earlier cause was dropped.

        Parameters
        ----------
        model, after : without and with that term. left_N2 : what no cause explains, by which they may be behind.
        """
        last = after.joint.terms[-1]
        told, gain = self._told(after.joint)[-1], sum(gain_parts(model, after))
        out: dict[str, float] = {}
        for (known, name, _), other in self._known.items():
            if known is not model or name != last.name or other is None or other.model is after or other.belied:
                continue
            if gain - other.gain - PLAIN * other.samples_N2 > left_N2:
                continue
            if self.known_sign(other):  # where nothing is known, no value says anything
                values = self._told(other.model.joint)[-1]
                out |= {n: max(abs(value - told[n]), out.get(n, 0.0)) for n, value in values.items() if n in told}
        return out

    def untold(self, model: Model, left_N2: float) -> list[dict[str, tuple[float, float]]]:
        """Return the least and the largest value of the quantities of each term in its `Effect.untold` forms.

        Of those that explain as much beside all the others.

        Parameters
        ----------
        left_N2 : what no cause explains, by which they may be behind.
        """
        return [self._untold(model, i, left_N2) for i in range(len(model.joint.terms))]

    def _untold(self, model: Model, i: int, left_N2: float) -> dict[str, tuple[float, float]]:
        terms, out = model.joint.terms, dict[str, tuple[float, float]]()
        forms = terms[i].effect.untold(terms[i].params)
        if not forms:
            return out
        # Each is refined from where the model is, as the form itself is once more: other fits differ by where they end.
        same, *others = (
            self._fit([*terms[:i], Term(terms[i].effect, form), *terms[i + 1 :]], model.joint, search=False)
            for form in [dict(terms[i].params), *forms]
        )
        here = self._judged(same)
        chance_N2 = PLAIN * float(here.loss.sum()) / same.coefficients.count
        behind_N2 = max(left_N2 + chance_N2, SET_SHARE * sum(gain_parts(self.without(model, i), model)))
        for joint in others:
            gain = sum(gain_parts(here, self._judged(joint)))
            if gain < -behind_N2 or not signs_kept(joint) or joint.terms[i].beyond(self.context):
                continue
            for name, value in self._told(joint)[i].items():
                low, high = out.get(name, (value, value))
                out[name] = min(low, value), max(high, value)
        return out

    def moved_over(self, joint: Joint) -> dict[str, float]:
        """Return the time of the whole force with what the base's memory delays moved over to it, or nothing.

        It may be below zero: what is ahead by less than the memory delays is late.
        """
        time = time_of(joint.terms)
        if time is None:
            return {}
        name = time.effect.refined[0]
        way = -1.0 if time.effect.late_s({name: 1.0}) < 0.0 else 1.0
        more = way * joint.base.problem.mean_delay(joint.coefficients) * self.context.step_s
        value = time.params[name] + more
        return {name: value} if abs(more) > MOVABLE * self.context.step_s else {}

    def _without_memory(self, joint: Joint) -> Joint:
        """Return the fit whose time of the whole force has what the base's memory delayed, where that fits better.

        A sample of memory does nearly what a sample of that time does, and no step leads from one to the other.
        """
        moved = self.moved_over(joint)
        if not moved or min(moved.values()) <= 0.0:
            return joint
        terms = [replace(t, params=t.params | moved) if t.effect.delays else t for t in joint.terms]
        other = self._fit(terms, joint, search=False)
        return other if other.coefficients.cost < joint.coefficients.cost else joint

    def resettled(self, model: Model, one: Candidate) -> Candidate:
        """Return the candidate with what the terms before it refine sought anew, where everything then fits better.

        A time or a length that was sought before the later cause was known may lie in another minimum. Where one has
        moved, the others have moved with it, and it is sought once more: the search holds them.
        """
        best = one.model.joint
        names = [term.name for term in best.terms]
        for name in names[:-1]:
            for _ in range(RESETTLINGS if self.catalogue[name].refined else 0):
                last = sorted(best.terms, key=lambda t, n=name: t.name == n)  # type: ignore[misc]
                if not self._fit.elsewhere(last, best):
                    break
                found = self._fit(last, best)
                here, there = best.coefficients, found.coefficients
                if here.cost - there.cost <= RESETTLED * here.variance:
                    break
                ordered = sorted(found.terms, key=lambda t: names.index(t.name))
                best = self._fit(ordered, found, search=False)
        best = self._without_memory(best)
        if best is one.model.joint:
            return one
        return self._candidate(model, best) or one

    def _fitted(self, model: Model, name: str, params: Mapping[str, float], search: bool) -> Candidate | None:
        here, effect = model.joint, self.catalogue[name]
        joint = self._fit([*model.joint.terms, Term(effect, dict(params))], here, search=search)
        before = self._before(name, params) if effect.in_theory and search else None
        if before is not None:
            # A film's lag has wells of its own beside each model.
            other = self._fit([*model.joint.terms, Term(effect, before)], here, search=False)
            joint = min(joint, other, key=lambda fit: fit.coefficients.cost)
        return self._candidate(model, joint)

    def _before(self, name: str, params: Mapping[str, float]) -> dict[str, float] | None:
        """Return where an effect of this form was found last, beside whichever model, or None."""
        fits = (one for (_, known, _), one in self._known.items() if known == name and one is not None)
        places = [dict(one.term.params) for one in fits if set(one.term.params) == set(params)]
        return places[-1] if places else None

    def _candidate(self, model: Model, joint: Joint) -> Candidate | None:
        """Return the last term of a fit as a candidate beside the model, or None where it cannot be."""
        term = joint.terms[-1]
        # What is too short to be told may still make up for a part of what is left, beside what can be told.
        if not signs_kept(joint) or term.beyond(replace(self.context, blurred_m=0.0)):
            return None
        after = self._judged(joint)
        belied = term.effect.belied(term.params, joint.parts_N[-1], joint.features, joint.reference, self.context)
        one = Candidate(term.name, term.effect, after, *gain_parts(model, after), belied)
        return one if np.isfinite(one.gain) else None

    def _judged(self, joint: Joint) -> Model:
        return Model(joint, joint.held_out_loss(self.problem.record, self.seed))

    def known_sign(self, one: Candidate, left_N2: float | None = None) -> bool:
        """Return whether what physics gives one sign, and every length and time, differs from zero by its interval.

        But not how long a slow change of known size goes on; that of a free shape is never known.

        By chance alone; with `left_N2` also by what a misfit of that power may make of it (`estimates`).

        What is `positive` lies above it with the whole of that. Of the other quantities one at least must differ: a
        drift whose total may be nothing is another name for a bias.
        """
        return self._known_sign(one.model, -1, left_N2)

    def superfluous(self, model: Model, share: float, doubtful: float) -> tuple[int, Model] | None:
        """Return the place of a term that the last one has made needless, and the model without it, or None.

        Without it the model loses less than this share of its error power; `doubtful`, where the term's every size may
        be nothing beside the last one.
        """
        for i in range(len(model.joint.terms) - 1):
            fewer = self.without(model, i)
            least = share if self._known_sign(model, i) else doubtful
            if sum(gain_parts(fewer, model)) < least * float(model.loss.sum()):
                return i, fewer
        return None

    def reformed(self, model: Model, least_N2: float, earlier: bool = False) -> tuple[int, Model] | None:
        """Return the place of a term and the model with its best other form, or None; of terms `earlier` than the last.

        It must explain at least this much, and more than its further parameters do by chance.
        """
        loss = float(model.loss.sum())
        best: tuple[float, int, Model] | None = None
        for i, term in enumerate(model.joint.terms[:-1] if earlier else model.joint.terms):
            effect, params = term.effect, term.params
            if effect.delays:
                continue
            for form in (*effect.variants(params), *effect.plainer(params), *effect.wells(params)):
                if form == params:
                    continue
                terms = [*model.joint.terms]
                terms[i] = Term(effect, dict(form))
                joint = self._fit(terms, model.joint, search=False)
                new = joint.terms[i]
                part_N = joint.parts_N[i]
                belied = effect.belied(new.params, part_N, joint.features, joint.reference, self.context)
                if belied or not signs_kept(joint) or new.beyond(self.context):
                    continue
                other = self._judged(joint)
                gain = loss - float(other.loss.sum())
                more = max(new.weights.size - term.weights.size, 1)
                if not gain >= max(least_N2, PLAIN * more * float(other.loss.sum()) / joint.coefficients.count):
                    continue
                if (best is None or gain > best[0]) and self._known_sign(other, i):
                    best = gain, i, other
        return None if best is None else best[1:]

    def without(self, model: Model, i: int) -> Model:
        """Return the model without one of its terms, the others refined from where they are."""
        return self._judged(self._fit.without(model.joint, i))

    def _known_sign(self, model: Model, i: int, left_N2: float | None = None) -> bool:
        """Return `known_sign` of one term of a model."""
        key = model, left_N2
        if key not in self._estimates:
            self._estimates[key] = estimates(model.joint, self.problem.record, self.context, self.seed, left_N2)
        term, fitted = model.joint.terms[i], self._estimates[key][i]
        one_sign = {name for name in fitted if name in term.refined and name not in term.effect.steps}
        if len(term.effect.signs) == term.weights.size and all(term.effect.signs):
            one_sign |= set(fitted)
        known = {name for name, value in fitted.items() if value.apart_from_zero}
        sizes = set(fitted) - set(term.refined)
        told_by_sizes = bool(sizes) and term.weights.size <= len(sizes)  # a free shape may cancel in each of them
        if told_by_sizes and not sizes & known:
            return False
        if told_by_sizes and term.effect.acts == SLOW:
            one_sign -= set(term.refined)  # over how long it goes on may be anything
        above = all(fitted[name].low > 0.0 for name in term.effect.positive if name in fitted)
        return above and one_sign <= known
