"""What an effect is worth on samples that its fit never saw."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import REVERSAL, SLOW, Effect
from friction_estimator.effects.features import Context

FOLDS = 4

FEWEST = 4
"""Blocks beside the best one that must say for themselves that an effect gains."""

AS_FAST = 0.1
"""Of the rms speed of a block: what another may be slower or faster by and still be driven as it is."""


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
        start = model if model.terms else None
        again = fit(model.terms, start, search=False)
        inside = test[record.block]
        error[inside] = again.residual_N[inside]
    return error


def rms(error: Floats, record: Record) -> float:
    """Return the rms over the samples that are used, N."""
    return float(np.sqrt(np.mean(np.square(error[record.used]))))


def gain_between(before: Floats, after: Floats, record: Record, spread: float, effects: Sequence[type[Effect]]) -> Gain:
    """Return the gain by an effect, or by several together, with its 95 % interval over blocks.

    What acts at reversals gains where the drive has them: one block in which it is another for a moment may hold most
    of a gain, and make what is the same in all others look like chance. So the lower end is at least that of a gain
    that is nothing in the best block.
    """
    one, other = (block_sums(np.square(error), record) for error in (before, after))
    count = float(record.used.sum())
    nrmse_before = float(np.sqrt(one.sum() / count)) / spread
    nrmse_after = float(np.sqrt(other.sum() / count)) / spread
    quantile = float(stdtrit(max(one.size - 1, 1), 0.975))
    ratio, error = _ratio(one, other)
    chance = chance_alone(effects, before - after, after, record)
    if chance is not None:
        error = min(error, error_of_sum(ratio / 2.0 * chance / max(one.sum(), 1e-300)))
    low, high = 1.0 - ratio - quantile * error, 1.0 - ratio + quantile * error
    if all(effect.acts == REVERSAL for effect in effects):
        rest, best = other.copy(), int(np.argmax(one - other))
        rest[best] = max(one[best], other[best])
        most, error = _ratio(one, rest)
        low = max(low, 1.0 - most - quantile * error)
    return Gain(nrmse_before, nrmse_after, 100.0 * (1.0 - ratio), 100.0 * low, 100.0 * high)


def _ratio(one: Floats, other: Floats) -> tuple[float, float]:
    """Return r = sqrt(sum other / sum one) of error powers (blocks,), and its standard error over blocks."""
    ratio = float(np.sqrt(other.sum() / max(one.sum(), 1e-300)))
    parts = other / max(other.sum(), 1e-300) - one / max(one.sum(), 1e-300)
    return ratio, error_of_sum(ratio / 2.0 * parts)


def gains_beyond_chance(
    before: Floats, after: Floats, record: Record, counted: Bools, effect: type[Effect], but_best: bool = False
) -> bool:
    """Return whether the squared error falls by more than its error from block to block, of the samples counted.

    In all blocks; or, where that will do, in all `but_best` (`gain_between`).
    """
    change = np.where(counted, before - after, 0.0)
    gains = block_sums(change * (before + after), record)
    error = error_of_sum(gains)
    chance = chance_alone([effect], change, after, record)
    if chance is not None:
        error = min(error, error_of_sum(chance))
    if gains.sum() > stdtrit(gains.size - 1, 0.975) * error:
        return True
    others = np.delete(gains, np.argmax(gains))
    if not but_best or others.size < FEWEST:
        return False
    return bool(others.sum() > stdtrit(others.size - 1, 0.975) * error_of_sum(others))


def chance_alone(effects: Sequence[type[Effect]], change: Floats, after: Floats, record: Record) -> Floats | None:
    """Return what is chance in the gain of effects that all act in one part of the record, (blocks,), else None.

    Formula::

        sum before^2 - sum after^2 = sum d^2 + sum 2 d after,    d = before - after

    A function of time acts in one part by its nature: of d^2 nothing is chance, if the drive is there what it is
    elsewhere, too. Else what the model gets wrong of that drive looks the same, and the whole gain must be alike from
    block to block, as that of any other cause. Where that is the lesser error it counts for both.
    """
    if any(effect.acts != SLOW for effect in effects) or not alike_elsewhere(change, record):
        return None
    return block_sums(2.0 * change * after, record)


def error_of_sum(parts: Floats) -> float:
    """Return the standard error of a sum over blocks."""
    return float(np.sqrt(np.square(parts - parts.mean()).sum() * parts.size / max(parts.size - 1, 1)))


def alike_elsewhere(change: Floats, record: Record) -> bool:
    """Return whether the drive is as fast elsewhere as where a change (n,) is large, by the rms speed of blocks.

    Large is what lies above the mean power; half of that at least must be where other blocks are as slow and as fast.
    """
    power = block_sums(np.square(change), record)
    count = np.maximum(block_sums(np.ones(change.size), record), 1.0)
    speed = np.sqrt(block_sums(np.square(record.features.velocity_m_s), record) / count)
    large = power / count > power.sum() / count.sum()
    if large.all() or not large.any():
        return True
    low, high = (1.0 - AS_FAST) * speed[~large].min(), (1.0 + AS_FAST) * speed[~large].max()
    known = large & (speed >= low) & (speed <= high)
    return bool(power[known].sum() >= 0.5 * power[large].sum())


def block_sums(values: Floats, record: Record) -> Floats:
    """Return sums over the used samples of each block, (blocks,)."""
    return np.asarray(np.bincount(record.block, weights=values * record.used, minlength=record.blocks), np.float64)
