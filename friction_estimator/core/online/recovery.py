"""Compiled: what happens when the errors say that the last samples were not friction, or that friction has changed.

While all is calm the model is kept aside every `SPACING` samples. Errors far beyond what the band takes to be usual
where they occur, several together, raise an alarm (a one-sided CUSUM of e^2 over that variance; Page 1954). From
then on three models run beside each other over the same samples:

    held        the model as it was kept before the alarm: it predicts, and learns nothing
    challenger  the same parameters, covariance set back to the prior: it learns what comes
    former      the model that the last change replaced, if there was one

and the samples decide. Errors are compared by bins of velocity, so that what was found bad at some velocities is
settled only when these are visited again:

    held is good again           the data were bad: learning goes on from it as if they had not been
    challenger is good, held not friction has changed: the challenger goes on, held becomes the former model
    former is good, held not     what was taken for a change is over: it changes places with held
    none for long                the errors themselves have become larger: held goes on with these as usual
"""

from dataclasses import dataclass

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.fit.band import usual_variance
from friction_estimator.core.model.prediction import regress
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import workspace as at
from friction_estimator.core.sample import Floats

DRIFT, THRESHOLD, LARGEST = 8.0, 300.0, 64.0
"""Of the alarm: a squared error over its usual variance adds itself, `LARGEST` at the most, less `DRIFT` to the sum;
above `THRESHOLD` the alarm is raised. Six errors in a row of eight standard deviations do it, one alone does not."""

SLOW_DRIFT, SLOW_THRESHOLD, SLOW_CALM = 2.5, 600.0, 60.0
"""Of a second sum, in which one error counts for `MOST` at the most: a change that is small beside the noise, or at
some velocities only, shows in some hundred samples. No model is kept while it is above the last of these."""

FLOOR = 0.01
"""Share of the prior's residual variance that is usual anywhere: errors of a hundredth of the friction are no alarm."""

MISFIT_SHARE = 1.0
"""Share of the mean power of known errors that is usual anywhere: a misfit moves to other velocities with the drive."""

SPACING = 256
"""Samples learned from between two models that are kept; the older of two is gone back to."""

CALM_AFTER = 1000
"""Samples learned from without alarm after which a new estimator has become calm: before, nothing is held."""

CALM_REVERSALS = 2.0
"""Reversals that it has to have met, too: what a first half cycle takes for usual says nothing of the other half."""

CELLS_A_BIN = 4
"""Cells of velocity that are judged together: a basis unit."""

MEMORY, MOST = 8.0, 16.0
"""Samples over which squared errors are averaged in a bin, and the most that one counts for."""

BAD, FEW = 4.0, 0.1
"""Mean squared error over its usual variance above which a bin is bad, and the share of bins that may be."""

JUDGE_EVERY, SOONEST = 16, 64
"""Samples between two judgements, and before the first."""

RECENT = 24.0
"""Samples over which the held and the former model are compared where the alarm says that held is wrong."""

CLEARLY, RATHER = 0.3, 0.6
"""Share of held's errors that those of a better model have."""

SIDE_SHARE, SIDE_SAMPLES = 0.05, 5
"""Share of the top speed that a stroke reaches on either side of a reversal, for so many samples in a row."""

PASSED_AFTER, CHANGED_AFTER, DECIDED_AFTER, GIVEN_UP_AFTER = 2, 3, 5, 12
"""Reversals after which a few bins may be bad still, after which a challenger that is clearly better is taken over, one
that is better, and after which the trial ends."""

SAMPLES_A_REVERSAL = 4096
"""Samples that count for a reversal where the drive makes none."""

TOLERANCE_RISE, LARGEST_TOLERANCE, TOLERANCE_MEMORY = 2.0, 8.0, 1e5
"""Factor on the usual variance after an alarm that was none, its limit, and samples over which it falls back to 1: an
error that raises an alarm in every cycle is the model's own."""

HELD, FORMER, OLDER, NEWER = range(4)
"""Rows of `kept`; the first two have a place in `kept_root` too, the last two are kept while all is calm."""

KEPT = PRESENT = 4
"""Rows of `kept`; in `Workspace.residual` the present model's place is behind them."""


