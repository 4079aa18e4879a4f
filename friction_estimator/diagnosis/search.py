"""The search for causes: screen, compare by joint refit, guard, name, until nothing passes the gate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import Capacity
from friction_estimator.diagnosis.candidate import Candidate, Model, equals, gain_parts
from friction_estimator.diagnosis.capacity import in_words, wider
from friction_estimator.diagnosis.causes import LATER_SHARE, Cause, Search
from friction_estimator.diagnosis.comparison import Comparison
from friction_estimator.diagnosis.guards import FORMS_SHARE, Guards
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.views import Catalogue, Views
from friction_estimator.effects.base import SLOW
from friction_estimator.effects.detection import SMOOTHED, Fault
from friction_estimator.effects.features import Context

MOST_CAUSES = 5

MOST_REFUSED = 3
"""Best candidates in a row that may be refused before the search ends."""

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
        self._views_of = partial(Views, record, config, context, catalogue, seed, faults)
        self.smoothed = any(f.velocity_m_s is not None and f.repaired == SMOOTHED for f in faults)
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
            view = self.views.of(model)
            found = None
            if len(causes) < MOST_CAUSES:
                progress(f"comparing causes {len(causes) + 1}", 0.2 + 0.12 * len(causes))
                found = self.comparison.winner(model, causes, {*asked, *(r.one.name for r in refused), *dropped})
            if not causes and not refused and len(warnings) < 2:
                capacity, lack = wider(model.joint, view.evidence)
                gained = found[0].gain if found else 0.0
                if capacity is not None and lack > max(3.0 * view.thresholds[0], view.least, gained):
                    warnings.append(in_words(self.views.problem.capacity, capacity))
                    self._starts_with(capacity)
                    models = [self.fits.base()]
                    continue
            if found is None:
                break
            best, rivals, behind = found
            by_data = best.held_N2 > view.needed.get(best.name, view.least)
            weaker = [r.one for r in refused if r.weak]
            if not self.guards.admit(model, best, by_data, causes) or not self.guards.apart(best, weaker):
                weak, sized = not self.guards.enough(model, best, causes), by_data and self.fits.known_sign(best)
                unsized = by_data and not sized and not weak
                refused.append(_Refused(best, weak, unsized, sized and self.guards.brings_share(model, best, causes)))
                if len(refused) == MOST_REFUSED:
                    break
                continue
            if best.effect.channel and best.effect.channel not in self.views.context.channels:
                asked.append(best.name)
                continue
            p_value = view.p_value(best.effect, best.held_N2) if by_data else None
            # What explains as much, but of a size that the record does not tell, is not named; nor is it ruled out. Of
            # slow changes nor is one that explains more: over how long it goes on is what the record does not tell.
            as_good = [
                c.name
                for c in equals(best, [r.one for r in refused if r.unsized])
                if equals(c, [best]) or c.effect.acts == best.effect.acts == SLOW
            ]
            rivals = tuple(dict.fromkeys([*rivals, *as_good]))
            causes.append(Cause(best.name, p_value, best.gain, rivals, behind))
            models.append(best.model)
            self.views.keep_only(best.model)
            refused.clear()
            while (needless := self.fits.superfluous(models[-1], FORMS_SHARE, LATER_SHARE)) is not None:
                place, last = needless
                dropped.add(causes[place].name)
                causes, models = self._without(place, last, causes, models)
                self.views.keep_only(models[-1])
        left = self.views.left_N2(models[-1])
        steps = zip(causes, models, models[1:], strict=False)
        causes = [replace(one, apart=self._apart_by(fewer, more, left)) for one, fewer, more in steps]
        causes = self._beside_refused(models[-1], causes, [r.one for r in refused if r.doubtful])
        return Search(
            self.views.problem,
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
        self.views = self._views_of(capacity)
        self.fits = self.views.fits
        self.guards = Guards(self.views, self.smoothed)
        self.comparison = Comparison(self.views, self.guards)

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
