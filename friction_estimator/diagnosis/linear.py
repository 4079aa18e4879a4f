"""The part of a joint fit that is linear: base and coefficients for columns that are given."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base_problem import BaseProblem, Coefficients
from friction_estimator.diagnosis.lagged import Extra
from friction_estimator.diagnosis.own_columns import OwnColumns, Term
from friction_estimator.diagnosis.term_columns import Made


class LinearFit:
    """Fits the base, changed by some terms, and the coefficients of the others.

    Parameters
    ----------
    base : the problem with its own columns changed by terms. rows : (blocks,) bool, those that are
        fitted (default all).
    """

    def __init__(self, base: OwnColumns, rows: Bools | None) -> None:
        self._base, self._rows = base, rows

    def __call__(self, terms: Sequence[Term], made: Made, start: Coefficients) -> Coefficients:
        """Fit terms whose columns are given, from an earlier fit.

        What bristles carry changes with the base's static curve: each of its columns has that with it, and what they
        carry of the curve as it was is taken off.
        """
        problem = self._base(terms)
        starts = [start]
        if problem is not self._base.problem:
            starts.append(replace(start, taps=np.zeros(start.taps.size)))
        beside = [(c, t) for c, t in zip(made.columns, terms, strict=True) if not self._base.changed_by(t)]
        free = [c for c, t in beside if not t.effect.fixed_gain]
        fixed = [c[:, 0] for c, t in beside if t.effect.fixed_gain]
        tied = []
        if made.carried is not None:
            tied = [made.carried.change]
            fixed.append(-made.carried.force_N)
        settled = [np.sum(fixed, axis=0)[:, None]] if fixed else []
        columns, joined, still = [*tied, *free, *settled], None, None
        if columns:
            found = problem.products.extra(columns)
            if tied:
                problem, found = problem.tied(found)
            width = sum(c.shape[1] for c in free)
            joined, still = found[:width] if free else None, found[width:] if settled else None
            if joined is not None:
                joined = replace(joined, known=self._known(beside))
            if joined is not None and still is not None:
                joined = replace(joined, xy=joined.xy - found.xx[:, :width, width])
        if joined is None:
            return problem.fit(joined, still, self._rows, starts)
        one_sided = np.concatenate([t.one_sided for _, t in beside if not t.effect.fixed_gain])
        return self._one_sided(problem, joined, still, starts, one_sided)

    def _known(self, beside: Sequence[tuple[Floats, Term]]) -> Floats:
        """Return what is known before of the free coefficients of some columns, (c,)."""
        scale = self._base.problem.scale
        return np.concatenate([t.known(c, scale) for c, t in beside if not t.effect.fixed_gain])

    def _one_sided(
        self,
        problem: BaseProblem,
        joined: Extra,
        settled: Extra | None,
        starts: Sequence[Coefficients],
        one_sided: Bools,
    ) -> Coefficients:
        """Fit with those free coefficients held at zero that cannot be negative, (c,) bool, and would be."""
        found = problem.fit(joined, settled, self._rows, starts)
        sizes = np.sqrt(np.einsum("bcc->c", joined.xx))
        free = np.ones(one_sided.size, np.bool_)
        while (worst := most_negative(found.extra * sizes, one_sided)) is not None:
            free[worst] = False
            fewer = problem.fit(joined[free], settled, self._rows, [found])
            extra = np.zeros(free.size)
            extra[free] = fewer.extra
            found = replace(fewer, extra=extra)
        return found


def most_negative(forces: Floats, one_sided: Bools) -> int | None:
    """Return the place of the most negative of the forces (c,) that cannot be negative, or None where none is.

    Held at zero one after the other, they are an active set that only grows: Lawson and Hanson, Solving Least Squares
    Problems, 1974, chapter 23, without the return of one that was held.

    >>> most_negative(np.array([-1.0, -3.0, -5.0]), np.array([True, True, False]))
    1
    >>> most_negative(np.array([0.0, 2.0, -5.0]), np.array([True, True, False])) is None
    True
    """
    below = np.where(one_sided, forces, 0.0)
    worst = int(np.argmin(below))
    return worst if below[worst] < 0.0 else None
