"""The search for causes: screen, gate, compare by joint refit, look one cause ahead where two come close."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity
from friction_estimator.diagnosis.candidate import (
    MEMORY_EVIDENCE,
    PLAIN,
    Candidate,
    Model,
    equals,
    gain_parts,
    needs_memory,
    plainest,
    within_errors,
)
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.capacity import in_words, wider
from friction_estimator.diagnosis.causes import LATER_SHARE, LEAST_SHARE, Cause, Search
from friction_estimator.diagnosis.excitation import pressure_order
from friction_estimator.diagnosis.floor import noise_floor
from friction_estimator.diagnosis.library import build_library
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.rivals import alike, closest
from friction_estimator.diagnosis.screening import Screened, View, screening
from friction_estimator.effects.base import REVERSAL, SLOW, Effect
from friction_estimator.effects.detection import SMOOTHED, Fault
from friction_estimator.effects.features import Context

Catalogue = Mapping[str, type[Effect]]

CANDIDATES = 6
"""Effects that are compared by joint refit."""

CONTENDER = 0.25
"""Share of the best gain below which an effect is not refitted, and is no rival."""

MEASURED_SHARE = 0.25
"""Of the best gain: what a recorded variable must explain to be preferred to an unrecorded one."""

FORMS_SHARE = 0.006
"""Share of the error power that a further cause must bring where it is more than other forms of the earlier ones."""

SECOND_SHARE = 0.02
"""A further cause must bring this share of the first one's gain."""

SECOND_LEFT, ALIKE_LEFT = 0.2, 0.8
"""Or this share of what the causes before it have left above the noise floor: a first cause of great power, a trait of
the rig, must not hide a second one."""

PAIR = 0.95
"""Of what a cause and the next one explain: what unlike memories, which make up for both, may explain at the most."""

CLOSE = 0.6
"""Of the best gain: what a candidate of another family must bring to be compared with the best one cause ahead."""

OPTIONS, FOLLOWERS = 4, 2
"""Candidates that are compared so, the best included, and effects that are fitted beside each."""

MOST_CAUSES = 5

MOST_REFUSED = 3
"""Best candidates in a row that may be refused before the search ends."""

MOST_ALIKE = 3
"""Effects that only the angles between columns call rivals, and that are fitted to confirm it."""

