"""One fit of base model and named effects: nonlinear parameters refined, or sought everywhere first."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base import BaseFit
from friction_estimator.diagnosis.base_problem import BaseProblem, Coefficients
from friction_estimator.diagnosis.evaluation import LEAST_SLOPE, Evaluation
from friction_estimator.diagnosis.joint import Anchors, Joint, Solution, Source
from friction_estimator.diagnosis.linear import LinearFit
from friction_estimator.diagnosis.own_columns import Term, largest_change, weighted
from friction_estimator.diagnosis.seek import beside, downhill
from friction_estimator.diagnosis.sought import Sought
from friction_estimator.diagnosis.tangent import normal_equations
from friction_estimator.diagnosis.term_columns import Made
from friction_estimator.effects.features import Context

ROUNDS = 14
SETTLED, SETTLED_COST = 1e-3, 2e-3
"""Most rounds of the joint fit, and the relative changes of its parameters and of its cost at which they end.

A column is made from tables of the base, and the base is fitted beside the column: a fixed point, whose cost still
falls by a tenth a round where a parameter moves by a thousandth of its bracket."""

RISES, RUN_AWAY = 4, 1.01
"""Rounds in a row without a lower cost after which a joint fit ends, and the cost over the lowest one from which that
round is taken instead: a fixed point may run away."""

LEVEL_MOVED = 0.02
"""Share by which the level that bristles carry may differ from that which their columns were made from."""

DAMPINGS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a Gauss-Newton step of the refined parameters that are tried, the first that descends is taken."""

IN_VAIN = 2
"""Rounds in a row in which no share of that step descends after which the refined parameters stay: 97 of 100 later
steps fail, too, the others gain less than 5e-4 of the cost. The rounds that follow settle the tables."""

MOVED = 0.05
"""Share of the logarithm of its bracket beyond which a parameter that is sought anew lies in another minimum."""


