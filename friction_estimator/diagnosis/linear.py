"""The part of a joint fit that is linear: base and coefficients for columns that are given."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Bools
from friction_estimator.diagnosis.base_problem import Coefficients
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
            if joined is not None and still is not None:
                joined = replace(joined, xy=joined.xy - found.xx[:, :width, width])
        return problem.fit(joined, still, self._rows, starts)
