"""The compiled sample loop that replay and the live node share.

One sample is: push the new row into the delay lines, predict, learn. `run` does this over arrays; the node calls
it with arrays of one. All state lives in the arrays of `Workspace`, so it can be copied, compared and restored bit
for bit. The prediction and its gradient x, the regressor of every law, are in core/model/prediction.py.

numba's cache sees edits of this file only, not of those that `run` calls: see there.
"""

import numpy as np
from numba import njit

from friction_estimator.core.model.prediction import HEAD, TAPS, WEIGHTS, push, regress
from friction_estimator.core.model.structure import LARGEST_PARAMETER
from friction_estimator.core.online import workspace as at

LMS, NLMS, RLS = range(3)
"""Numbers of the laws in the compiled dispatch; core/online/adaptation.py has the classes."""

CLIP = 6.0
"""Errors beyond this many running rms are shortened before nlms and rls learn from them (Huber)."""

ERROR_MEMORY = 200.0
"""Samples over which the running error power is averaged."""

QUIET_FALL, QUIET_RISE = 500.0, 5000.0
"""Samples over which the quiet error power follows a fall and a rise: it stays near the lower quarter of e^2."""

ALARM_RATIO = 80.0
"""Running error power over quiet power beyond which the friction itself is taken to have changed."""

TOLERANCE_RISE, TOLERANCE_MEMORY = 4.0, 1e5
"""Factor on that ratio after each alarm, and samples over which it falls back to 1: what is alarming in every cycle is
the model's error, not a change."""

LEAST_BACKOFF, RECOVERY = 1e-4, 1e-4
"""lms: smallest factor on the step size after guarded steps, and its relative growth a sample."""

LEAST_POWER = 1e-12
"""Floor of the running powers: float noise of a perfect model is no alarm."""

WHOLE_STEP = 1.001
"""rls forgets only where its step was not shortened by more than this factor of the noise variance."""

LEAST_EXCITATION, LARGEST_EXCITATION = 1e-14, 1e14
"""rls learns from samples whose x' P x lies between: below there is nothing to learn, above rounding would rule."""


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
    place = status[HEAD] % taps
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
    """
    step = law[at.STEP] * moments[at.BACKOFF]
    energy = _dot(x, x)
    if step * energy > 1.0:
        step = 1.0 / energy
        status[at.GUARDED] += 1
        moments[at.BACKOFF] = max(0.5 * moments[at.BACKOFF], LEAST_BACKOFF)
    elif moments[at.BACKOFF] < 1.0:
        moments[at.BACKOFF] = min(1.0, moments[at.BACKOFF] * (1.0 + RECOVERY))
    if _step_along(theta, x, step * error, status):
        _normalise_taps(shape, theta)


@njit(cache=True)
def _move_norm_into_weights(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Normalise A and multiply W by its norm, where it has left [0.8, 1.25]: the output does not change.

    Return the norm that was moved, 0 where nothing was.
    """
    taps = shape[TAPS]
    power = 0.0
    for i in range(taps):
        power += theta[i] * theta[i]
    if 0.64 < power < 1.5625:
        return 0.0
    norm = _normalise_taps(shape, theta)
    if norm > 0.0:
        for i in range(taps, taps + shape[WEIGHTS]):
            theta[i] *= norm
    return norm


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
def _begin_again(status, parameters):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Keep samples from the present one on only: those before tell of other friction."""
    status[at.KEPT] = 0
    status[at.REVERSALS] = 0
    status[at.DUE] = at.SAMPLES_A_PARAMETER * parameters
    status[at.PROPOSED] = 0


@njit(cache=True)
def _keep(kept, moments, status, velocity, theory, extension, target, error, joint):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Store a sample that was learned from, if its block is one of those that are kept; count reversals.

    Every block so far is kept with the same probability (reservoir sampling, Vitter 1985, algorithm R), so no period of
    the drive is in step with it. The random number is a hash of the block's number: nothing else need be remembered.
    """
    place = status[at.KEPT]
    status[at.KEPT] += 1
    moments[at.FASTEST] = max(moments[at.FASTEST], abs(velocity))
    if abs(velocity) > 0.1 * moments[at.FASTEST]:
        direction = 1 if velocity > 0.0 else -1
        if status[at.DIRECTION] == -direction:
            status[at.REVERSALS] += 1
        status[at.DIRECTION] = direction
    blocks = kept.shape[0] // at.KEPT_BLOCK
    number, row = place // at.KEPT_BLOCK, place % at.KEPT_BLOCK
    if row == 0:
        if number < blocks:
            status[at.SLOT] = number
        else:
            mixed = np.uint64(number) * np.uint64(0x9E3779B97F4A7C15)
            mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            mixed = (mixed ^ (mixed >> np.uint64(31))) % np.uint64(number + 1)
            status[at.SLOT] = np.int64(mixed) if mixed < np.uint64(blocks) else -1
    if status[at.SLOT] < 0:
        return
    into = kept[status[at.SLOT] * at.KEPT_BLOCK + row]
    into[at.KEPT_PLACE] = place
    into[at.KEPT_VELOCITY] = velocity
    into[at.KEPT_THEORY] = theory
    into[at.KEPT_TARGET] = target
    into[at.KEPT_ERROR] = error
    into[at.KEPT_JOINT] = joint
    for i in range(extension.size):
        into[at.KEPT_EXTENSION + i] = extension[i]