SET_ERRORS, SET_SHARE = 2.0, 0.03
"""Standard errors, and share of the effect, within which the angles call two effects alike."""


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
        self.record, self.config, self.context, self.seed = record, config, context, seed
        self.catalogue, self.known = catalogue, {f.name for f in faults}
        self.lattice_N = max((f.lattice_N for f in faults), default=0.0)
        self.smoothed = any(f.velocity_m_s is not None and f.repaired == SMOOTHED for f in faults)
        self.samples = max(int(record.used.sum()), 1)
        self.ordered = bool(pressure_order(record))
        self._starts_with()

    def __call__(self, progress: Progress) -> Search:
        """Find the causes, until nothing passes the gate."""
        progress("base model", 0.1)
        models = [self.fits.base()]
        causes: list[Cause] = []
        warnings: list[str] = []
        asked: list[str] = []
        dropped = set[str]()
        refused: list[_Refused] = []
        while True:
            model = models[-1]
            progress(f"screening for cause {len(causes) + 1}", 0.15 + 0.12 * len(causes))
            view = self._view(model)
            found = None
            if len(causes) < MOST_CAUSES:
                progress(f"comparing causes {len(causes) + 1}", 0.2 + 0.12 * len(causes))
                found = self._winner(model, view, causes, {*asked, *(r.one.name for r in refused), *dropped})
            if not causes and not refused and len(warnings) < 2:
                capacity, lack = wider(model.joint, view.evidence)
                gained = found[0].gain if found else 0.0
                if capacity is not None and lack > max(3.0 * view.thresholds[0], view.least, gained):
                    warnings.append(in_words(self.problem.capacity, capacity))
                    self._starts_with(capacity)
                    models = [self.fits.base()]
                    continue
            if found is None:
                break
            best, rivals, behind = found
            by_data = best.held_N2 > view.needed.get(best.name, view.least)
            if not self._admitted(model, best, by_data, causes) or not self._apart(
                best, [r.one for r in refused if r.weak]
            ):
                weak, sized = not self._enough(model, best, causes), by_data and self.fits.known_sign(best)
                unsized = by_data and not sized and not weak
                refused.append(_Refused(best, weak, unsized, sized and self._brings_share(model, best, causes)))
                if len(refused) == MOST_REFUSED:
                    break
                continue
            if best.effect.channel and best.effect.channel not in self.context.channels:
                asked.append(best.name)
                continue
            p_value = view.p_value(best.effect, best.held_N2) if by_data else None
            # What explains as much, but of a size that the record does not tell, is not named; nor is it ruled out.
            as_good = [c.name for c in equals(best, [r.one for r in refused if r.unsized]) if equals(c, [best])]
            rivals = tuple(dict.fromkeys([*rivals, *as_good]))
            causes.append(Cause(best.name, p_value, best.gain, rivals, behind))
            models.append(best.model)
            self.fits.settle(model, best.model, self._left(best.model))
            self._forget(best.model)
            refused.clear()
            while (needless := self.fits.superfluous(models[-1], FORMS_SHARE, LATER_SHARE)) is not None:
                place, last = needless
                dropped.add(causes[place].name)
                causes, models = self._without(place, last, causes, models)
                self._forget(models[-1])
        left = self._left(models[-1])
        steps = zip(causes, models, models[1:], strict=False)
        causes = [replace(one, apart=self._apart_by(fewer, more, left)) for one, fewer, more in steps]
        causes = self._beside_refused(models[-1], causes, [r.one for r in refused if r.doubtful])
        return Search(
            self.problem,
            tuple(cause.within(left) for cause in causes),
            tuple(m.joint for m in models),
            view.gates,
            tuple(warnings),
            tuple(asked),
            view.evidence,
            view.screened,
        )

    def _without(
        self, i: int, last: Model, causes: list[Cause], models: list[Model]
    ) -> tuple[list[Cause], list[Model]]:
        """Return causes and models without a cause, each cause after it with its gain over the model before it.

        `last` is the last model without it.
        """
        between, one = [last], last
        while len(one.joint.terms) > i + 1:
            one = self.fits.without(one, len(one.joint.terms) - 1)
            between.insert(0, one)
        models = [*models[: i + 1], *between]
        after = [
            replace(cause, gain=sum(gain_parts(models[k], models[k + 1]))) for k, cause in enumerate(causes[i + 1 :], i)
        ]
        return [*causes[:i], *after], models

    def _starts_with(self, capacity: Capacity | None = None) -> None:
        """Begin with a base model of this size."""
        self.problem = BaseProblem(self.record, self.config, capacity)
        self.fits = Candidates(self.problem, self.context, self.catalogue, self.seed)
        self._views: dict[int, View] = {}
        self._after: dict[int, list[tuple[str, dict[str, float], float]]] = {}

    def _forget(self, model: Model) -> None:
        """Forget what was looked at beside other models: what the library says of one is the largest thing there is."""
        self._views = {key: view for key, view in self._views.items() if key == id(model)}
        self._after = {key: some for key, some in self._after.items() if key == id(model)}

    def _view(self, model: Model) -> View:
        """Return what screening the library says about a model's residual, once for each model."""
        if id(model) not in self._views:
            joint = model.joint
            evidence = joint.evidence(self.record, self.seed)
            out = {*self.known, *self._excluded(model)}
            if self.ordered and any(t.effect.recorded for t in joint.terms):
                out |= {n for n, cls in self.catalogue.items() if cls.acts == SLOW}
            library = build_library(self.catalogue, joint.features, joint.reference, self.context, evidence, out)
            # What a lattice leaves is no noise either.
            least = (LATER_SHARE if self.lattice_N else LEAST_SHARE) * float(evidence.ee.sum())
            self._views[id(model)] = screening(
                self.record, model.joint, evidence, library, least, self.lattice_N, self.seed
            )
            self.fits.keep(model)
        return self._views[id(model)]

    def _excluded(self, model: Model) -> set[str]:
        """Return what is in a model, with its alternatives unless it leaves much; of the times it takes one."""
        there = {t.name for t in model.joint.terms}
        families = {self.catalogue[name].family for name in there}
        alike = {name for name, cls in self.catalogue.items() if cls.family in families}
        if alike == there or self._left(model) < SECOND_LEFT * float(model.loss.sum()):
            return alike
        return there | {name for name in alike if self.catalogue[name].delays}

    def _admitted(self, model: Model, best: Candidate, by_data: bool, causes: list[Cause]) -> bool:
        """Return whether the best candidate may be named."""
        if not (by_data or best.by_evidence) or not self._enough(model, best, causes):
            return False
        fits = self.fits
        if not by_data:
            return True
        if self.smoothed and fits.undone(model, best):
            return False
        return fits.stands(model, best) and fits.known_sign(best) and self._beyond_memory(model, best)

    def _beyond_memory(self, model: Model, best: Candidate) -> bool:
        """Return whether a cause, or it with the one that would come after it, is more than unlike memories would be.

        Where two causes are left the memories make up for both.
        """
        if self.fits.beyond_memory(model, best, best.gain):
            return True
        pairs = ((self.fits(best.model, name, p), needed) for name, p, needed in self._followers(best.model))
        after = [one.gain for one, needed in pairs if one is not None and one.held_N2 > needed]
        return bool(after) and self.fits.beyond_memory(model, best, PAIR * (best.gain + max(after)))

    def _enough(self, model: Model, best: Candidate, causes: list[Cause]) -> bool:
        """Return whether a cause brings its share, and more than what other forms of the earlier causes explain."""
        if not self._brings_share(model, best, causes):
            return False
        if not causes or self.lattice_N > 0.0:
            return True
        return self.fits.beyond_forms(model, best, ample=best.held_N2 >= _later_N2(model))

    def _brings_share(self, model: Model, best: Candidate, causes: list[Cause]) -> bool:
        """Return whether a cause brings enough beside the first one, or of what is left above the floor."""
        if not causes:
            return True
        left = self._left(model)
        if best.gain < SECOND_SHARE * causes[0].gain and best.gain < SECOND_LEFT * left:
            return False
        if best.effect.family in {self.catalogue[c.name].family for c in causes} and best.gain < ALIKE_LEFT * left:
            return False
        later = best.effect.delays or best.effect.acts == REVERSAL or self.lattice_N > 0.0
        return best.by_evidence or best.gain >= (LATER_SHARE if later else FORMS_SHARE) * float(model.loss.sum())

    def _apart(self, best: Candidate, weak: list[Candidate]) -> bool:
        """Return whether a cause brings its share beside the better ones that may be another form of an earlier cause.

        What it shares with them may be that form as well.
        """
        better = [one for one in weak if one.gain > best.gain]
        if best.by_evidence or not better:
            return True
        beside = ((one, self.fits(one.model, best.name, best.term.params)) for one in better)
        return all(both is not None and both.gain > _later_N2(one.model) for one, both in beside)

    def _apart_by(self, fewer: Model, more: Model, left_N2: float) -> dict[str, float]:
        """Return by how much the quantities of a model's last term may be others (`Candidates.apart`)."""
        apart = self.fits.apart(fewer, more, left_N2)
        if self.smoothed and (back := self.fits.taken_back_s(fewer, more)):
            name = more.joint.terms[-1].effect.size_key
            apart[name] = max(back, apart.get(name, 0.0))
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

    def _left(self, model: Model) -> float:
        """Return the held-out error power above the noise floor, summed, N^2."""
        floor = noise_floor(self.record, model.joint.residual_N, self.lattice_N)
        return max(0.0, float(model.loss.sum()) - self.samples * floor**2)

    def _passing(self, model: Model, view: View, out: Collection[str]) -> list[Screened]:
        """Return what passes the gate, best first, and after it the times that may be hidden.

        The base's memory hides a late force, the length of what acts at reversals one that is ahead: both shift.
        """
        some = [s for s in view.screened if s.name not in out]
        passing = [s for s in some if s.gain > view.needed[s.name]]
        hidden = model.joint.base.coefficients.memory_energy > MEMORY_EVIDENCE
        hidden |= any(t.effect.acts == REVERSAL and not t.effect.delays for t in model.joint.terms)
        return passing + [s for s in some if s not in passing and s.hypothesis.effect.delays and hidden]

    def _compared(self, model: Model, view: View, out: Collection[str]) -> dict[str, Candidate]:
        """Refit the best candidates jointly with base and earlier causes."""
        passing = self._passing(model, view, out)
        top = [s for s in passing[:CANDIDATES] if s.gain > CONTENDER * passing[0].gain]
        known = {s.name for s in top}
        # What shows at reversals is badly screened while the base model has bent towards it.
        top += [s for s in passing if s.hypothesis.effect.acts == REVERSAL and s.name not in known][:3]
        known = {s.name for s in top}
        top += [s for s in passing if s.hypothesis.effect.delays and s.name not in known]
        fitted = [self.fits(model, s.name, s.params) for s in top]
        return {c.name: c for c in fitted if c is not None}

    def _winner(
        self, model: Model, view: View, causes: list[Cause], out: Collection[str]
    ) -> tuple[Candidate, tuple[str, ...], dict[str, float]] | None:
        """Return the best candidate in its best form, the names of its equals, and how far behind it others are."""
        fits = self._compared(model, view, out)
        plain = dict(fits)
        fits = self.fits.in_best_forms(model, fits, CLOSE)
        if not fits:
            return None
        best = plainest(max(fits.values(), key=lambda c: c.gain), list(fits.values()))
        best = self._measured(model, best, list(fits.values()), causes)
        best = self.fits.resettled(model, self._ahead(self.fits.shaped(model, best), fits, plain))
        found = alike(view.evidence, view.library, best.model.joint.parts_N[-1], CONTENDER)
        for name in [n for n in closest(found, SET_ERRORS, SET_SHARE) if n not in plain and n not in out][:MOST_ALIKE]:
            one_more = self.fits(model, name, found[name].params)
            if one_more is not None:
                fits[name] = one_more
        same = equals(best, list(fits.values()))
        # What goes with time is made as well as that of a recorded variable by many a shape; anything else is not.
        slow = best.effect.acts == SLOW
        measured = next((c for c in same if c.effect.recorded and (slow or within_errors(best, c))), None)
        if measured is not None and not best.effect.recorded:
            # Of equals the one whose cause was recorded is named: it needs no cause that nobody saw.
            best = measured
            same = equals(best, list(fits.values()))
        close = sorted((c for c in fits.values() if c.gain > CLOSE * best.gain), key=lambda c: -c.gain)
        behind = {c.name: best.gain - c.gain for c in close if c.name != best.name and not needs_memory(best, c)}
        return best, tuple(dict.fromkeys([*(c.name for c in same), *self._by_design(best.effect)])), behind

    def _measured(self, model: Model, best: Candidate, others: Sequence[Candidate], causes: list[Cause]) -> Candidate:
        """Return the recorded cause, where the best one would have had to change with it.

        Where the pressures come in one order a slow change may be theirs; one that goes on within each of them is not.
        A model that still misses as much as that says nothing of it.
        """
        if not self.ordered or best.effect.acts != SLOW:
            return best
        least = max(_later_N2(model), self._left(best.model))
        for one in others:
            enough = one.gain > MEASURED_SHARE * best.gain and self._enough(model, one, causes)
            if one.effect.recorded and enough and not self.fits.within_pressures(model, best, least):
                return one
        return best

    def _ahead(self, best: Candidate, fits: Mapping[str, Candidate], plain: Mapping[str, Candidate]) -> Candidate:
        """Return the candidate that explains most together with the cause that would come after it.

        Looked at only where another family or time of the whole force comes close, or the best one in its `plain` form,
        and the best one leaves more than noise: another form of a cause may make up for half of what a second cause
        does. What was recorded is not given up for what nobody saw. A cause more must bring its share, and a parameter
        more what it brings beyond chance.
        """
        if best.effect.recorded:
            return best
        close = [
            c
            for c in sorted(fits.values(), key=lambda c: -c.gain)
            if c.name != best.name and c.gain > CLOSE * best.gain
            if c.effect.family != best.effect.family or c.effect.delays
        ]
        first = plain.get(best.name, best)
        options = [best] if first is best else [best, first]
        options += close[: OPTIONS - len(options)]
        if not options[1:] or self._left(best.model) < SECOND_SHARE * best.gain:
            return best
        return max(options, key=lambda c: self._worth(c, best))

    def _worth(self, option: Candidate, best: Candidate) -> float:
        """Return the gain of an option with the best cause after it, less what further parameters bring by chance."""
        after = [(self.fits(option.model, name, p), needed) for name, p, needed in self._followers(option.model)]
        alone = option.gain - PLAIN * option.freedom * best.samples_N2
        with_more = [
            c.gain - PLAIN * c.freedom * best.samples_N2 - SECOND_SHARE * best.gain
            for c, needed in after
            if c is not None and c.held_N2 > needed
        ]
        if option is not best:
            self._views.pop(id(option.model), None)
        return alone + max([0.0, *with_more])

    def _followers(self, model: Model) -> list[tuple[str, dict[str, float], float]]:
        """Return name and parameters of the effects that pass best after a model, and what each must bring, N^2."""
        if id(model) not in self._after:
            view = self._view(model)
            passing = self._passing(model, view, ())[:FOLLOWERS]
            self._after[id(model)] = [(s.name, s.params, view.needed[s.name]) for s in passing]
        return self._after[id(model)]

    def _by_design(self, effect: type[Effect]) -> list[str]:
        """Return what a recorded cause that only changed in one order cannot be told from: whatever goes with time."""
        if not self.ordered:
            return []
        if effect.recorded:
            return [name for name, cls in self.catalogue.items() if cls.acts == SLOW]
        if effect.acts == SLOW:
            recorded = [name for name, cls in self.catalogue.items() if cls.recorded]
            return [name for name in recorded if self.catalogue[name].channel in self.context.channels]
        return []


def _later_N2(model: Model) -> float:
    """Return the gain that a cause beside the others of this model must bring, N^2."""
    return LATER_SHARE * float(model.loss.sum())
