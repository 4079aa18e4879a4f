"""What a solution of a joint fit is on its record: tables, forces, residual, tangent."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.sums import parts
from friction_estimator.diagnosis.base import BaseFit, reference_of
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.joint import Evaluated, Solution, Source
from friction_estimator.diagnosis.library import with_running_force
from friction_estimator.diagnosis.own_columns import OwnColumns, Term, moves
from friction_estimator.diagnosis.seek import at_end
from friction_estimator.diagnosis.term_columns import TermColumns
from friction_estimator.effects.compose import FINE
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

DERIVATIVE_STEP = 1e-3
"""Step of a refined parameter in numerical derivatives, as a share of the bracket in which it is sought."""

JUMP_STEP = 4e-3
"""The same for a parameter in which the columns jump: at least a sample must move."""

LEAST_SLOPE = 1e-11
"""Share of the rms of friction below which a column of the tangent is rounding: its parameter stays where it is."""

HELD = 1e12
"""Penalty of a tangent coefficient that must stay zero."""


class Evaluation:
    """Evaluates solutions on one record.

    Parameters
    ----------
    problem : the base model on the record. context : facts about it.

    Attributes
    ----------
    base : the problem with its own columns changed by terms. columns : of terms. They keep what they made last.
    """

    def __init__(self, problem: BaseProblem, context: Context) -> None:
        self._context, self._record = context, problem.record
        self.base = OwnColumns(problem, context)
        self.columns = TermColumns(self.base)
        self._tables: tuple[Source, tuple[Reference, Features]] | None = None

    def tables(self, source: Source) -> tuple[Reference, Features]:
        """Return tables made from a model, and features with its running force; the last ones made are kept.

        The columns of terms take the forces that run at their stages from the same model.
        """
        if self._tables is None or self._tables[0] is not source:
            self._tables = None  # and with them what was made of their features: both at once are not needed
            coefficients, terms = source
            fit = BaseFit.of(self.base(terms), coefficients)
            reference = reference_of(fit, self._context.sign_velocity_m_s)
            features = with_running_force(self._record.features, reference)
            self.columns.settle(fit.fitted_N, terms, reference, features)
            self._tables = source, (reference, features)
        return self._tables[1]

    def slope(
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
        if self.base.changed_by(term):
            moved = self.base.force(trial, fit.coefficients) - fit.fitted_N
            for j, one in enumerate(terms):
                if j != i and columns[j].size and moves(term, one):
                    moved = moved + (self.columns.one(trial, j, reference, features) - columns[j]) @ one.weights
            return np.asarray(moved / step)
        moved = self.columns.one(trial, i, reference, features)
        return np.asarray((moved - columns[i]) @ term.weights / step)

    def __call__(self, solution: Solution) -> Evaluated:
        """Return what a solution is on the record, with the tangent of the whole model.

        A parameter that stands at an end of the bracket in which it was sought is held there, and so is a coefficient
        that cannot be negative at zero. The fit would go on beyond it: what a step there saves, linearly, is nothing
        that the model can do.
        """
        coefficients, terms, anchors = solution.coefficients, solution.terms, solution.anchors
        reference, features = self.tables(solution.source)
        record = self._record
        fit = BaseFit.of(self.base(terms), coefficients)
        made = self.columns(terms, reference, features)
        columns = made.columns
        forces, residual = [], record.friction_N - fit.fitted_N
        for column, term in zip(columns, terms, strict=True):
            if self.base.changed_by(term):
                forces.append(fit.fitted_N - self.base.force([t for t in terms if t is not term], coefficients))
            else:
                forces.append(column @ term.weights)
                residual = residual - forces[-1]
        beside, scales = list[Floats](), [np.ones(fit.tangent.shape[1])]
        held: list[Floats] = []
        ended = [np.zeros(fit.tangent.shape[1], np.bool_)]
        usual = LEAST_SLOPE * self.base.problem.scale
        for i, (term, column) in enumerate(zip(terms, columns, strict=True)):
            slopes = [] if term.effect.fixed_gain else [column]
            refined = [name for name in term.refined if term.params[name] != 0.0]
            slopes += [self.slope(terms, i, n, columns, fit, features, reference)[:, None] for n in refined]
            if not slopes:
                continue
            block = np.column_stack(slopes)
            norm = np.sqrt(sum(np.square(block[part]).sum(axis=0) for part in parts(len(block))) / len(block))
            shown = norm > usual
            # A parameter that changes nothing here (a step between two samples) is held where it is.
            block /= np.where(shown, norm, 1.0)
            block[:, ~shown] = 0.0
            beside.append(block)
            scales.append(np.where(shown, 1.0 / np.where(shown, norm, 1.0), 0.0))
            ends = [] if term.effect.fixed_gain else term.held.tolist()
            ends += [at_end(term.params[n], *anchors[i][n]) for n in refined]
            ended.append(shown & ends)
            known = np.zeros(norm.size)  # nothing of what is refined, nor of a fixed gain
            known[: column.shape[1]] = term.known(column, self.base.problem.scale)
            ridge = coefficients.power / coefficients.count * known / np.square(np.where(shown, norm, 1.0))
            held.append(np.where(shown & ~ended[-1], ridge, HELD))
        penalty = np.concatenate([fit.penalty, *held])
        tangent = fit.tangent.with_carried(made.carried).beside_it(beside)
        # What is screened beside this model acts on the whole force before the sensor.
        inside = [
            p for p, t in zip(forces, terms, strict=True) if not self.base.changed_by(t) and t.effect.stage in FINE
        ]
        features = features.with_force(fit.fitted_N + sum(inside))
        steps, at_ends = np.concatenate(scales), np.concatenate(ended)
        return Evaluated(fit, reference, features, tuple(forces), residual, tangent, penalty, steps, at_ends)