@njit(cache=True)
def _learn_rls(shape, theta, ring, law, moments, status, root, diagonal, prior, x, error, clipped, projected, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Recursive prediction error with directional forgetting, in square-root form.

    P = S S' is positive semidefinite whatever is rounded. With r = x' P x the update

        theta += P x e / (1 + r),  S <- S (I - gamma f f'), f = S' x, (1 - gamma r)^2 = 1 / (lambda (1 + r))

    is the information update R <- R - (1 - lambda) x x' / (x' P x) + x x' of Kulhavy and Karny (1984): only what is
    known along x is forgotten, so nothing winds up at standstill. A parameter whose variance would rise above its prior
    keeps it (its row of S stays as it is). A step that is shortened, because the error is an outlier or because the
    model is too curved for it, counts as proportionally less information. When the running error rises far above its
    quiet level, the friction has changed abruptly: the covariance is set back to the prior once, the parameters stay.
    """
    n = theta.size
    if law[at.FORGETTING] < 1.0:
        ratio = moments[at.ERROR_POWER] / (moments[at.QUIET_POWER] * moments[at.TOLERANCE])
        moments[at.TOLERANCE] -= (moments[at.TOLERANCE] - 1.0) / TOLERANCE_MEMORY
        if moments[at.ALARM] == 0.0 and ratio > ALARM_RATIO:
            moments[at.ALARM] = 1.0
            moments[at.TOLERANCE] *= TOLERANCE_RISE
            status[at.ALARMED] += 1
            _begin_again(status, n)
            root[:, :] = 0.0
            for i in range(n):
                root[i, i] = np.sqrt(prior[i])
                diagonal[i] = prior[i]
        elif ratio < 0.25 * ALARM_RATIO:
            moments[at.ALARM] = 0.0
    for j in range(n):
        projected[j] = 0.0
    for i in range(n):
        xi = x[i]
        if xi != 0.0:
            for j in range(n):
                projected[j] += root[i, j] * xi
    r = _dot(projected, projected)
    if not LEAST_EXCITATION < r < LARGEST_EXCITATION:
        return
    for i in range(n):
        gain[i] = _dot(root[i], projected)
    step = _trusted(shape, ring, status, x, gain, clipped / (1.0 + r))
    if not _step_along(theta, gain, step, status):
        return
    # step = error / (rho + r): rho is the noise variance, 1 for a whole step, at which this step is the whole one.
    rho = max(1.0, error / step - r) if step != 0.0 else 1.0
    shrink = rho / (rho + r)
    if rho < WHOLE_STEP:
        shrink /= law[at.FORGETTING]
    change = (1.0 - shrink) / r  # P <- P - change g g'
    gamma = (1.0 - np.sqrt(shrink)) / r
    for i in range(n):
        grown = diagonal[i] - change * gain[i] * gain[i]
        if shrink > 1.0 and grown > prior[i]:
            continue  # forgotten as far as it may be
        diagonal[i] = grown
        factor = gamma * gain[i]
        for j in range(n):
            root[i, j] -= factor * projected[j]
    norm = _move_norm_into_weights(shape, theta)
    taps, weights = shape[TAPS], shape[WEIGHTS]
    if norm > 0.0:
        for i in range(taps + weights):
            scale = 1.0 / norm if i < taps else norm
            diagonal[i] *= scale * scale
            for j in range(n):
                root[i, j] *= scale
    moments[at.DIAGONAL_AGE] += 1.0
    if moments[at.DIAGONAL_AGE] >= 1000.0:  # rounding must not gather in the running diagonal
        moments[at.DIAGONAL_AGE] = 0.0
        for i in range(n):
            diagonal[i] = _dot(root[i], root[i])


@njit(cache=True, nogil=True)
def run(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    law_number,
    index,
    value,
    velocity,
    theory,
    extension,
    target,
    restart,
    learn,
    predicted,
    shape,
    theta,
    ring,
    ring_theory,
    root,
    diagonal,
    prior,
    law,
    moments,
    status,
    kept,
):
    """Predict and learn over n samples, or until something is due.

    Parameters
    ----------
    law_number : LMS, NLMS or RLS.
    index, value : (n, width), rows of Psi. velocity : (n,), m/s. theory : (n,), d. extension : (n, columns).
        target : (n,), measured friction. All finite; forces in normalised units.
    restart, learn : (n,) bool.
    predicted : (n,), filled with the a priori prediction.
    shape .. kept : the arrays of `Workspace`, updated in place.

    Returns
    -------
    0, or, where a fit to the kept samples is due, the number of samples taken: the caller has to start or to adopt it
    before it goes on (see `relinearisation`).
    """
    n = theta.size
    x = np.zeros(n)
    projected = np.zeros(n)
    gain = np.zeros(n)
    for k in range(target.size):
        begins = restart[k] or status[at.SEEN] == 0
        push(shape, ring, ring_theory, status, index[k], value[k], theory[k], begins)
        status[at.SEEN] += 1
        predicted[k] = regress(shape, theta, ring, ring_theory, status, extension[k], x)
        error = target[k] - predicted[k]
        limit = CLIP * np.sqrt(moments[at.ERROR_POWER])
        clipped = min(max(error, -limit), limit)
        moments[at.ERROR_POWER] += (clipped * clipped - moments[at.ERROR_POWER]) / ERROR_MEMORY
        moments[at.ERROR_POWER] = max(moments[at.ERROR_POWER], LEAST_POWER)
        quiet = moments[at.QUIET_POWER]
        surprise = min(clipped * clipped, 9.0 * quiet) - quiet
        moments[at.QUIET_POWER] = max(quiet + surprise / (QUIET_FALL if surprise < 0.0 else QUIET_RISE), LEAST_POWER)
        if learn[k]:
            status[at.LEARNED] += 1
            if law_number == LMS:
                _learn_lms(shape, theta, law, moments, status, x, error)
                continue
            if clipped != error:
                status[at.CLIPPED] += 1
            if law_number == NLMS:
                _learn_nlms(shape, theta, ring, law, status, prior, x, clipped, gain)
            else:
                _learn_rls(
                    shape, theta, ring, law, moments, status, root, diagonal, prior, x, error, clipped, projected, gain
                )
        if kept.shape[0] > 0:
            if not learn[k]:
                status[at.BROKEN] = 1
                continue
            joint = at.RESTARTS if begins else at.JOINS if status[at.BROKEN] != 0 else at.CONTINUES
            status[at.BROKEN] = 0
            _keep(kept, moments, status, velocity[k], theory[k], extension[k], target[k], error, joint)
            moved = status[at.PROPOSED] > 0 or status[at.REVERSALS] >= at.FEWEST_REVERSALS
            if moved and status[at.KEPT] >= status[at.DUE]:
                return k + 1
    return 0