@dataclass(frozen=True)
class Kept:
    """A model kept aside, as views of its row in `Workspace.kept`; the fields are those of `Workspace`."""

    theta: Floats
    owed: Floats
    errors: Floats
    moments: Floats

    @classmethod
    def of(cls, row: Floats, work: at.Workspace) -> "Kept":
        """Return the views of a row of `work.kept`."""
        views, start = [], 0
        for like in (work.theta, work.owed, work.errors, work.moments):
            views.append(row[start : start + like.size].reshape(like.shape))
            start += like.size
        return cls(*views)


def roots_in_use(work: at.Workspace) -> bool:
    """Return whether `kept_root` holds anything that a later sample depends on."""
    return bool(work.hold[at.HOLDING] or work.hold[at.HAS_FORMER])


def bins(model: Model) -> int:
    """Return the number of bins of a trial."""
    return -(-model.basis.cell_count // CELLS_A_BIN)


@njit(cache=True)
def _keep(row, theta, owed, errors, moments):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    # Loops, here and below: assignments of slices compile to ten times the code.
    place = 0
    for i in range(theta.size):
        row[place] = theta[i]
        place += 1
    for i in range(owed.size):
        row[place] = owed[i]
        place += 1
    for i in range(errors.shape[0]):
        for j in range(errors.shape[1]):
            row[place] = errors[i, j]
            place += 1
    for i in range(moments.size):
        row[place] = moments[i]
        place += 1


@njit(cache=True)
def _take(row, theta, owed, errors, moments, whole):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take over a kept model; where not the `whole`, the present errors stay."""
    place = 0
    for i in range(theta.size):
        theta[i] = row[place]
        place += 1
    for i in range(owed.size):
        owed[i] = row[place]
        place += 1
    for i in range(errors.shape[0]):
        for j in range(errors.shape[1]):
            if whole:
                errors[i, j] = row[place]
            place += 1
    for i in range(moments.size):
        if whole or i not in (at.ERROR_POWER, at.MISFIT_POWER):
            moments[i] = row[place]
        place += 1


@njit(cache=True)
def _copy(source, target):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = source[i, j]


@njit(cache=True)
def _forget(trial):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    for i in range(trial.shape[0]):
        for j in range(trial.shape[1]):
            trial[i, j] = 0.0


@njit(cache=True)
def _keep_everywhere(hold, kept, theta, owed, errors, moments, residual):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    for spare in (OLDER, NEWER):
        _keep(kept[spare], theta, owed, errors, moments)
        residual[spare] = residual[PRESENT]
    hold[at.SUM] = hold[at.SLOW_SUM] = hold[at.SINCE_KEPT] = 0.0


@njit(cache=True, forceinline=True)
def _usual(variance, misfit, tolerance, law):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the variance that an error is measured by."""
    return tolerance * (max(variance, MISFIT_SHARE * misfit) + FLOOR * law[at.RESIDUAL_VARIANCE])


@njit(cache=True, forceinline=True)
def surprise_of(row, error, variance, moments, law):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return a squared error over what is usual for a kept model."""
    misfit = row[row.size - moments.size + at.MISFIT_POWER]
    return error * error / _usual(variance, misfit, moments[at.TOLERANCE], law)


@njit(cache=True, forceinline=True)
def _usual_errors(row, cell, theta, owed, errors):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the usual variance of a kept model's errors at a cell, without what its covariance adds."""
    start, size = theta.size + owed.size, errors.size
    unknown = row[start + size + at.ERROR_POWER]
    return usual_variance(row[start : start + size].reshape(errors.shape), cell, unknown)


@njit(cache=True)
def _count_reversals(hold, law, velocity):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Count the reversals of the drive; where it makes none, `SAMPLES_A_REVERSAL` samples are one."""
    side = 1.0 if velocity > 0.0 else -1.0
    hold[at.UNREVERSED] += 1.0
    if abs(velocity) <= SIDE_SHARE * law[at.TOP_SPEED] or side == hold[at.SIDE]:
        hold[at.ACROSS] = 0.0
    else:
        hold[at.ACROSS] += 1.0
        if hold[at.ACROSS] >= SIDE_SAMPLES:
            hold[at.REVERSALS] += hold[at.SIDE] != 0.0
            hold[at.SIDE] = side
            hold[at.UNREVERSED] = hold[at.ACROSS] = 0.0
    if hold[at.UNREVERSED] >= SAMPLES_A_REVERSAL:
        hold[at.REVERSALS] += 1.0
        hold[at.UNREVERSED] = 0.0


@njit(cache=True, forceinline=True)
def alarming(hold, kept, theta, owed, errors, moments, residual, velocity, cell, error, open_variance, law):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take one error while nothing is held; return whether the alarm is raised.

    What is usual is what was usual when the model was kept: errors of the last samples must not make themselves usual.
    `open_variance` is what the covariance leaves open of the prediction, and what noise in its columns adds.
    """
    _count_reversals(hold, law, velocity)
    if hold[at.CALM] == 0.0:
        _keep_everywhere(hold, kept, theta, owed, errors, moments, residual)
    moments[at.TOLERANCE] -= (moments[at.TOLERANCE] - 1.0) / TOLERANCE_MEMORY
    variance = open_variance + _usual_errors(kept[OLDER], cell, theta, owed, errors)
    surprise = min(surprise_of(kept[OLDER], error, variance, moments, law), LARGEST)
    hold[at.SUM] = max(0.0, hold[at.SUM] + surprise - DRIFT)
    hold[at.SLOW_SUM] = max(0.0, hold[at.SLOW_SUM] + min(surprise, MOST) - SLOW_DRIFT)
    if hold[at.SUM] > THRESHOLD or hold[at.SLOW_SUM] > SLOW_THRESHOLD:
        hold[at.SUM] = hold[at.SLOW_SUM] = 0.0
        if hold[at.CALM] >= CALM_AFTER and hold[at.REVERSALS] >= CALM_REVERSALS:
            return True
        hold[at.CALM] = 0.0
        return False
    hold[at.CALM] += 1.0
    hold[at.SINCE_KEPT] += 1.0
    if hold[at.SINCE_KEPT] >= SPACING and hold[at.SUM] == 0.0 and hold[at.SLOW_SUM] < SLOW_CALM:
        hold[at.SINCE_KEPT] = 0.0
        for i in range(kept.shape[1]):
            kept[OLDER, i] = kept[NEWER, i]
        _keep(kept[NEWER], theta, owed, errors, moments)
        residual[OLDER] = residual[NEWER]
        residual[NEWER] = residual[PRESENT]
    return False


@njit(cache=True)
def begin_hold(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    hold, kept, kept_root, trial, theta, owed, errors, moments, residual, status, root, prior_root, mean, error
):
    """Hold the model that was kept before the alarm; what learns on is the challenger."""
    power = max(moments[at.ERROR_POWER], error * error)
    _take(kept[OLDER], theta, owed, errors, moments, np.bool_(True))  # a literal would be compiled apart
    _keep(kept[HELD], theta, owed, errors, moments)
    residual[PRESENT] = residual[HELD] = residual[OLDER]
    _copy(root, kept_root[HELD])
    _copy(prior_root, root)
    for i in range(owed.size):
        owed[i] = theta[i] - mean[i]
    moments[at.ABSORBED] = moments[at.PULL] = 0.0
    moments[at.OWED] = 1.0
    # The challenger is to learn from errors of this size, not to take them for outliers.
    moments[at.ERROR_POWER] = max(power, moments[at.ERROR_POWER])
    status[at.ALARMED] += 1
    status[at.FOLLOWS] = 0
    _forget(trial)
    hold[at.HOLDING] = 1.0
    hold[at.JUDGED] = hold[at.REVERSALS] = hold[at.SIDE] = hold[at.ACROSS] = hold[at.UNREVERSED] = 0.0
    hold[at.HELD_RECENT] = hold[at.FORMER_RECENT] = LARGEST
    hold[at.HELD_POWER] = power


@njit(cache=True)
def _exchange(hold, kept, kept_root, trial, residual):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Let the former model predict, and be judged in place of the held one."""
    for i in range(kept.shape[1]):
        kept[HELD, i], kept[FORMER, i] = kept[FORMER, i], kept[HELD, i]
    for i in range(kept_root.shape[1]):
        for j in range(kept_root.shape[2]):
            kept_root[HELD, i, j], kept_root[FORMER, i, j] = kept_root[FORMER, i, j], kept_root[HELD, i, j]
    residual[HELD], residual[FORMER] = residual[FORMER], residual[HELD]
    _forget(trial)
    hold[at.HELD_RECENT], hold[at.FORMER_RECENT] = hold[at.FORMER_RECENT], LARGEST
    hold[at.JUDGED] = 0.0


@njit(cache=True)
def _resume(hold, kept, kept_root, theta, owed, errors, moments, residual, status, root, calm):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Go on learning from the held model; where it did not become `calm`, the errors of late are usual from now on."""
    tolerance = min(moments[at.TOLERANCE] * TOLERANCE_RISE, LARGEST_TOLERANCE)
    _take(kept[HELD], theta, owed, errors, moments, calm)
    residual[PRESENT] = residual[HELD]  # of what has been learned: not of the samples since
    moments[at.TOLERANCE] = tolerance
    _copy(kept_root[HELD], root)
    status[at.FOLLOWS] = 0
    hold[at.HOLDING] = 0.0
    hold[at.RESTORED] += 1.0
    _keep_everywhere(hold, kept, theta, owed, errors, moments, residual)


@njit(cache=True)
def _adopt(hold, kept, kept_root, theta, owed, errors, moments, residual):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """The challenger goes on; the held model is the former one."""
    for i in range(kept.shape[1]):
        kept[FORMER, i] = kept[HELD, i]
    _copy(kept_root[HELD], kept_root[FORMER])
    residual[FORMER] = residual[HELD]
    hold[at.HAS_FORMER] = 1.0
    hold[at.HOLDING] = 0.0
    _keep_everywhere(hold, kept, theta, owed, errors, moments, residual)


@njit(cache=True)
def judge(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    hold,
    kept,
    kept_root,
    trial,
    theta,
    owed,
    errors,
    moments,
    residual,
    status,
    root,
    law,
    velocity,
    cell,
    held_error,
    held_surprise,
    former_surprise,
    surprise,
):
    """Take one sample of the trial: the held model's error, and what each model makes of the sample.

    A surprise is a squared error over what is usual for the held model (for the former model: for that).
    """
    _count_reversals(hold, law, velocity)
    row = trial[cell // CELLS_A_BIN]
    row[0] += 1.0
    gain = 1.0 / min(row[0], MEMORY)
    row[1] += gain * (min(held_surprise, MOST) - row[1])
    row[2] += gain * (min(surprise, MOST) - row[2])
    hold[at.HELD_RECENT] += (min(held_surprise, LARGEST) - hold[at.HELD_RECENT]) / RECENT
    hold[at.FORMER_RECENT] += (min(former_surprise, LARGEST) - hold[at.FORMER_RECENT]) / RECENT
    hold[at.HELD_POWER] += (held_error * held_error - hold[at.HELD_POWER]) / RECENT
    hold[at.JUDGED] += 1.0
    if (
        hold[at.HAS_FORMER] == 1.0
        and hold[at.FORMER_RECENT] < BAD
        and (hold[at.FORMER_RECENT] < CLEARLY * hold[at.HELD_RECENT])
    ):
        _exchange(hold, kept, kept_root, trial, residual)
        return
    if hold[at.JUDGED] < SOONEST or hold[at.JUDGED] % JUDGE_EVERY != 0.0:
        return
    visited = held_bad = 0
    held_sum = total = 0.0
    for place in range(trial.shape[0]):
        if trial[place, 0] > 0.0:
            visited += 1
            held_bad += trial[place, 1] > BAD
            held_sum += trial[place, 1]
            total += trial[place, 2]
    reversals = hold[at.REVERSALS]
    few = FEW * visited
    passed = (held_bad == 0 or (reversals >= PASSED_AFTER and held_bad <= few)) and hold[at.HELD_RECENT] < BAD
    changed = (reversals >= CHANGED_AFTER and total < CLEARLY * held_sum) or (
        reversals >= DECIDED_AFTER and total < RATHER * held_sum
    )
    if changed and not passed:
        _adopt(hold, kept, kept_root, theta, owed, errors, moments, residual)
    elif passed or reversals >= GIVEN_UP_AFTER:
        _resume(hold, kept, kept_root, theta, owed, errors, moments, residual, status, root, passed)


@njit(cache=True)
def predicted_by(row, cell, extension, shape, theta, owed, errors, ring, ring_theory, status, x):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return what a kept model predicts, and the usual variance of its errors there; fill its gradient x."""
    value = regress(shape, row[: theta.size], ring, ring_theory, status, extension, x)
    return value, _usual_errors(row, cell, theta, owed, errors)
