"""The compiled sample loop that replay and the live node share.

One sample is: push the new row into the delay lines, predict, learn. `run` does this over arrays; the node calls
it with arrays of one. All state lives in the arrays of `Workspace`, so it can be copied, compared and restored bit
for bit. `model.prediction` has the prediction and its gradient x, the regressor of every law.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.fit.band import EXTRAPOLATION, note_error, usual_variance
from friction_estimator.core.fit.posterior import COLOUR
from friction_estimator.core.intake.standstill import stands, stopping
from friction_estimator.core.model.prediction import TAPS, WEIGHTS, push, regress
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.recovery import FORMER, HELD, alarming, begin_hold, judge, predicted_by, surprise_of
from friction_estimator.core.settings.groups import LARGEST_PARAMETER

LMS, NLMS, RLS = range(3)
"""Numbers of the laws in the compiled dispatch; online/adaptation.py has the classes."""

CLIP = 6.0
"""Errors beyond this many running rms are shortened before nlms and rls learn from them (Huber)."""

ERROR_MEMORY = 200.0
"""Samples over which the running error power is averaged."""

LEAST_BACKOFF, RECOVERY = 1e-4, 1e-4
"""lms: smallest factor on the step size after guarded steps, and its relative growth a sample."""

LEAST_POWER = 1e-12
"""Floor of the running powers: float noise of a perfect model is no alarm."""

LEAST_EXCITATION, LARGEST_EXCITATION = 1e-14, 1e14
"""rls learns from samples whose x' P x lies between: below there is nothing to learn, above rounding would rule."""

KNOWN_LEVERAGE = 0.1
"""Errors where x' P x is larger tell of what was not learned yet, not of what cannot be: the band leaves them out."""

MISFIT_MEMORY = 5000.0
"""Samples over which the power of known errors is averaged."""

PULL_EVERY, LARGEST_PULL, PAID_AT_ONCE = 64, 0.5, 1.0 / 256.0
"""Samples between two pulls towards the prior, and the largest one: above 1 it would overshoot. After an alarm a
256th of what is owed is paid at each, in 16,384 samples: by then what the drive visits is learned anew, and only the
rest goes back to the prior."""

GROW_AFTER = 20
"""Samples in a row beyond an edge of the range after which it grows: a wild velocity is alone."""


@njit(cache=True, fastmath={"reassoc", "contract"})
def _dot(a, b):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return a' b, summed in the order that vectorises (the same for every call)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _normalise_taps(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Divide A by its norm (the paper's A = A*/||A*||); return the norm, 0 where A vanished and was left alone."""
    taps = shape[TAPS]
    norm = 0.0
    for i in range(taps):
        norm += theta[i] * theta[i]
    norm = np.sqrt(norm)
    if norm > 1e-12:
        for i in range(taps):
            theta[i] /= norm
        return norm
    return 0.0


@njit(cache=True)
def _step_along(theta, direction, gain, status):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta += gain direction, unless |theta| could leave the guarded range: then nothing is learned here."""
    reach = np.sqrt(_dot(theta, theta)) + abs(gain) * np.sqrt(_dot(direction, direction))
    if not reach < LARGEST_PARAMETER:  # also true for NaN
        status[at.GUARDED] += 1
        return False
    for i in range(theta.size):
        theta[i] += gain * direction[i]
    return True


