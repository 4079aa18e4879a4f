"""Greedy search for causes: screen the library, gate, compare by joint refit, and say what cannot be told apart."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import SPLINES, BaseProblem, Capacity, Coefficients, OddCurve
from friction_estimator.diagnosis.evidence import Evidence, Rule
from friction_estimator.diagnosis.excitation import pressure_order
from friction_estimator.diagnosis.floor import noise_floor
from friction_estimator.diagnosis.intervals import estimates
from friction_estimator.diagnosis.joint import Joint, JointFit, Term, cross_validated_loss
from friction_estimator.diagnosis.lagged import lagged
from friction_estimator.diagnosis.library import Library, build_library
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.rivals import Alike, alike, closest
from friction_estimator.diagnosis.screening import FLIPS, Screened, gate, screen
from friction_estimator.effects.base import REVERSAL, SLOW, Effect
from friction_estimator.effects.features import Context

Catalogue = Mapping[str, type[Effect]]

LEVEL = 0.01
MARGIN = 1.5
"""The best held-out gain must exceed this many times the bootstrap's quantile."""

LEAST_SHARE = 0.002
"""And this share of the error power."""

MEMORY_EVIDENCE = 20.0
"""Prior energy of the base's memory that a delay of the whole force must save to be named by evidence alone: a
probability ratio of exp(10)."""

CANDIDATES = 6
"""Effects that are compared by joint refit."""

CONTENDER = 0.25
"""Share of the best gain below which an effect is not refitted, and is no rival."""

MEASURED_SHARE = 0.25
"""Of the best gain: what a recorded variable must explain to be preferred to an unrecorded one."""

SECOND_SHARE = 0.02
ALIKE_SHARE = 0.10
"""A further cause must bring this share of the first one's gain; the larger where both act near reversals, since what
another functional form of the first leaves there looks like the second."""

EARLY = 2.5
"""Sample periods after a reversal without which an effect that acts everywhere must still gain."""

SECOND_LEFT, ALIKE_LEFT = 0.2, 0.8
"""Or this share of what the causes before it have left above the noise floor: a first cause of great power, a trait of
the rig, must not hide a second one."""

MOST_CAUSES = 5
PLAIN = 10.0
"""Times the noise power: surplus of gain that one more parameter must bring."""

MOST_ALIKE = 3
"""Effects that only the angles between columns call rivals, and that are fitted to confirm it."""

SET_ERRORS = 2.0
SET_SHARE = 0.03
FINER = 24
LONGER = 16


@dataclass(frozen=True)
class Cause:
    """A named cause.

    Attributes
    ----------
    name : effect id. p_value : family-wise, None where evidence alone names it.
    gain : held-out decrease of the error power with what the prior of the memory saves, summed, N^2.
    rivals : effects that explain the data as well, best first.
    """

    name: str
    p_value: float | None
    gain: float
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Search:
    """What a search found.

    Attributes
    ----------
    problem : the base model on the record. causes : in the order in which they were taken up.
    models : base alone, then with each cause added.
    thresholds : gain that an effect had to exceed, N^2 (ordinary and wide hypotheses).
    warnings : in words. asked : effects that would have won but need a channel.
    """

    problem: BaseProblem
    causes: tuple[Cause, ...]
    models: tuple[Joint, ...]
    thresholds: tuple[float, float]
    warnings: tuple[str, ...]
    asked: tuple[str, ...]
    last_evidence: Evidence
    screened: tuple[Screened, ...]


Progress = Callable[[str, float], None]


