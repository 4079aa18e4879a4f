"""What a search sees beside each of its models: what screening says is left, and what comes next."""

from collections.abc import Collection, Iterator, Mapping, Sequence

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity
from friction_estimator.diagnosis.candidate import MEMORY_EVIDENCE, Candidate, Model
from friction_estimator.diagnosis.candidates import Candidates
from friction_estimator.diagnosis.causes import FORMS_SHARE, LATER_SHARE, LEAST_SHARE
from friction_estimator.diagnosis.floor import coarse_step, noise_floor
from friction_estimator.diagnosis.library import build_library
from friction_estimator.diagnosis.pressures import pressure_order, pressures_held
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.screening import Screened, View, screening
from friction_estimator.effects.base import REVERSAL, SLOW, Effect
from friction_estimator.effects.detection import Fault
from friction_estimator.effects.features import Context

Catalogue = Mapping[str, type[Effect]]

SECOND_LEFT = 0.2
"""Share of a model's error power that must be left above the noise floor before forms that screening does not see are
looked at, too."""

FOLLOWERS = 2
"""Effects that are fitted beside a candidate."""


class Views:
    """What is seen of one record beside the models of one base: screened once for each model.

    Parameters
    ----------
    record : repaired. context : facts about it. catalogue : effects by name. seed : of folds and bootstrap.
    faults : that were found in the data already, and repaired: they are no causes. capacity : of the base.

    Attributes
    ----------
    steps_N, lattice_N : step of the force, and the same where rounding to it repeats with the drive; 0 without.
    """

    def __init__(
        self,
        record: Record,
        config: Config,
        context: Context,
        catalogue: Catalogue,
        seed: int,
        faults: Sequence[Fault],
        capacity: Capacity | None,
    ) -> None:
        self.record, self.context, self.catalogue, self.seed = record, context, catalogue, seed
        self.known = {f.name for f in faults}
        self.ordered, self.held = bool(pressure_order(record)), pressures_held(record)
        self.problem = BaseProblem(record, config, capacity)
        self.fits = Candidates(self.problem, context, catalogue, seed)
        self._samples = max(int(record.used.sum()), 1)
        self._views: dict[Model, View] = {}
        self.steps_N = max((f.lattice_N for f in faults), default=0.0)
        self.lattice_N = coarse_step(record, self.fits.base().joint.residual_N, self.steps_N) if self.steps_N else 0.0
        self._after: dict[Model, list[tuple[str, dict[str, float], float]]] = {}

    def of(self, model: Model) -> View:
        """Return what screening the library says about a model's residual."""
        if model not in self._views:
            joint = model.joint
            evidence = joint.evidence(self.record, self.seed)
            out = {*self.known, *self._excluded(model)}
            library = build_library(self.catalogue, joint.features, joint.reference, self.context, evidence, out)
            # What a lattice leaves is no noise either.
            least = (LATER_SHARE if self.lattice_N else LEAST_SHARE) * float(evidence.ee.sum())
            self._views[model] = screening(
                self.record, model.joint, evidence, library, least, self.lattice_N, self.seed
            )
        return self._views[model]

    def _excluded(self, model: Model) -> set[str]:
        """Return what is in a model, with its alternatives unless it leaves much; of the times it takes one."""
        there = {t.name for t in model.joint.terms}
        families = {self.catalogue[name].family for name in there}
        alike = {name for name, cls in self.catalogue.items() if cls.family in families}
        if alike == there or self.left_N2(model) < FORMS_SHARE * float(model.loss.sum()):
            return alike
        return there | {name for name in alike if self.catalogue[name].delays}

    def left_N2(self, model: Model) -> float:
        """Return the held-out error power above the noise floor, summed, N^2."""
        floor = noise_floor(self.record, model.joint.residual_N, self.lattice_N)
        return max(0.0, float(model.loss.sum()) - self._samples * floor**2)

    def passing(self, model: Model, out: Collection[str]) -> list[Screened]:
        """Return what passes the gate, best first, and after it the times that may be hidden.

        The base's memory hides a late force, the length of what acts at reversals one that is ahead: both shift.
        """
        view = self.of(model)
        some = [s for s in view.screened if s.name not in out]
        passing = [s for s in some if s.gain > view.needed[s.name]]
        hidden = model.joint.coefficients.memory_energy > MEMORY_EVIDENCE
        hidden |= any(t.effect.acts == REVERSAL and not t.effect.delays for t in model.joint.terms)
        return passing + [s for s in some if s not in passing and s.hypothesis.effect.delays and hidden]

    def passes(self, model: Model, one: Candidate) -> bool:
        """Return whether a candidate's held-out gain passes the gate beside a model."""
        view = self.of(model)
        return one.held_N2 > view.needed.get(one.name, view.least)

    def unscreened(self, model: Model, out: Collection[str]) -> Iterator[Candidate]:
        """Yield the best fit of each effect in forms that screening does not see, beside a model that leaves much.

        Of equally good ones forces of either sign may nearly cancel in the best: one of known sign is taken first.
        """
        if self.left_N2(model) < SECOND_LEFT * float(model.loss.sum()):
            return
        for s in self.of(model).screened:
            forms = s.hypothesis.effect.unscreened(self.context) if s.name not in out else []
            fits = [one for one in (self.fits(model, s.name, form) for form in forms) if one is not None]
            if fits:
                told = [one for one in fits if self.fits.known_sign(one)]
                yield max(told or fits, key=lambda one: one.gain)

    def followers(self, model: Model) -> Iterator[Candidate]:
        """Yield the effects that pass best after a model, fitted beside it, which bring what they must."""
        for name, params, needed in self._followers(model):
            one = self.fits(model, name, params)
            if one is not None and one.held_N2 > needed:
                yield one

    def _followers(self, model: Model) -> list[tuple[str, dict[str, float], float]]:
        """Return name and parameters of the effects that pass best after a model, and what each must bring, N^2."""
        if model not in self._after:
            view = self.of(model)
            passing = self.passing(model, self.with_pressure(model))[:FOLLOWERS]
            self._after[model] = [(s.name, s.params, view.needed[s.name]) for s in passing]
        return self._after[model]

    def with_pressure(self, model: Model) -> set[str]:
        """Return what may be another form of a recorded cause in a model: where that changed in one order, all slow."""
        recorded = any(t.effect.recorded for t in model.joint.terms)
        return {n for n, cls in self.catalogue.items() if cls.acts == SLOW} if self.ordered and recorded else set()

    def keep_only(self, model: Model | None) -> None:
        """Forget what was seen beside other models: what the library says of one is the largest thing there is."""
        self._views = {key: view for key, view in self._views.items() if key is model}
        self._after = {key: some for key, some in self._after.items() if key is model}

    def forget(self, model: Model) -> None:
        """Forget what was seen beside a model, but for what comes after it."""
        self._views.pop(model, None)
