"""Base model and named effects fitted together to a record, or to a part of it."""

from collections.abc import Sequence

from friction_estimator.core.sample import Bools
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.descent import ROUNDS, Descent
from friction_estimator.diagnosis.evaluation import Evaluation
from friction_estimator.diagnosis.joint import Evaluated, Joint, Solution
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.effects.features import Context

KEPT_BYTES, BYTES_A_SAMPLE = 64 << 20, 430
"""Of what is made of fits on the record, the latest are kept: this much in all, one at least, of what a fit is measured
to have a sample. A diagnosis of 35,000 samples evaluates 109 fits where one is kept, 88 where two are, 60 with 17."""


def most_kept(samples: int) -> int:
    """Return how many evaluated fits are kept, for a record of so many samples.

    >>> most_kept(25_600), most_kept(400_000)
    (6, 1)
    """
    return max(1, KEPT_BYTES // (BYTES_A_SAMPLE * samples))


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
        self._evaluated = _Latest(problem, context)

    def __call__(
        self, terms: Sequence[Term] = (), start: Joint | None = None, rounds: int = ROUNDS, search: bool = True
    ) -> Joint:
        """Fit.

        Parameters
        ----------
        terms : effects with their parameters to start from. start : an earlier fit of the base alone or with others;
            the base alone is fitted from the beginning.
        rounds : most rounds. search : look for the last term's refined parameters over their whole bracket first.
        """
        if start is None or not terms:
            base = self._problem.fit(rows=self._rows)
            start = Joint(Solution(base, (), (base, ()), ()), self._evaluated)
        return Joint(self._descent()(terms, start, rounds, search), self._evaluated) if terms else start

    def without(self, joint: Joint, i: int) -> Joint:
        """Return a fit without one of its terms, the others refined from where they are."""
        terms = [term for k, term in enumerate(joint.terms) if k != i]
        return self(terms, joint, search=False)

    def elsewhere(self, terms: Sequence[Term], start: Joint) -> bool:
        """Return whether a search for the last term's refined parameters ends elsewhere than where they are."""
        return self._descent().elsewhere(terms, start.coefficients)

    def _descent(self) -> Descent:
        return Descent(self._problem, self._context, self._rows)


class _Latest:
    """What the latest fits are on the record; the oldest goes before another is made: both at once are too large."""

    def __init__(self, problem: BaseProblem, context: Context) -> None:
        self._problem, self._context = problem, context
        self._most = most_kept(problem.record.used.size)
        self._kept: dict[Solution, Evaluated] = {}

    def __call__(self, solution: Solution) -> Evaluated:
        """Return what a solution is on the record."""
        found = self._kept.pop(solution, None)
        if found is None:
            while len(self._kept) >= self._most:
                del self._kept[next(iter(self._kept))]
            found = Evaluation(self._problem, self._context)(solution)
        self._kept[solution] = found  # the latest is the last
        return found
