"""The compiled sample loop that replay and the live node share.

One sample is: push the new row into the delay lines, predict, learn. `run` does this over arrays; the node calls
it with arrays of one. All state lives in the arrays of `Workspace`, so it can be copied, compared and restored bit
for bit. `model.prediction` has the prediction and its gradient x, the regressor of every law.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.fit.band import EXTRAPOLATION, note_error, usual_variance
from friction_estimator.core.intake.standstill import stands, stopping
from friction_estimator.core.model.prediction import EXTENSIONS, TAPS, push, regress, rubbing
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.law_steps import (
    PULL_EVERY,
    learn_lms,
    learn_nlms,
    learn_rls,
    mistaken,
    project,
    pull,
    without_noise,
)
from friction_estimator.core.online.recovery import FORMER, HELD, alarming, begin_hold, judge, predicted_by, surprise_of

LMS, NLMS, RLS = range(3)
"""Numbers of the laws in the compiled dispatch; online/adaptation.py has the classes."""

CLIP = 6.0
"""Errors beyond this many running rms are shortened before nlms and rls learn from them (Huber)."""

ERROR_MEMORY = 200.0
"""Samples over which the running error power is averaged."""

LEAST_POWER = 1e-12
"""Floor of the running powers: float noise of a perfect model is no alarm."""

LEAST_EXCITATION, LARGEST_EXCITATION = 1e-14, 1e14
"""rls learns from samples whose x' P x lies between: below there is nothing to learn, above rounding would rule."""

KNOWN_LEVERAGE = 0.1
"""Errors where x' P x is larger tell of what was not learned yet, not of what cannot be: the band leaves them out."""

MISFIT_MEMORY = 5000.0
"""Samples over which the power of known errors is averaged."""

GROW_AFTER = 20
"""Samples in a row beyond an edge of the range after which it grows: a wild velocity is alone."""


@njit(cache=True)
def _beyond(moments, status, velocity, beyond, learn):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Count samples in a row beyond one edge; return whether the range is to grow."""
    if beyond == 0.0 or not learn:
        status[at.BEYOND] = 0
        return False
    side = 1 if velocity > 0.0 else -1
    if status[at.BEYOND] * side <= 0:
        status[at.BEYOND] = 0
        moments[at.NEAREST] = moments[at.FARTHEST] = velocity
    status[at.BEYOND] += side
    if abs(velocity) < abs(moments[at.NEAREST]):
        moments[at.NEAREST] = velocity
    if abs(velocity) > abs(moments[at.FARTHEST]):
        moments[at.FARTHEST] = velocity
    return status[at.MAY_GROW] == 1 and abs(status[at.BEYOND]) >= GROW_AFTER


@njit(cache=True)
def noise_in(theta, shape, column_noise):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the variance that noise in the columns of the load gives a prediction."""
    start = theta.size - shape[EXTENSIONS]
    total = 0.0
    for load in range(column_noise.size):
        total += theta[start + load] * theta[start + load] * column_noise[load]
    return total