class Descent:
    """One fit under way: what it makes of the record, as large as that, is forgotten with it.

    Parameters
    ----------
    problem, context, rows : of `JointFit`.
    """

    def __init__(self, problem: BaseProblem, context: Context, rows: Bools | None) -> None:
        self._problem, self._context = problem, context
        self._record = problem.record
        self._used = self._record.used if rows is None else self._record.used & rows[self._record.block]
        self._evaluation = Evaluation(problem, context)
        self._base, self._columns = self._evaluation.base, self._evaluation.columns
        self._linear = LinearFit(self._base, rows)
        self._sought = Sought(self._base, self._columns, context, rows)

    def __call__(self, terms: Sequence[Term], start: Joint, rounds: int, search: bool) -> Solution:
        """Fit; see `JointFit.__call__`."""
        found = self._fit(terms, start, rounds, search)
        last = terms[-1].effect
        steps = [name for name in last.refined if name in last.steps and last.fixed_gain]
        return self._walked(found, terms, steps[0], start, rounds) if search and steps else found

    def elsewhere(self, terms: Sequence[Term], start: Coefficients) -> bool:
        """Return whether a search ends elsewhere; see `JointFit.elsewhere`."""
        term = terms[-1]
        found = self._sought(terms, start, *self._evaluation.tables(self._begun(terms, start, search=True)))
        for name in term.refined:
            here, there = term.params[name], found[name]
            low, high = term.effect.bracket(name, here, self._context)
            if here != there and (name in term.effect.steps or abs(np.log(there / here)) > MOVED * np.log(high / low)):
                return True
        return False

    def _walked(self, found: Solution, terms: Sequence[Term], name: str, start: Joint, rounds: int) -> Solution:
        """Return the fit on the best plateau of a jumping parameter, from the one that a search has put it on.

        The search sees a base that has bent towards the effect: the plateau beside the true one may look better.
        """
        reference, features = self._evaluation.tables((start.coefficients, tuple(terms)))

        def trial(params: Mapping[str, float], at: float) -> list[Term]:
            return [*terms[:-1], replace(terms[-1], params={**params, name: at})]

        def neighbours(here: Solution) -> list[Solution]:
            params = here.terms[-1].params

            def columns(at: float) -> Floats:
                return self._columns.one(trial(params, at), len(terms) - 1, reference, features)

            low, high = terms[-1].effect.bracket(name, params[name], self._context)
            places = beside(lambda a, b: np.array_equal(columns(a), columns(b)), params[name], low, high)
            return [self._fit(trial(params, at), start, rounds, search=False) for at in places]

        return downhill(found, neighbours, lambda one: one.coefficients.cost)

    def _fit(self, terms: Sequence[Term], start: Joint, rounds: int, search: bool) -> Solution:
        """Fit terms from where they are, or from where a search has put the last one."""
        terms, base = list(terms), start.coefficients
        source = self._begun(terms, base, search)
        reference, features = self._evaluation.tables(source)
        if search:
            terms[-1] = replace(terms[-1], params=self._sought(terms, base, reference, features))
        anchors = tuple({n: t.effect.bracket(n, t.params[n], self._context) for n in t.refined} for t in terms)
        made = self._columns(terms, reference, features)
        base = self._linear(terms, made, base)
        last = Solution(base, tuple(weighted(terms, made.columns, base.extra)), source, anchors)
        del made, reference, features  # as large as those of each round
        best, since, in_vain = last, 0, 0
        rank = lowest = (True, np.inf)
        for _ in range(rounds):
            before = last
            last = self._stepped((before.coefficients, self._on_level(before)), anchors, stay=in_vain >= IN_VAIN)
            stayed = all(new.params == old.params for new, old in zip(last.terms, before.terms, strict=True))
            in_vain = in_vain + 1 if stayed else 0
            cost, was = last.coefficients.cost, before.coefficients.cost
            rank = self._rank(last)
            best, lowest, since = (last, rank, 0) if rank < lowest else (best, lowest, since + 1)
            moved = largest_change(before.terms, last.terms, anchors)
            if since == RISES or (abs(cost - was) < SETTLED_COST * was and moved < SETTLED):
                break
        off, cost = lowest
        return best if rank > (off, RUN_AWAY * cost) else last

    def _begun(self, terms: Sequence[Term], base: Coefficients, search: bool) -> Source:
        """Return what the first tables are made from: base and terms, or the theory alone where bristles are new.

        The base has bent towards what they lack, most at low speed: the level that they carry is another one.
        """
        sought = terms[-1] if search else None
        new = [t for t in terms if t is sought or not t.weights.size]
        carries = any(t.effect.carries(t.params) for t in new)
        return (self._problem.theory_alone(base) if carries else base), tuple(terms)

    def _rank(self, found: Solution) -> tuple[bool, float]:
        """Return a round's place among others: first those whose bristles carry the level of the curve beside them.

        What another round costs is that of columns made from a level that the fit has left.
        """
        moved = abs(self._level_moved(found) - 1.0) > LEVEL_MOVED
        return moved, found.coefficients.cost

    def _level_moved(self, found: Solution) -> float:
        """Return the level at rest over that which the columns of bristles were made from; 1 without bristles."""
        if not any(t.effect.carries(t.params) for t in found.terms):
            return 1.0
        now, then = (abs(self._base.level_at_rest_N(one)) for one in (found.coefficients, found.source[0]))
        return now / then if then > 0.0 and now > 0.0 else 1.0

    def _on_level(self, found: Solution) -> tuple[Term, ...]:
        """Return the terms with coefficients that make of the model's own tables what they made of its source's.

        Those of bristles are forces at the level at rest.
        """
        ratio = self._level_moved(found)
        return tuple(replace(t, weights=ratio * t.weights) if t.effect.carries(t.params) else t for t in found.terms)

    def _stepped(self, source: Source, anchors: Anchors, stay: bool) -> Solution:
        """Return a model after one Gauss-Newton step of all refined parameters that descends.

        Parameters in which the columns jump stay where the search has put them, all of them if they are to `stay`.
        """
        base, terms = source[0], list(source[1])
        reference, features = self._evaluation.tables(source)
        made = self._columns(terms, reference, features)
        here = self._linear(terms, made, base)
        terms = weighted(terms, made.columns, here.extra)
        still = Solution(here, tuple(terms), source, anchors)
        places = [(i, n) for i, t in enumerate(terms) for n in t.refined if not stay and n not in t.effect.steps]
        steps = self._steps(still, made, places) if places else {}
        if not steps:
            return still
        del made  # as large as what is made of a trial
        for share in DAMPINGS:
            trial = list(terms)
            for (i, name), step in steps.items():
                value = float(np.clip(trial[i].params[name] + share * step, *anchors[i][name]))
                trial[i] = replace(trial[i], params=trial[i].params | {name: value})
            other = self._columns(trial, reference, features)
            there = self._linear(trial, other, here)
            if there.cost < here.cost:
                return Solution(there, tuple(weighted(trial, other.columns, there.extra)), source, anchors)
        return still

    def _steps(self, here: Solution, made: Made, places: Sequence[tuple[int, str]]) -> dict[tuple[int, str], float]:
        """Return the undamped steps of some refined parameters, of those that change anything.

        Parameters
        ----------
        here : the model. made : of its terms. places : number of the term and name of each parameter.
        """
        terms, columns, used = here.terms, made.columns, self._used
        reference, features = self._evaluation.tables(here.source)
        fit = BaseFit.of(self._base(terms), here.coefficients)
        slopes = [self._evaluation.slope(terms, i, name, columns, fit, features, reference) for i, name in places]
        # What changes nothing here (a share of nothing) has a slope of rounding only.
        shown = [float(np.std(s)) > LEAST_SLOPE * self._problem.scale for s in slopes]
        places = [place for place, so in zip(places, shown, strict=True) if so]
        slopes = [slope for slope, so in zip(slopes, shown, strict=True) if so]
        if not places:
            return {}
        parts = sum((c @ t.weights for c, t in zip(columns, terms, strict=True) if c.size), np.zeros(features.size))
        e = self._record.friction_N - fit.fitted_N - parts
        tangent = fit.tangent.with_carried(made.carried)
        if made.carried is not None:
            e = e - made.carried.changed(here.coefficients.weights, here.coefficients.taps)
        free = [c[:, ~t.held] for c, t in zip(columns, terms, strict=True) if not t.effect.fixed_gain]
        norm, gram, right = normal_equations(tangent, [*free, *(s[:, None] for s in slopes)], e, used)
        penalty = np.concatenate([fit.penalty, np.zeros(norm.size - fit.penalty.size)]) + 1e-9 * used.sum()
        delta = np.linalg.solve(gram + np.diag(penalty), right) / norm
        return dict(zip(places, delta[delta.size - len(places) :].tolist(), strict=True))