class Searcher:
    """The greedy search on one record.

    Parameters
    ----------
    record : repaired. context : facts about it. catalogue : effects by name. seed : of folds and bootstrap.
    coarse_N2 : error power that is known to be a lattice's: causes must bring more than that.
    known : effects that were found in the data already.
    """

    def __init__(
        self,
        record: Record,
        config: Config,
        context: Context,
        catalogue: Catalogue,
        seed: int,
        coarse_N2: float = 0.0,
        known: Collection[str] = (),
    ) -> None:
        self.record, self.config, self.context, self.seed = record, config, context, seed
        self.catalogue, self.coarse_N2, self.known = catalogue, coarse_N2, known
        self.problem = BaseProblem(record, config, Capacity(SPLINES, config.fir.order))
        self.samples = max(int(record.used.sum()), 1)
        self.ordered = bool(pressure_order(record))

    def __call__(self, progress: Progress) -> Search:
        """Find the causes, until nothing passes the gate."""
        warnings: list[str] = []
        progress("base model", 0.1)
        models, losses = self._base()
        causes: list[Cause] = []
        asked: list[str] = []
        refused: list[str] = []
        thresholds = (0.0, 0.0)
        while True:
            model = models[-1]
            evidence = model.evidence(self.record, self.seed)
            progress(f"screening for cause {len(causes) + 1}", 0.15 + 0.12 * len(causes))
            families = {t.effect.family for t in model.terms}
            out = {*asked, *refused, *self.known, *(n for n, cls in self.catalogue.items() if cls.family in families)}
            if self.ordered and any(t.effect.recorded for t in model.terms):
                out |= {n for n, cls in self.catalogue.items() if cls.acts == SLOW}
            library = build_library(self.catalogue, model.features, model.reference, self.context, evidence, out)
            screened = screen(evidence, library)
            null, wide = gate(self.record, model, library, screened, self.seed)
            thresholds = tuple(float(np.quantile(n, 1.0 - LEVEL / 2.0)) * MARGIN for n in (null, wide))  # type: ignore[assignment]
            least = LEAST_SHARE * float(evidence.ee.sum()) + self.coarse_N2 * evidence.samples
            needed = {s.name: max(thresholds[s.hypothesis.effect.many], least) for s in screened}
            passing = [s for s in screened if s.gain > needed[s.name]]
            passing += [
                s
                for s in screened
                if s not in passing
                and s.hypothesis.effect.delays
                and model.base.coefficients.memory_energy > MEMORY_EVIDENCE
            ]
            finer = {} if causes or len(warnings) >= 2 else self._capacity_gains(model, evidence)
            wider = max(finer, key=lambda k: finer[k], default=None)
            lack = finer[wider] if wider is not None else 0.0
            found, left = None, 0.0
            if passing and len(causes) < MOST_CAUSES:
                progress(f"comparing causes {len(causes) + 1}", 0.2 + 0.12 * len(causes))
                left = self._left(model, losses[-1])
                found = self._compare(model, losses[-1], passing, causes, left, evidence, library)
            if wider is not None and lack > max(3.0 * thresholds[0], least, found.gain if found else 0.0):
                self.problem = BaseProblem(self.record, self.config, wider)
                what = "a finer static curve" if wider.splines > SPLINES else "a longer memory"
                warnings.append(f"the base model needed {what} than usual; that is lack of fit, no cause")
                models, losses = self._base()
                continue
            if found is None:
                break
            effect = self.catalogue[found.name]
            held = float((losses[-1] - found.loss).sum())
            saved = found.gain - held
            by_data = held > needed.get(found.name, least)
            if not (by_data or (effect.delays and saved > MEMORY_EVIDENCE * found.variance)):
                break
            if not self._enough(effect, found.gain, causes, left):
                break
            if by_data and not (self._stands(model, found.joint) and self._known_sign(found.joint)):
                refused.append(found.name)
                continue
            if effect.channel and effect.channel not in self.context.channels:
                asked.append(found.name)
                continue
            pool = wide if effect.many else null
            p_value = min(1.0, 2.0 * float(1 + np.sum(pool >= held)) / (FLIPS + 1)) if by_data else None
            causes.append(Cause(found.name, p_value, found.gain, found.rivals))
            models.append(found.joint)
            losses.append(found.loss)
            refused.clear()
        return Search(
            self.problem,
            tuple(causes),
            tuple(models),
            thresholds,
            tuple(warnings),
            tuple(asked),
            evidence,
            tuple(screened),
        )

    def _base(self) -> tuple[list[Joint], list[Floats]]:
        model = JointFit(self.problem, self.context)()
        return [model], [cross_validated_loss(model, self.record, self.seed)]

    def _enough(self, effect: type[Effect], gain: float, causes: Sequence[Cause], left_N2: float) -> bool:
        """Return whether a cause brings enough beside the first one, or of what is left above the floor."""
        if not causes:
            return True
        alike = effect.acts == REVERSAL and any(self.catalogue[c.name].acts == REVERSAL for c in causes)
        beside, of_left = (ALIKE_SHARE, ALIKE_LEFT) if alike else (SECOND_SHARE, SECOND_LEFT)
        return gain >= beside * causes[0].gain or gain >= of_left * left_N2

    def _left(self, model: Joint, loss: Floats) -> float:
        """Return the held-out error power above the noise floor, summed, N^2."""
        return max(0.0, float(loss.sum()) - self.samples * noise_floor(self.record, model.residual_N) ** 2)

    def _compare(
        self,
        model: Joint,
        loss: Floats,
        passing: Sequence[Screened],
        causes: Sequence[Cause],
        left: float,
        evidence: Evidence,
        library: Library,
    ) -> "_Compared | None":
        """Refit the best candidates jointly with base and earlier causes; return the winner and its equals."""
        fit = JointFit(self.problem, self.context)
        top = [s for s in passing[:CANDIDATES] if s.gain > CONTENDER * passing[0].gain]
        known = {s.name for s in top}
        # What shows at reversals is badly screened while the base model has bent towards it.
        top += [s for s in passing if s.hypothesis.effect.acts == REVERSAL and s.name not in known][:3]
        known = {s.name for s in top}
        top += [s for s in passing if s.hypothesis.effect.delays and s.name not in known]
        here = model.base.coefficients
        fits: dict[str, _Compared] = {}
        for item in top:
            self._add_candidate(fits, item.name, dict(item.params), model, loss)
        if not fits or max(c.gain for c in fits.values()) <= 0.0:
            return None
        winner = max(fits, key=lambda n: fits[n].gain)
        noise_N2 = float(fits[winner].loss.sum()) / self.samples
        winner = plainer(winner, fits, noise_N2)
        # A recorded variable that changed is preferred to an unrecorded cause that would have had to change with it.
        slow = self.ordered and fits[winner].effect.acts == SLOW
        for name, one in fits.items():
            enough = one.gain > MEASURED_SHARE * fits[winner].gain and self._enough(one.effect, one.gain, causes, left)
            if slow and one.effect.recorded and enough:
                winner = name
        best = fits[winner]
        for params in best.effect.variants(best.joint.terms[-1].params):
            joint = fit([*model.terms, Term(best.effect, params)], here)
            other = self._judged(winner, joint, loss, here)
            more = joint.terms[-1].weights.size - best.joint.terms[-1].weights.size
            if np.isfinite(other.gain) and other.gain - best.gain > PLAIN * max(more, 1) * noise_N2:
                best = other
        self._add_alike(fits, model, loss, alike(evidence, library, best.joint.parts_N[-1], CONTENDER))
        equals = _equals(best, fits)
        measured = next((n for n in equals if fits[n].effect.recorded), None)
        if measured is not None and not best.effect.recorded:
            # Of equals the one whose cause was recorded is named: it needs no cause that nobody saw.
            best = fits[measured]
            equals = _equals(best, fits)
        return replace(best, rivals=tuple(dict.fromkeys([*equals, *self._by_design(best.effect)])))

    def _add_alike(self, fits: dict[str, "_Compared"], model: Joint, loss: Floats, found: Mapping[str, Alike]) -> None:
        """Fit what the angles between columns say is a rival of the winner, and was no candidate."""
        for name in [n for n in closest(found, SET_ERRORS, SET_SHARE) if n not in fits][:MOST_ALIKE]:
            self._add_candidate(fits, name, dict(found[name].params), model, loss)

    def _add_candidate(
        self, fits: dict[str, "_Compared"], name: str, params: dict[str, float], model: Joint, loss: Floats
    ) -> None:
        """Fit an effect beside the model and add it, unless its signs or values cannot be."""
        here = model.base.coefficients
        joint = JointFit(self.problem, self.context)([*model.terms, Term(self.catalogue[name], params)], here)
        if signs_kept(joint) and self._inside(joint.terms[-1]):
            one = self._judged(name, joint, loss, here)
            if np.isfinite(one.gain):
                fits[name] = one

    def _judged(self, name: str, joint: Joint, loss: Floats, before: Coefficients) -> "_Compared":
        after = cross_validated_loss(joint, self.record, self.seed)
        now = joint.base.coefficients
        saved = now.variance * (before.memory_energy - now.memory_energy)
        return _Compared(
            name, joint.terms[-1].effect, joint, after, float((loss - after).sum()) + saved, now.variance, ()
        )

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

    def _inside(self, term: Term) -> bool:
        """Return whether the record spans what was fitted."""
        return term.effect.spans(term.params, term.weights, self.context) is None

    def _stands(self, model: Joint, joint: Joint) -> bool:
        """Return whether an effect gains in most of the record, and beyond the samples right after reversals.

        A sharp model error there depends on the phase of the sampling; a name that lives on it alone names that.
        """
        effect = joint.terms[-1].effect
        decrease = (np.square(model.residual_N) - np.square(joint.residual_N)) * self.record.used
        if effect.acts != REVERSAL:
            early = self.record.features.since_reversal_s < EARLY * self.context.step_s
            decrease = np.where(early, 0.0, decrease)
        gains = np.bincount(self.record.block, weights=decrease)
        error = float(np.std(gains, ddof=1)) * np.sqrt(gains.size)
        return bool(gains.sum() > student.ppf(0.975, gains.size - 1) * error)

    def _known_sign(self, joint: Joint) -> bool:
        """Return whether what physics gives one sign, and every length and time, differs from zero by its interval."""
        term = joint.terms[-1]
        fitted = estimates(joint, self.record, self.context, self.seed, systematic=False)[-1]
        one_sign = {name for name in fitted if name in term.effect.refined and name not in term.effect.steps}
        if len(term.effect.signs) == term.weights.size and all(term.effect.signs):
            one_sign |= set(fitted)
        return all(fitted[name].low > 0.0 or fitted[name].high < 0.0 for name in one_sign)

    def _capacity_gains(self, model: Joint, evidence: Evidence) -> dict[Capacity, float]:
        """Return the held-out gain of a finer static curve and of a longer memory."""
        out = {}
        capacity, products = self.problem.capacity, self.problem.products
        if capacity.splines < FINER:
            fine = OddCurve(model.base.curve.top, FINER)(self.record.features.velocity_m_s)
            out[Capacity(FINER, capacity.order)] = _gain(evidence, fine)
        if capacity.order < LONGER:
            force = model.base.static_N
            lags = range(capacity.order + 1, LONGER + 1)
            more = np.column_stack([lagged(force, i, products.start) - force for i in lags])
            out[Capacity(capacity.splines, LONGER)] = _gain(evidence, more)
        return out