@njit(cache=True, nogil=True)
def run(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    law_number,
    index,
    value,
    cell,
    beyond,
    velocity,
    theory,
    extension,
    column_noise,
    known,
    target,
    restart,
    learn,
    predicted,
    deviation,
    shape,
    theta,
    ring,
    ring_theory,
    root,
    prior,
    mean,
    information,
    prior_root,
    noise,
    owed,
    law,
    moments,
    status,
    errors,
    rest,
    kept,
    kept_root,
    trial,
    hold,
):
    """Predict and learn over n samples, or until the range is to grow.

    Parameters
    ----------
    law_number : LMS, NLMS or RLS.
    index, value : (n, width), rows of Psi. cell : (n,), cell of the velocity. beyond : (n,), relative distance outside
        the range. velocity : (n,), m/s. theory : (n,), d. extension : (n, columns).
        column_noise : (n, loads), variance of the noise in the columns of the load.
        known : (n, 1), known load, where the last of these is the sign of friction that follows the load, else (n, 0).
        target : (n,), measured friction.
        All finite; forces in normalised units.
    restart, learn : (n,) bool.
    predicted, deviation : (n,), filled with the a priori prediction and its standard deviation.
    shape .. hold : the arrays of `Workspace`, updated in place.

    Returns
    -------
    0, or, where the range is to grow, the number of samples taken: the caller has to see to it before it goes on.
    """
    n = theta.size
    x = np.zeros(n)
    projected = np.zeros(n)
    gain = np.zeros(n)
    settled = shape[TAPS] - 1
    last = noise.shape[0] - 1
    follows = known.shape[1] > 0
    for k in range(target.size):
        begins = restart[k] or status[at.SEEN] == 0
        push(shape, ring, ring_theory, status, index[k], value[k], theory[k], begins)
        status[at.SEEN] += 1
        scale = law[at.TOP_SPEED]
        standing = stands(rest, velocity[k], begins, scale)
        holding = hold[at.HOLDING] == 1.0
        if holding:
            # Scratch that the challenger's own prediction fills anew.
            if follows:
                sign = extension[k, last]
                extension[k, last] = sign * rubbing(shape, kept[HELD, :n], extension[k], last, known[k, 0])
            held, held_variance = predicted_by(
                kept[HELD], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            held_variance += noise_in(kept[HELD, :n], shape, column_noise[k])
            if law_number == RLS:
                held_variance += law[at.RESIDUAL_VARIANCE] * project(kept_root[HELD], x, projected)
            if follows:
                extension[k, last] = sign * rubbing(shape, kept[FORMER, :n], extension[k], last, known[k, 0])
            former, former_variance = predicted_by(
                kept[FORMER], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            former_variance += noise_in(kept[FORMER, :n], shape, column_noise[k])
            if follows:
                extension[k, last] = sign
            hold[at.HELD_SINCE] += 1.0
        if follows:
            extension[k, last] *= rubbing(shape, theta, extension[k], last, known[k, 0])
        predicted[k] = regress(shape, theta, ring, ring_theory, status, extension[k], x)
        error = target[k] - predicted[k]
        variance = usual_variance(errors, cell[k], moments[at.ERROR_POWER])
        r = 0.0
        open_variance = noise_in(theta, shape, column_noise[k])
        if law_number == RLS:
            r = project(root, x, projected)
            open_variance += law[at.RESIDUAL_VARIANCE] * r
        variance += open_variance
        outside = EXTRAPOLATION * beyond[k]
        deviation[k] = np.sqrt(variance + outside * outside)
        if holding:
            predicted[k] = held
            deviation[k] = np.sqrt(held_variance + hold[at.HELD_POWER] + outside * outside)
        limit = CLIP * np.sqrt(moments[at.ERROR_POWER])
        clipped = min(max(error, -limit), limit)
        moving = abs(velocity[k]) > law[at.LEAST_SPEED]
        if moving:
            moments[at.ERROR_POWER] += (clipped * clipped - moments[at.ERROR_POWER]) / ERROR_MEMORY
            moments[at.ERROR_POWER] = max(moments[at.ERROR_POWER], LEAST_POWER)
        if beyond[k] > 0.0:
            status[at.OUTSIDE] += 1
            status[at.FOLLOWS] = 0
            if _beyond(moments, status, velocity[k], beyond[k], learn[k]):
                return k + 1
            continue
        status[at.BEYOND] = 0
        if learn[k] and (standing or (law_number != LMS and stopping(rest, velocity[k], scale))):
            # Below breakaway friction is whatever holds the shaft: the band may know how much that is, the curve not.
            # lms, the paper's to the letter, learns until the rest is known.
            status[at.STOOD] += standing
            status[at.FOLLOWS] = 0
            if r < KNOWN_LEVERAGE:
                note_error(errors, cell[k], clipped, 0.0, False)
            continue
        # lms is the paper's to the letter; the others wait until the delay lines hold measured samples only.
        if not learn[k] or (law_number != LMS and status[at.HEAD] < settled):
            status[at.FOLLOWS] = 0
            continue
        status[at.LEARNED] += 1
        if r < KNOWN_LEVERAGE:
            if moving:
                moments[at.MISFIT_POWER] += (clipped * clipped - moments[at.MISFIT_POWER]) / MISFIT_MEMORY
            note_error(errors, cell[k], clipped, moments[at.LAST_ERROR], status[at.FOLLOWS] == 1 and not begins)
            moments[at.LAST_ERROR] = clipped
            status[at.FOLLOWS] = 1
        else:
            status[at.FOLLOWS] = 0
        if law_number == LMS:
            learn_lms(shape, theta, law, moments, status, x, error)
            continue
        if clipped != error:
            status[at.CLIPPED] += 1
        if holding:
            row, former_row = kept[HELD], kept[FORMER]
            judge(
                hold, kept, kept_root, trial, theta, owed, errors, moments, status, root, law,
                velocity[k], cell[k], target[k] - held,
                surprise_of(row, target[k] - held, held_variance, moments, law),
                surprise_of(former_row, target[k] - former, former_variance, moments, law),
                surprise_of(row, error, held_variance, moments, law),
            )  # fmt: skip
            if hold[at.HOLDING] == 0.0:
                continue
        elif law_number == NLMS or law[at.LEAST_LEVERAGE] > 0.0:
            if law_number == RLS and error * error > variance:
                open_variance += mistaken(shape, root, noise, x, gain)
            if alarming(hold, kept, theta, owed, errors, moments, velocity[k], cell[k], error, open_variance, law):
                hold[at.HELD_SINCE] = 0.0
                begin_hold(
                    hold, kept, kept_root, trial, theta, owed, errors, moments, status, root, prior_root, mean, error
                )
                continue
        if law_number == NLMS:
            learn_nlms(shape, theta, ring, law, status, prior, x, clipped, gain)
            continue
        if LEAST_EXCITATION < r < LARGEST_EXCITATION:
            w = learn_rls(shape, theta, ring, law, moments, status, root, x, error, clipped, projected, r, gain)
            for load in range(noise.shape[0]):
                noise[load, 0] += w * column_noise[k, load]
        status[at.UNPULLED] += 1
        if status[at.UNPULLED] >= PULL_EVERY:
            status[at.UNPULLED] = 0
            without_noise(shape, theta, root, prior_root, noise, status, gain)
            pull(theta, root, mean, information, owed, moments, status, projected, gain)
    return 0
