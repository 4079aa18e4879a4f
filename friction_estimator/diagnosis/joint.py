"""Base model and named effects fitted together: nonlinear parameters refined, tangent, held-out loss."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base import BaseFit, reference_of
from friction_estimator.diagnosis.base_problem import BaseProblem, Coefficients
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.library import with_running_force
from friction_estimator.diagnosis.linear import LinearFit
from friction_estimator.diagnosis.own_columns import OwnColumns, Term, largest_change, moves, weighted
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.seek import at_end, beside, downhill
from friction_estimator.diagnosis.sought import Sought
from friction_estimator.diagnosis.tangent import Tangent, normal_equations
from friction_estimator.diagnosis.term_columns import TermColumns
from friction_estimator.effects.compose import FINE
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

ROUNDS = 14
SETTLED, SETTLED_COST = 1e-3, 2e-3
"""Most rounds of the joint fit, and the relative changes of its parameters and of its cost at which they end.

A column is made from tables of the base, and the base is fitted beside the column: a fixed point, whose cost still
falls by a tenth a round where a parameter moves by a thousandth of its bracket."""

RISES, RUN_AWAY = 4, 1.01
"""Rounds in a row without a lower cost after which a joint fit ends, and the cost over the lowest one from which that
round is taken instead: a fixed point may run away."""

DAMPINGS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a Gauss-Newton step of the refined parameters that are tried, the first that descends is taken."""

IN_VAIN = 2
"""Rounds in a row in which no share of that step descends after which the refined parameters stay: 97 of 100 later
steps fail, too, the others gain less than 5e-4 of the cost. The rounds that follow settle the tables."""

DERIVATIVE_STEP = 1e-3
"""Step of a refined parameter in numerical derivatives, as a share of the bracket in which it is sought."""

JUMP_STEP = 4e-3
"""The same for a parameter in which the columns jump: at least a sample must move."""

MOVED = 0.05
"""Share of the logarithm of its bracket beyond which a parameter that is sought anew lies in another minimum."""

LEAST_SLOPE = 1e-11
"""Share of the rms of friction below which a column of the tangent is rounding: its parameter stays where it is."""

HELD = 1e12
"""Penalty of a tangent coefficient that must stay zero."""


@dataclass(frozen=True)
class Joint:
    """Base model and effects fitted together.

    Attributes
    ----------
    base : the base model's part. terms : with fitted parameters and weights.
    reference : tables made from the base. features : of the record, with the running force.
    parts_N : one (n,) array for each term: its force.
    residual_N : (n,). tangent : (n, q), of the whole model. penalty : (q,).
    scales : (q,), what a unit of each tangent coefficient is in the parameter's own unit.
    at_end : (q,) bool, coefficients of parameters that stand at an end of their bracket and are held there.
    """

    base: BaseFit
    terms: tuple[Term, ...]
    reference: Reference
    features: Features
    parts_N: tuple[Floats, ...]
    residual_N: Floats
    tangent: Tangent
    penalty: Floats
    scales: Floats
    at_end: Bools

    def evidence(self, record: Record, seed: int) -> Evidence:
        """Return the evidence machine for what this model leaves."""
        return Evidence(self.tangent, self.penalty, self.residual_N, record.used, record.block, seed)


