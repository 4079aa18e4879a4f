"""The part of a joint fit that is linear: base and coefficients for columns that are given."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base_problem import Coefficients
from friction_estimator.diagnosis.lagged import Extra
from friction_estimator.diagnosis.own_columns import OwnColumns, Term


class LinearFit:
    """Fits the base, changed by some terms, and the coefficients of the others.

    Parameters
    ----------
    base : the problem with its own columns changed by terms. rows : (blocks,) bool, those that are
        fitted (default all).
    """

    def __init__(self, base: OwnColumns, rows: Bools | None) -> None:
        self._base, self._rows = base, rows

    def __call__(self, terms: Sequence[Term], columns: Sequence[Floats], start: Coefficients) -> Coefficients:
        """Fit terms whose columns, (n, c) each, are given, from an earlier fit."""
        problem = self._base(terms)
        products = problem.products
        beside = [(c, t) for c, t in zip(columns, terms, strict=True) if not self._base.changed_by(t)]
        fixed = [c[:, 0] for c, t in beside if t.effect.fixed_gain]
        free = [c for c, t in beside if not t.effect.fixed_gain]
        settled = np.sum(fixed, axis=0)[:, None] if fixed else None
        starts = [start]
        if problem is not self._base.problem:
            starts.append(replace(start, taps=np.zeros(start.taps.size)))
        if settled is None or not free:
            joined = products.extra(free) if free else None
            still = None if settled is None else products.extra([settled])
            return problem.fit(joined, still, self._rows, starts)
        whole = products.extra([*free, settled])
        c = whole.xx.shape[1] - 1
        joined = Extra(whole.mx[:, :, :c], whole.xx[:, :c, :c], whole.xy[:, :c] - whole.xx[:, :c, c])
        still = Extra(whole.mx[:, :, c:], whole.xx[:, c:, c:], whole.xy[:, c:])
        return problem.fit(joined, still, self._rows, starts)