@dataclass(frozen=True)
class _Compared:
    """A candidate after its joint refit; `gain` holds what the prior of the memory saves."""

    name: str
    effect: type[Effect]
    joint: Joint
    loss: Floats
    gain: float
    variance: float
    rivals: tuple[str, ...]

    @property
    def freedom(self) -> int:
        """Parameters of the effect."""
        term = self.joint.terms[-1]
        return (0 if term.effect.fixed_gain else term.weights.size) + len(term.effect.refined)


def _equals(best: _Compared, fits: Mapping[str, _Compared]) -> list[str]:
    """Return the effects that explain the record as well as one of them does, best first."""
    out = []
    for name in sorted(fits, key=lambda n: -fits[n].gain):
        if name == best.name:
            continue
        behind = fits[name].loss - best.loss
        error = float(np.std(behind, ddof=1)) * np.sqrt(behind.size)
        apart = best.gain - fits[name].gain
        leans = fits[name].joint.base.coefficients.memory_energy - best.joint.base.coefficients.memory_energy
        if leans > MEMORY_EVIDENCE:  # the base's memory would have to do what the winner does alone
            continue
        if apart < SET_ERRORS * error or apart < SET_SHARE * best.gain:
            out.append(name)
    return out


def signs_kept(joint: Joint) -> bool:
    """Return whether the coefficients have the signs that physics gives them."""
    return all(
        sign * weight >= 0.0
        for term in joint.terms
        if len(term.effect.signs) == term.weights.size
        for sign, weight in zip(term.effect.signs, term.weights, strict=True)
    )


def plainer(winner: str, fits: Mapping[str, _Compared], noise_N2: float) -> str:
    """Return an effect with fewer parameters where the winner's surplus is what its further ones bring by chance."""
    best = fits[winner]
    close = [n for n, c in fits.items() if best.gain - c.gain < PLAIN * noise_N2 * max(best.freedom - c.freedom, 0)]
    return min([winner, *close], key=lambda n: (fits[n].freedom, -fits[n].gain))


def _gain(evidence: Evidence, columns: Floats) -> float:
    moments = evidence.moments(columns)
    return float(evidence.cross_validated(moments, Rule((0,) * columns.shape[1])).sum())
