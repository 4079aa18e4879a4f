"""What an effect is worth on samples that its fit never saw."""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.features import Context

FOLDS = 4


@dataclass(frozen=True)
class Gain:
    """Errors of two models on data that their fits never saw, over the standard deviation of the measured friction.

    Attributes
    ----------
    nrmse_before, nrmse_after : of the two. reduction_percent : of the error. low_percent, high_percent : its 95 %
        interval over blocks.
    """

    nrmse_before: float
    nrmse_after: float
    reduction_percent: float
    low_percent: float
    high_percent: float


def held_out_errors(problem: BaseProblem, context: Context, model: Joint) -> Floats:
    """Return the error of the model refitted without each fold's samples, on those samples, (n,), N.

    Everything is refitted, the nonlinear parameters too. Blocks of a fold are `FOLDS` apart.
    """
    record = problem.record
    error = np.zeros(record.used.size)
    blocks = np.arange(record.blocks)
    for number in range(FOLDS):
        test = blocks % FOLDS == number
        fit = JointFit(problem, context, ~test)
        start = model.coefficients if model.terms else None
        again = fit(model.terms, start, search=False)
        inside = test[record.block]
        error[inside] = again.residual_N[inside]
    return error


def rms(error: Floats, record: Record) -> float:
    """Return the rms over the samples that are used, N."""
    return float(np.sqrt(np.mean(np.square(error[record.used]))))


def gain_between(before: Floats, after: Floats, record: Record, spread: float, slow: bool = False) -> Gain:
    """Return the gain with its 95 % interval over blocks.

    Formula::

        sum before^2 - sum after^2 = sum d^2 + sum 2 d after,    d = before - after

    Of a cause that is a function of time (`slow`) d^2 lies in one part of the record by its nature: only the rest
    differs from block to block by chance.
    """
    one = _block_sums(np.square(before), record.block, record.used)
    other = _block_sums(np.square(after), record.block, record.used)
    varies = one - _block_sums(np.square(before - after), record.block, record.used) if slow else one
    count = float(record.used.sum())
    nrmse_before = float(np.sqrt(one.sum() / count)) / spread
    nrmse_after = float(np.sqrt(other.sum() / count)) / spread
    ratio = nrmse_after / max(nrmse_before, 1e-300)
    # d(sqrt(sum other / sum one)), block by block
    influence = ratio / 2.0 * (other / max(other.sum(), 1e-300) - varies / max(one.sum(), 1e-300))
    error = float(np.sqrt(np.square(influence - influence.mean()).sum() * one.size / max(one.size - 1, 1)))
    reach = 100.0 * float(stdtrit(max(one.size - 1, 1), 0.975)) * error
    reduction = 100.0 * (1.0 - ratio)
    return Gain(nrmse_before, nrmse_after, reduction, reduction - reach, reduction + reach)


def _block_sums(values: Floats, block: Ints, used: Bools) -> Floats:
    return np.asarray(np.bincount(block, weights=values * used), np.float64)
