"""The search for causes: screen, compare by joint refit, guard, name, until nothing passes the gate."""

from collections.abc import Callable, Collection, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import partial

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import Capacity
from friction_estimator.diagnosis.candidate import SET_ERRORS, Candidate, Model, equals, gain_parts
from friction_estimator.diagnosis.capacity import in_words, wider
from friction_estimator.diagnosis.causes import (
    FORMS_SHARE,
    LATER_SHARE,
    Cause,
    Search,
    as_misfit,
    least_further_N2,
)
from friction_estimator.diagnosis.comparison import Comparison
from friction_estimator.diagnosis.guards import Guards, later_N2
from friction_estimator.diagnosis.held_out import error_of_sum
from friction_estimator.diagnosis.joint import is_constant
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.views import Catalogue, Views
from friction_estimator.effects.base import SLOW
from friction_estimator.effects.detection import SMOOTHED, Fault
from friction_estimator.effects.features import Context

MOST_CAUSES = 5

MOST_REFUSED = 3
"""Best candidates in a row that may be refused before the search ends."""

REFORMS = 3
"""Causes that may be given another form when nothing more passes."""

REFORM_SHARE = 0.5
"""Of what is left above the noise floor: what the other form of a cause must explain."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class _Refused:
    """A best candidate that was not named.

    Attributes
    ----------
    weak : it brings too little. unsized : enough, but its length or time may be nothing.
    doubtful : its share, and of known size; another guard refused it.
    """

    one: Candidate
    weak: bool
    unsized: bool
    doubtful: bool


@dataclass
class _Found:
    """What a search has found so far: see `Search`; `dropped` were named and became needless, or were refuted."""

    models: list[Model]
    causes: list[Cause] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    dropped: set[str] = field(default_factory=set)
    refused: list[_Refused] = field(default_factory=list)

    def copy(self) -> "_Found":
        """Return this as it is now; neither changes the other."""
        return _Found(**{item.name: copy(getattr(self, item.name)) for item in fields(self)})

    def become(self, other: "_Found") -> None:
        """Hold what another one holds."""
        for item in fields(self):
            setattr(self, item.name, getattr(other, item.name))


class Searcher:
    """The search on one record.

    Parameters
    ----------
    record : repaired. context : facts about it. catalogue : effects by name. seed : of folds and bootstrap.
    faults : that were found in the data already, and repaired: they are no causes; what those must bring is more than
        rounding to a lattice does, and than a noisy velocity gains by being smoothed further.
    """

    def __init__(
        self,
        record: Record,
        config: Config,
        context: Context,
        catalogue: Catalogue,
        seed: int,
        faults: Sequence[Fault] = (),
    ) -> None:
        self._views_of = partial(Views, record, config, context, catalogue, seed, faults)
        self.smoothed = any(f.velocity_m_s is not None and f.repaired == SMOOTHED for f in faults)
        self._starts_with()

    def __call__(self, progress: Progress) -> Search:
        """Find the causes, until nothing passes the gate."""
        progress("base model", 0.1)
        return self._searched(_Found([self.fits.base()]), progress)

    def without(self, refuted: Collection[Cause], progress: Progress) -> Search:
        """Go on from before the first of these causes was named, to name none of them.

        Nor what is another form of one, and explains the same: it says no more than that one.
        """
        names, of = {cause.name for cause in refuted}, self.views.catalogue
        same = {n for cause in refuted for n in cause.rivals if of[n].family == of[cause.name].family}
        found = next(before for name, before in self._before.items() if name in names).copy()
        found.dropped |= names | same
        return self._searched(found, progress)

    def _searched(self, found: _Found, progress: Progress) -> Search:
        """Go on from what was found so far, until nothing passes the gate."""
        self._extend(found, progress)
        if self._reform(found):
            self._extend(found, progress)
        while self._drop_small(found):
            self._extend(found, progress)
        doubtful = [r.one for r in found.refused if r.doubtful] + self._drop_misfits(found)
        causes, models, view = found.causes, found.models, self.views.of(found.models[-1])
        left = self.views.left_N2(models[-1])
        steps = zip(causes, models, models[1:], strict=False)
        causes = [replace(one, apart=self._apart_by(fewer, more, left)) for one, fewer, more in steps]
        causes = self._beside_refused(models[-1], causes, doubtful)
        untold = self.fits.untold(models[-1], left)
        causes = [replace(cause, untold=ends) for cause, ends in zip(causes, untold, strict=True)]
        self._keep_only(None)
        return Search(
            self.views.problem,
            tuple(cause.within(left) for cause in causes),
            tuple(m.joint for m in models),
            view.gates,
            tuple(found.warnings),
            tuple(found.asked),
            view.evidence,
            view.screened,
        )

    def _extend(self, so_far: _Found, progress: Progress) -> None:
        """Name causes beside those that there are, until nothing passes the gate."""
        while True:
            causes, models, refused = so_far.causes, so_far.models, so_far.refused
            model = models[-1]
            progress(f"screening for cause {len(causes) + 1}", 0.15 + 0.12 * len(causes))
            view = self.views.of(model)
            found = None
            if len(causes) < MOST_CAUSES:
                progress(f"comparing causes {len(causes) + 1}", 0.2 + 0.12 * len(causes))
                out = {*so_far.asked, *(r.one.name for r in refused), *so_far.dropped}
                found = self.comparison.winner(model, causes, out)
            if not causes and not refused and len(so_far.warnings) < 2:
                capacity, lack = wider(model.joint, view.evidence)
                gained = found[0].gain if found else 0.0
                if capacity is not None and lack > max(3.0 * view.thresholds[0], view.least, gained):
                    so_far.warnings.append(in_words(self.views.problem.capacity, capacity))
                    self._starts_with(capacity)
                    models[:] = [self.fits.base()]
                    continue
            if found is None:
                return
            best, rivals, behind = found
            by_data = self.views.passes(model, best)
            weaker = [r.one for r in refused if r.weak]
            if not self.guards.admit(model, best, by_data, causes) or not self.guards.apart(best, weaker):
                if self._exchange(so_far, best):
                    continue
                weak, sized = not self.guards.enough(model, best, causes), by_data and self.fits.known_sign(best)
                unsized = by_data and not sized and not weak
                refused.append(_Refused(best, weak, unsized, sized and self.guards.brings_share(model, best, causes)))
                if len(refused) == MOST_REFUSED:
                    return
                continue
            if best.effect.channel and best.effect.channel not in self.views.context.channels:
                so_far.asked.append(best.name)
                continue
            p_value = view.p_value(best.effect, best.held_N2) if by_data else None
            # What explains as much or more, but of a size that the record does not tell, is not named; nor is it ruled
            # out.
            as_good = [c.name for c in equals(best, [r.one for r in refused if r.unsized])]
            rivals = tuple(dict.fromkeys([*rivals, *as_good, *self._other_slow(model, best)]))
            self._before[best.name] = so_far.copy()
            causes.append(Cause(best.name, p_value, best.gain, rivals, behind))
            models.append(best.model)
            self._keep_only(best.model)
            refused.clear()
            self._drop_needless(so_far)

    def _other_slow(self, model: Model, best: Candidate) -> list[str]:
        """Return what else passes of the functions of the time, beside a small one that is named beside others.

        That it changes with time is known from so little, but not how.
        """
        if best.effect.acts != SLOW or not model.joint.terms or best.gain >= later_N2(model):
            return []
        view = self.views.of(model)
        passing = (s for s in view.screened if s.gain > view.needed[s.name] and s.name != best.name)
        return [s.name for s in passing if s.hypothesis.effect.acts == SLOW]

    def _exchange(self, found: _Found, best: Candidate) -> bool:
        """Take a cause away for which a refused candidate of its family does better; return whether there is one.

        Which of a family explained more was asked before the later causes were known.
        """
        model, family = found.models[-1], best.effect.family
        for place, cause in enumerate(found.causes):
            if self.views.catalogue[cause.name].family != family:
                continue
            better = model.loss - self.fits.without(best.model, place).loss
            if float(better.sum()) < max(later_N2(model), SET_ERRORS * error_of_sum(better)):
                continue
            trial, _ = self._left_by(found, place)
            fewer = trial.models[-1]
            instead = self.fits(fewer, best.name, best.term.params)
            if instead is None or not self.guards.admit(
                fewer, instead, self.views.passes(fewer, instead), trial.causes
            ):
                continue
            # It is named as any other, with what it cannot be told from.
            won = self.comparison.winner(fewer, trial.causes, {*trial.asked, *trial.dropped})
            if won is not None and won[0].name == best.name:
                found.become(trial)
                return True
        return False

    def _drop_small(self, found: _Found) -> bool:
        """Take a cause away that no longer brings what one beside the others must; return whether there is one.

        It was named before the others were known, and made what they make. The last one was named beside all others.
        """
        model, causes = found.models[-1], found.causes
        # What brings this beside all others would be named as the last one, too.
        enough_N2 = least_further_N2(0.0, float(model.loss.sum()), causes)
        for place, cause in enumerate(causes[:-1]):
            if cause.p_value is None or self._beside_all(model, place) >= enough_N2:
                continue
            trial, beside = self._left_by(found, place)
            if beside and self.guards.brings_share(trial.models[-1], beside[0], trial.causes):
                continue
            self._add_rival(trial, model.joint.terms[place])
            found.become(trial)
            return True
        return False

    def _left_by(self, found: _Found, place: int) -> tuple[_Found, list[Candidate]]:
        """Return what was found, as it is without one of its causes for good, and that one as a candidate beside it."""
        left = found.copy()
        beside = self._drop(left, place)
        left.dropped.add(found.causes[place].name)
        left.refused.clear()
        return left, beside

    def _add_rival(self, found: _Found, gone: Term) -> None:
        """Put what was taken away into the set of each cause in whose place it would explain as much."""
        model = found.models[-1]
        for place, term in enumerate(model.joint.terms):
            fewer = self.fits.without(model, place)
            here, there = (self.fits(fewer, one.name, one.params, search=False) for one in (term, gone))
            if here is not None and there is not None and equals(here, [there]):
                cause = found.causes[place]
                found.causes[place] = replace(cause, rivals=tuple(dict.fromkeys([*cause.rivals, gone.name])))

    def _drop_misfits(self, found: _Found) -> list[Candidate]:
        """Take away what may be what the form of a larger cause lacks (`as_misfit`); return it."""
        formed = {name for name, cls in self.views.catalogue.items() if cls.formed()}
        gone: list[Candidate] = []
        sure, judged = self._sure(found.models[-1]), found.causes
        while (place := as_misfit(judged, formed, self.views.left_N2(found.models[-1]), sure)) is not None:
            gain = self._beside_all(found.models[-1], place)
            if gain > judged[place].gain:  # little alone, but not beside those that were named after it
                judged = [replace(c, gain=gain) if k == place else c for k, c in enumerate(judged)]
                continue
            gone += self._drop(found, place)
            judged = found.causes
        return gone

    def _beside_all(self, model: Model, place: int) -> float:
        """Return what a cause of a model brings beside all others, N^2."""
        return sum(gain_parts(self.fits.without(model, place), model))

    def _drop_needless(self, found: _Found) -> None:
        """Take away what the last cause has made needless; how well that did without it stays known."""
        while (needless := self.fits.superfluous(found.models[-1], FORMS_SHARE, LATER_SHARE)) is not None:
            place, fewer = needless
            gone, instead = found.causes.pop(place), found.models[-2]
            behind_N2 = float(instead.loss.sum() - fewer.loss.sum())
            found.dropped.add(gone.name)
            self._chain(found, place, fewer)
            last = found.causes[-1]
            found.causes[-1] = replace(last, behind_N2={**last.behind_N2, gone.name: max(behind_N2, 0.0)})

    def _reform(self, found: _Found) -> bool:
        """Give causes other forms, which explain more beside the others, if there are such; return whether there are.

        A form was chosen before the later causes were known.
        """
        for number in range(REFORMS):
            model = found.models[-1]
            left = self.views.left_N2(model)
            enough = len(found.causes) > 1 and left > LATER_SHARE * float(model.loss.sum())
            other = self.fits.reformed(model, REFORM_SHARE * left) if enough else None
            if other is None:
                return number > 0
            self._chain(found, *other)
            self._drop_needless(found)
            found.refused.clear()
        return True

    def _sure(self, model: Model) -> set[str]:
        """Return the causes that no form of the others makes: by their shape, or functions of the time."""
        terms = model.joint.terms
        unlike = {term.name for term in terms if term.effect.unlike(term.params, self.views.context)}
        slow = [(k, term.name) for k, term in enumerate(terms) if term.effect.acts == SLOW]
        return unlike | {name for k, name in slow if self.guards.in_time_alone(self.fits.without(model, k), model)}

    def _drop(self, found: _Found, place: int) -> list[Candidate]:
        """Take a cause away; return it as a candidate beside the others."""
        term = found.models[-1].joint.terms[place]
        found.causes.pop(place)
        fewer = found.models[-2] if place == len(found.causes) else self.fits.without(found.models[-1], place)
        self._chain(found, place, fewer)
        beside = self.fits(fewer, term.name, term.params)
        return [] if beside is None else [beside]

    def _chain(self, found: _Found, place: int, last: Model) -> None:
        """Let the models end in another one, whose terms differ from that place on, with each cause's gain in it."""
        between = [last]
        while len(between[0].joint.terms) > place + 1:
            between.insert(0, self.fits.without(between[0], len(between[0].joint.terms) - 1))
        found.models[place + 1 :] = between if len(last.joint.terms) > place else []
        found.causes[place:] = [
            replace(cause, gain=sum(gain_parts(found.models[k], found.models[k + 1])))
            for k, cause in enumerate(found.causes[place:], place)
        ]
        self._keep_only(last)

    def _keep_only(self, model: Model | None) -> None:
        """Forget what was seen beside other models; it is as large as the record."""
        self.views.keep_only(model)
        self.guards.doubts.keep_only(model)

    def _starts_with(self, capacity: Capacity | None = None) -> None:
        """Begin with a base model of this size."""
        self.views = self._views_of(capacity)
        self.fits = self.views.fits
        self.guards = Guards(self.views, self.smoothed)
        self.comparison = Comparison(self.views, self.guards)
        self._before: dict[str, _Found] = {}  # what was found before each cause was named, in that order

    def _apart_by(self, fewer: Model, more: Model, left_N2: float) -> dict[str, float]:
        """Return by how much the quantities of a model's last term may be others (`Candidates.apart`)."""
        apart = self.fits.apart(fewer, more, left_N2)
        by = self.guards.doubts.taken_back_s(fewer, more) if self.smoothed else 0.0
        if self.views.steps_N and is_constant(more.joint.parts_N[-1]):
            # Whether the steps of the force are rounded or cut off nobody knows: half a step of a constant.
            by = 0.5 * self.views.steps_N
        if by:
            name = more.joint.terms[-1].effect.size_key
            apart[name] = max(by, apart.get(name, 0.0))
        return apart

    def _beside_refused(self, model: Model, causes: list[Cause], refused: list[Candidate]) -> list[Cause]:
        """Return causes whose quantities may also be what they are beside those that were refused last.

        Each brings what a cause must; that other forms of the causes bring it as well does not say that they do.
        """
        for one in refused:
            moved = self.fits.moved_by(model, one)
            causes = [
                replace(cause, apart={n: max(by.get(n, 0.0), cause.apart.get(n, 0.0)) for n in {*by, *cause.apart}})
                for cause, by in zip(causes, moved, strict=True)
            ]
        return causes