@njit(cache=True)
def _trusted(shape, ring, status, x, direction, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return `gain`, shortened until the model's bilinear term agrees with its linearisation.

    Along gain * direction the prediction changes by gain x' direction + gain^2 sum_i dA_i dW' Psi[k-i] exactly. The
    second term, which the law does not know of, is kept below half of the first: then a step that removes at most the
    whole error of the linearised model never enlarges the error on its own sample.
    """
    taps, weights = shape[TAPS], shape[WEIGHTS]
    step = direction[taps : taps + weights]
    bilinear = 0.0
    place = status[at.HEAD] % taps
    for i in range(taps):
        bilinear += direction[i] * _dot(ring[place], step)
        place = place - 1 if place > 0 else taps - 1
    linear, bilinear = abs(gain * _dot(x, direction)), gain * gain * abs(bilinear)
    if bilinear <= 0.5 * linear:
        return gain
    status[at.GUARDED] += 1
    return gain * 0.5 * linear / bilinear


@njit(cache=True)
def _learn_lms(shape, theta, law, moments, status, x, error):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """The paper's law: A* = A + mu e F, A = A*/||A*||, W += mu e A(q) Psi, A1 += mu e F1.

    Guard: where mu |x|^2 > 1 the step would overshoot the sample that it learns from, the first sign of divergence.
    It is shortened to mu = 1/|x|^2 and counted, and mu itself backs off to half; it recovers over 1 / RECOVERY samples.
    Without the guard (`law[FLOOR]` 0) a diverging law stops at `LARGEST_PARAMETER`.
    """
    step = law[at.STEP] * moments[at.BACKOFF]
    energy = _dot(x, x)
    if law[at.FLOOR] > 0.0 and step * energy > 1.0:
        step = 1.0 / energy
        status[at.GUARDED] += 1
        moments[at.BACKOFF] = max(0.5 * moments[at.BACKOFF], LEAST_BACKOFF)
    elif moments[at.BACKOFF] < 1.0:
        moments[at.BACKOFF] = min(1.0, moments[at.BACKOFF] * (1.0 + RECOVERY))
    if _step_along(theta, x, step * error, status):
        _normalise_taps(shape, theta)


@njit(cache=True)
def _move_norm_into_weights(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Normalise A and multiply W by its norm, where it has left [0.8, 1.25]: the output does not change."""
    taps = shape[TAPS]
    power = 0.0
    for i in range(taps):
        power += theta[i] * theta[i]
    if 0.64 < power < 1.5625:
        return
    norm = _normalise_taps(shape, theta)
    if norm > 0.0:
        for i in range(taps, taps + shape[WEIGHTS]):
            theta[i] *= norm


@njit(cache=True)
def _learn_nlms(shape, theta, ring, law, status, prior, x, error, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta += mu e D x / (eps + x' D x), one normaliser for all blocks, then the norm of A goes into W."""
    energy = law[at.FLOOR]
    for i in range(x.size):
        gain[i] = prior[i] * x[i]
        energy += gain[i] * x[i]
    step = _trusted(shape, ring, status, x, gain, law[at.STEP] * error / energy)
    if _step_along(theta, gain, step, status):
        _move_norm_into_weights(shape, theta)


@njit(cache=True)
def _project(root, x, projected):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill projected = S' x and return x' P x."""
    n = x.size
    for j in range(n):
        projected[j] = 0.0
    for i in range(n):
        xi = x[i]
        if xi != 0.0:
            for j in range(n):
                projected[j] += root[i, j] * xi
    return _dot(projected, projected)


@njit(cache=True)
def _learn_rls(shape, theta, ring, law, moments, status, root, x, error, clipped, projected, r, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Recursive prediction error under a prior that is never spent, in square-root form.

    P = S S' is positive semidefinite whatever is rounded. With r = x' P x in units of the residual variance,

        theta += P x e / (1 + r),    S <- S (I - gamma f f'),  f = S' x,  gamma = (1 - 1 / sqrt(1 + w r)) / r

    is the information update R <- R + w x x'. w is 1 while a sample is news, and less where r would fall below the
    least leverage 1 - lambda: what is known along x then stays as it is. That is directional forgetting (Kulhavy and
    Karny 1984) in its steady state, where as much is forgotten as is learned, except that nothing is taken away: R
    never falls, so nothing winds up at standstill, and R >= R_prior.

    A sample that adds nothing to R still moves theta. With N samples in R it counts for one that it replaces, so the
    prior counts again by 1/N: theta -= (1 - w)/N P R_prior (theta - mean), gathered over `PULL_EVERY` samples. The
    fixed point is that of the batch fit: N times the mean square error plus the prior's term is least.

    A step that is shortened, because the error is an outlier or because the model is too curved for it, counts as
    proportionally less information. So does every sample while known errors are larger than the prior takes them to be
    (`noise` above 1): what the model cannot follow repeats with the drive, and would outvote any prior.
    """
    n = theta.size
    noise = max(1.0, COLOUR * moments[at.MISFIT_POWER] / law[at.RESIDUAL_VARIANCE])
    for i in range(n):
        gain[i] = _dot(root[i], projected)
    step = _trusted(shape, ring, status, x, gain, clipped / (noise + r))
    if not _step_along(theta, gain, step, status):
        return
    # step = error / (rho + r): rho is the noise variance at which this step is the whole one.
    w = 1.0 / max(noise, error / step - r) if step != 0.0 else 1.0 / noise
    floor = law[at.LEAST_LEVERAGE]
    if floor > 0.0:
        w = min(w, max(0.0, 1.0 / (floor * noise) - 1.0 / r))
    if w > 0.0:
        gamma = (1.0 - 1.0 / np.sqrt(1.0 + w * r)) / r
        for i in range(n):
            factor = gamma * gain[i]
            for j in range(n):
                root[i, j] -= factor * projected[j]
    moments[at.ABSORBED] += w * noise
    moments[at.PULL] += (1.0 - w * noise) / max(moments[at.ABSORBED], 1.0)


@njit(cache=True)
def _pull(theta, root, mean, information, owed, moments, status, projected, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta -= P R_prior (pull (theta - mean) + share owed): what the prior says of the samples that replaced others.

    What is owed since an alarm is paid in parts, so that the prediction does not jump.
    """
    share = min(moments[at.PULL], LARGEST_PULL)
    part = min(PAID_AT_ONCE, moments[at.OWED])
    moments[at.PULL] = 0.0
    moments[at.OWED] -= part
    if share + part <= 0.0:
        return
    n = theta.size
    for i in range(n):
        gain[i] = share * (theta[i] - mean[i]) + part * owed[i]
    for j in range(n):
        projected[j] = 0.0
    for i in range(n):
        force = _dot(information[i], gain)
        for j in range(n):
            projected[j] += root[i, j] * force
    for i in range(n):
        gain[i] = _dot(root[i], projected)
    _step_along(theta, gain, -1.0, status)


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
        the range. velocity : (n,), m/s. theory : (n,), d. extension : (n, columns). target : (n,), measured friction.
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
    for k in range(target.size):
        begins = restart[k] or status[at.SEEN] == 0
        push(shape, ring, ring_theory, status, index[k], value[k], theory[k], begins)
        status[at.SEEN] += 1
        scale = law[at.TOP_SPEED]
        standing = stands(rest, velocity[k], begins, scale)
        holding = hold[at.HOLDING] == 1.0
        if holding:
            # Scratch that the challenger's own prediction fills anew.
            held, held_variance = predicted_by(
                kept[HELD], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            if law_number == RLS:
                held_variance += law[at.RESIDUAL_VARIANCE] * _project(kept_root[HELD], x, projected)
            former, former_variance = predicted_by(
                kept[FORMER], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            hold[at.HELD_SINCE] += 1.0
        predicted[k] = regress(shape, theta, ring, ring_theory, status, extension[k], x)
        error = target[k] - predicted[k]
        variance = usual_variance(errors, cell[k], moments[at.ERROR_POWER])
        r = 0.0
        if law_number == RLS:
            r = _project(root, x, projected)
            variance += law[at.RESIDUAL_VARIANCE] * r
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
            _learn_lms(shape, theta, law, moments, status, x, error)
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
        elif (law_number == NLMS or law[at.LEAST_LEVERAGE] > 0.0) and alarming(
            hold, kept, theta, owed, errors, moments, cell[k], error, law[at.RESIDUAL_VARIANCE] * r, law
        ):
            hold[at.HELD_SINCE] = 0.0
            begin_hold(
                hold, kept, kept_root, trial, theta, owed, errors, moments, status, root, prior_root, mean, error
            )
            continue
        if law_number == NLMS:
            _learn_nlms(shape, theta, ring, law, status, prior, x, clipped, gain)
            continue
        if LEAST_EXCITATION < r < LARGEST_EXCITATION:
            _learn_rls(shape, theta, ring, law, moments, status, root, x, error, clipped, projected, r, gain)
        status[at.UNPULLED] += 1
        if status[at.UNPULLED] >= PULL_EVERY:
            status[at.UNPULLED] = 0
            _pull(theta, root, mean, information, owed, moments, status, projected, gain)
    return 0