class JointFit:
    """The joint fit of base and effects to one record, or to some of its blocks.

    One time of the whole force and a lagging film change the base's own columns; the others add columns beside it.

    Parameters
    ----------
    problem : the base model on the record. context : facts about it. rows : (blocks,) bool, those that are
        fitted (default all).
    """

    def __init__(self, problem: BaseProblem, context: Context, rows: Bools | None = None) -> None:
        self._problem, self._context, self._rows = problem, context, rows
        self._record = problem.record
        self._used = self._record.used if rows is None else self._record.used & rows[self._record.block]
        self._base = OwnColumns(problem, context)
        self._columns = TermColumns(self._base)
        self._linear = LinearFit(self._base, rows)
        self._sought = Sought(self._base, self._columns, context, rows)

    def __call__(
        self, terms: Sequence[Term] = (), start: Coefficients | None = None, rounds: int = ROUNDS, search: bool = True
    ) -> Joint:
        """Fit.

        Parameters
        ----------
        terms : effects with their parameters to start from. start : an earlier fit of the base alone or with others.
        rounds : most rounds. search : look for the last term's refined parameters over their whole bracket first.
        """
        base = start if start is not None else self._problem.fit(rows=self._rows)
        if not terms:
            return self._finished(base, (), *self._reference(base, terms), ())
        found = self._fit(list(terms), base, rounds, search)
        last = terms[-1].effect
        steps = [name for name in last.refined if name in last.steps and last.fixed_gain]
        return self._walked(found, terms, steps[0], base, rounds) if search and steps else found

    def without(self, joint: Joint, i: int) -> Joint:
        """Return a fit without one of its terms, the others refined from where they are."""
        terms = [term for k, term in enumerate(joint.terms) if k != i]
        return self(terms, joint.base.coefficients, search=False)

    def elsewhere(self, terms: Sequence[Term], start: Coefficients) -> bool:
        """Return whether a search for the last term's refined parameters ends elsewhere than where they are."""
        term = terms[-1]
        reference, features = self._reference(start, terms)
        found = self._sought(terms, start, self._sought.tables(term, reference), features)
        for name in term.refined:
            here, there = term.params[name], found[name]
            low, high = term.effect.bracket(name, here, self._context)
            if here != there and (name in term.effect.steps or abs(np.log(there / here)) > MOVED * np.log(high / low)):
                return True
        return False

    def _walked(self, found: Joint, terms: Sequence[Term], name: str, base: Coefficients, rounds: int) -> Joint:
        """Return the fit on the best plateau of a jumping parameter, from the one that a search has put it on.

        The search sees a base that has bent towards the effect: the plateau beside the true one may look better.
        """
        reference, features = self._reference(base, terms)

        def trial(params: Mapping[str, float], at: float) -> list[Term]:
            return [*terms[:-1], replace(terms[-1], params={**params, name: at})]

        def neighbours(here: Joint) -> list[Joint]:
            params = here.terms[-1].params

            def columns(at: float) -> Floats:
                return self._columns.one(trial(params, at), len(terms) - 1, reference, features)

            low, high = terms[-1].effect.bracket(name, params[name], self._context)
            places = beside(lambda a, b: np.array_equal(columns(a), columns(b)), params[name], low, high)
            return [self._fit(trial(params, at), base, rounds, search=False) for at in places]

        return downhill(found, neighbours, lambda joint: joint.base.coefficients.cost)

    def _fit(self, terms: list[Term], base: Coefficients, rounds: int, search: bool) -> Joint:
        """Fit terms from where they are, or from where a search has put the last one."""
        reference, features = self._reference(base, terms)
        if search:
            reference = self._sought.tables(terms[-1], reference)
            terms[-1] = replace(terms[-1], params=self._sought(terms, base, reference, features))
        anchors = [{n: t.effect.bracket(n, t.params[n], self._context) for n in t.refined} for t in terms]
        columns = self._columns(terms, reference, features)
        base = self._linear(terms, columns, base)
        terms = weighted(terms, columns, base.extra)
        best, since, in_vain = None, 0, 0
        for _ in range(rounds):
            reference, features = self._reference(base, terms)
            before, cost = terms, base.cost
            terms, columns, base = self._stepped(terms, base, reference, features, anchors, stay=in_vain >= IN_VAIN)
            stayed = all(new.params == old.params for new, old in zip(terms, before, strict=True))
            in_vain = in_vain + 1 if stayed else 0
            last = base, terms, reference, features, self._columns.forces
            best, since = (last, 0) if best is None or base.cost < best[0].cost else (best, since + 1)
            still = abs(base.cost - cost) < SETTLED_COST * cost
            if since == RISES or (still and largest_change(before, terms, anchors) < SETTLED):
                break
        if best is not None and base.cost > RUN_AWAY * best[0].cost:
            base, terms, reference, features, self._columns.forces = best
        return self._finished(base, terms, reference, features, anchors)

    def _reference(self, base: Coefficients, terms: Sequence[Term]) -> tuple[Reference, Features]:
        record = self._record
        fit = BaseFit.of(self._base(terms), base)
        reference = reference_of(fit, record, self._context.sign_velocity_m_s)
        features = with_running_force(record.features, reference)
        self._columns.settle(fit.fitted_N, terms, reference, features)
        return reference, features

    def _stepped(
        self,
        terms: list[Term],
        base: Coefficients,
        reference: Reference,
        features: Features,
        anchors: Sequence[Mapping[str, tuple[float, float]]],
        stay: bool,
    ) -> tuple[list[Term], list[Floats], Coefficients]:
        """Return terms, columns and base after one Gauss-Newton step of all refined parameters that descends.

        Parameters in which the columns jump stay where the search has put them, all of them if they are to `stay`.
        """
        columns = self._columns(terms, reference, features)
        here = self._linear(terms, columns, base)
        terms = weighted(terms, columns, here.extra)
        places = [(i, n) for i, t in enumerate(terms) for n in t.refined if not stay and n not in t.effect.steps]
        if not places:
            return terms, columns, here
        fit = BaseFit.of(self._base(terms), here)
        used = self._used
        slopes = [self._slope(terms, i, name, columns, fit, features, reference) for i, name in places]
        # What changes nothing here (a share of nothing) has a slope of rounding only.
        shown = [float(np.std(s)) > LEAST_SLOPE * self._problem.scale for s in slopes]
        places = [place for place, so in zip(places, shown, strict=True) if so]
        slopes = [slope for slope, so in zip(slopes, shown, strict=True) if so]
        if not places:
            return terms, columns, here
        parts = sum((c @ t.weights for c, t in zip(columns, terms, strict=True) if c.size), np.zeros(features.size))
        e = self._record.friction_N - fit.fitted_N - parts
        free = [c for c, t in zip(columns, terms, strict=True) if not t.effect.fixed_gain]
        norm, gram, right = normal_equations(fit.tangent, [*free, *(s[:, None] for s in slopes)], e, used)
        penalty = np.concatenate([fit.penalty, np.zeros(norm.size - fit.penalty.size)]) + 1e-9 * used.sum()
        delta = np.linalg.solve(gram + np.diag(penalty), right) / norm
        steps = delta[delta.size - len(places) :]
        for share in DAMPINGS:
            trial = list(terms)
            for (i, name), step in zip(places, steps, strict=True):
                value = float(np.clip(trial[i].params[name] + share * step, *anchors[i][name]))
                trial[i] = replace(trial[i], params=trial[i].params | {name: value})
            other = self._columns(trial, reference, features)
            there = self._linear(trial, other, here)
            if there.cost < here.cost:
                return weighted(trial, other, there.extra), other, there
        return terms, columns, here

    def _slope(
        self,
        terms: Sequence[Term],
        i: int,
        name: str,
        columns: Sequence[Floats],
        fit: BaseFit,
        features: Features,
        reference: Reference,
    ) -> Floats:
        """Return d force / d parameter, (n,), by a difference; `columns` are those of the terms as they are."""
        term = terms[i]
        low, high = term.effect.bracket(name, term.params[name], self._context)
        step = (JUMP_STEP if name in term.effect.steps else DERIVATIVE_STEP) * (high - low)
        if step <= 0.0:
            return np.zeros(features.size)
        params = term.params | {name: term.params[name] + step}
        trial = [*terms[:i], replace(term, params=params), *terms[i + 1 :]]
        if self._base.changed_by(term):
            moved = self._base.force(trial, fit.coefficients) - fit.fitted_N
            for j, one in enumerate(terms):
                if j != i and columns[j].size and moves(term, one):
                    moved = moved + (self._columns.one(trial, j, reference, features) - columns[j]) @ one.weights
            return np.asarray(moved / step)
        moved = self._columns.one(trial, i, reference, features)
        return np.asarray((moved - columns[i]) @ term.weights / step)

    def _finished(
        self,
        base: Coefficients,
        terms: Sequence[Term],
        reference: Reference,
        features: Features,
        anchors: Sequence[Mapping[str, tuple[float, float]]],
    ) -> Joint:
        """Assemble the result with the tangent of the whole model.

        A parameter that stands at an end of the bracket in which it was sought is held there. The fit would go on
        beyond it: what a step there saves, linearly, is nothing that the model can do.
        """
        record = self._record
        fit = BaseFit.of(self._base(terms), base)
        columns = self._columns(terms, reference, features)
        parts, residual = [], record.friction_N - fit.fitted_N
        for column, term in zip(columns, terms, strict=True):
            if self._base.changed_by(term):
                parts.append(fit.fitted_N - self._base.force([t for t in terms if t is not term], base))
            else:
                parts.append(column @ term.weights)
                residual = residual - parts[-1]
        beside, scales = list[Floats](), [np.ones(fit.tangent.shape[1])]
        held: list[Floats] = []
        ended = [np.zeros(fit.tangent.shape[1], np.bool_)]
        usual = LEAST_SLOPE * self._problem.scale
        for i, (term, column) in enumerate(zip(terms, columns, strict=True)):
            slopes = [] if term.effect.fixed_gain else [column]
            refined = [name for name in term.refined if term.params[name] != 0.0]
            slopes += [self._slope(terms, i, n, columns, fit, features, reference)[:, None] for n in refined]
            if not slopes:
                continue
            block = np.column_stack(slopes)
            norm = np.sqrt(np.mean(np.square(block), axis=0))
            shown = norm > usual
            # A parameter that changes nothing here (a step between two samples) is held where it is.
            beside.append(np.where(shown, block / np.where(shown, norm, 1.0), 0.0))
            scales.append(np.where(shown, 1.0 / np.where(shown, norm, 1.0), 0.0))
            ends = [False] * (norm.size - len(refined)) + [at_end(term.params[n], *anchors[i][n]) for n in refined]
            ended.append(shown & ends)
            held.append(np.where(shown & ~ended[-1], 0.0, HELD))
        penalty = np.concatenate([fit.penalty, *held])
        tangent = fit.tangent.beside_it(beside)
        # What is screened beside this model acts on the whole force before the sensor.
        inside = [
            p for p, t in zip(parts, terms, strict=True) if not self._base.changed_by(t) and t.effect.stage in FINE
        ]
        features = features.with_force(fit.fitted_N + sum(inside))
        steps, at_ends = np.concatenate(scales), np.concatenate(ended)
        return Joint(fit, tuple(terms), reference, features, tuple(parts), residual, tangent, penalty, steps, at_ends)


def cross_validated_loss(joint: Joint, record: Record, seed: int) -> Floats:
    """Return the error power of each block under coefficients fitted without it, (blocks,), N^2.

    The model is linear about its fit to everything; its refined parameters are among the coefficients.
    """
    return joint.evidence(record, seed).base_loss()
