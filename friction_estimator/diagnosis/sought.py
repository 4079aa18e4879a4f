"""Where a joint fit begins: the last term's refined parameters, sought over their whole brackets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Bools
from friction_estimator.diagnosis.base import BaseFit
from friction_estimator.diagnosis.base_problem import Coefficients
from friction_estimator.diagnosis.linear import LinearFit, most_negative
from friction_estimator.diagnosis.own_columns import OwnColumns, Term
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.seek import best_time, over_bends, over_jumps
from friction_estimator.diagnosis.tangent import chosen_rows
from friction_estimator.diagnosis.term_columns import TermColumns
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.grids import longest_time_s
from friction_estimator.effects.reference import Reference


class Sought:
    """Seeks the refined parameters of the last of some terms.

    Parameters
    ----------
    base : the problem with its own columns changed by terms. columns : of terms. context : facts about the record.
    rows : (blocks,) bool, those that are fitted (default all).
    """

    def __init__(self, base: OwnColumns, columns: TermColumns, context: Context, rows: Bools | None) -> None:
        self._base, self._columns, self._context, self._rows = base, columns, context, rows

    def __call__(
        self, terms: Sequence[Term], base: Coefficients, reference: Reference, features: Features
    ) -> dict[str, float]:
        """Return the last term's parameters with the refined ones where a search over their brackets ends."""
        if not terms[-1].refined:
            return dict(terms[-1].params)
        looked = self._scanned if self._base.changed_by(terms[-1]) else self._searched
        return looked(terms, base, reference, features)

    def _scan(self) -> LinearFit:
        """Return a fit of every other block: enough to look for a time, which the steps that follow settle."""
        blocks = self._base.problem.products.edges.size - 1
        rows = np.ones(blocks, np.bool_) if self._rows is None else self._rows.copy()
        rows[1 - int(rows[0]) :: 2] = False
        self._base.forget()  # whatever is found, the next problem is another one
        return LinearFit(self._base.on(rows), rows)

    def _scanned(
        self, terms: Sequence[Term], base: Coefficients, reference: Reference, features: Features
    ) -> dict[str, float]:
        """Return the parameters of what changes the base's own columns at which everything else fits best.

        Where a share of something is refined, too, all of it is tried at the points of the effect's grid far from
        the bracket: without it another minimum may look better to the screening, and no step leads from there to here.
        """
        effect, params = terms[-1].effect, dict(terms[-1].params)
        name, scan = effect.refined[0], self._scan()

        def at(place: dict[str, float]) -> Coefficients:
            trial = [*terms[:-1], replace(terms[-1], params=params | place)]
            return scan(trial, self._columns(trial, reference, features), base)

        def fitted(value: float) -> Coefficients:
            return at({name: value})

        if effect.delays:
            ahead, longest = effect.late_s({name: 1.0}) < 0.0, longest_time_s(self._context)
            memory, step = self._base.problem.mean_delay, self._context.step_s
            return params | {name: best_time(fitted, base, memory, step, ahead, longest, params[name])}
        low, high = effect.bracket(name, params[name], self._context)
        best = {name: over_bends(lambda v: fitted(v).cost, low, high)}
        if not effect.shares:
            return params | best
        everything, width = dict.fromkeys(effect.shares, 1.0), high / low
        values = [point[name] for point in effect.grid(self._context)]
        far = [{name: v} | everything for v in values if not low / width <= v <= high * width]
        return params | min([best, *far], key=lambda place: at(place).cost)

    def _searched(
        self, terms: Sequence[Term], base: Coefficients, reference: Reference, features: Features
    ) -> dict[str, float]:
        """Return the last term's parameters with the refined ones at their best over their brackets, one by one.

        Base and other effects are projected out in their tangent.
        """
        record = self._base.problem.record
        used = record.used if self._rows is None else record.used & self._rows[record.block]
        fit = BaseFit.of(self._base(terms), base)
        made = self._columns(terms[:-1], reference, features)
        others = made.columns
        alone = [t for t in terms[:-1] if not self._base.changed_by(t)]
        fixed = [c[:, 0] for c, t in zip(others, terms, strict=False) if t in alone and t.effect.fixed_gain]
        free = [c for c, t in zip(others, terms, strict=False) if t in alone and not t.effect.fixed_gain]
        e = (record.friction_N - fit.fitted_N - (np.sum(fixed, axis=0) if fixed else 0.0))[used]
        z = chosen_rows(fit.tangent.with_carried(made.carried), free, used)
        del made, others, free, fixed  # z has them
        z /= np.maximum(np.sqrt(np.einsum("nq,nq->q", z, z) / len(z)), 1e-300)
        penalty = np.concatenate([fit.penalty, np.zeros(z.shape[1] - fit.penalty.size)]) + 1e-9 * len(z)
        inverse = np.linalg.inv(inner(z, z) + np.diag(penalty))
        ze = inner(z, e)
        effect, params, one_sided = terms[-1].effect, dict(terms[-1].params), terms[-1].one_sided

        def loss(name: str, value: float) -> float:
            trial = [*terms[:-1], replace(terms[-1], params=params | {name: value})]
            x = self._columns.one(trial, len(trial) - 1, reference, features)[used]
            zx, xx = inner(z, x), inner(x, x)
            left = xx - zx.T @ inverse @ zx
            pull = inner(x, e) - zx.T @ inverse @ ze
            if effect.fixed_gain:
                return float(left[0, 0] - 2.0 * pull[0])
            left = left + np.diag(1e-9 * np.maximum(np.diag(xx), 1e-300))
            free, sizes = np.ones(pull.size, np.bool_), np.sqrt(np.maximum(np.diag(left), 0.0))
            found = np.asarray(np.linalg.solve(left, pull), np.float64)
            while (worst := most_negative(found * sizes, one_sided)) is not None:
                free[worst] = False
                found = np.zeros(free.size)
                found[free] = np.linalg.solve(left[np.ix_(free, free)], pull[free])
            return -float(pull @ found)

        for name in terms[-1].refined:
            if name in effect.shares:
                continue
            low, high = effect.bracket(name, params[name], self._context)
            seek = over_jumps if name in effect.steps else over_bends
            params[name] = seek(lambda v, n=name: loss(n, v), low, high)  # type: ignore[misc]
        return params
