"""The compiled steps of the laws: how parameters, and the root of rls's covariance, move with one sample.

`kernels.run` calls them; x is the regressor of the sample, the gradient of its prediction.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.fit.posterior import COLOUR, SLACK
from friction_estimator.core.model.prediction import EXTENSIONS, TAPS, WEIGHTS
from friction_estimator.core.online import workspace as at
from friction_estimator.core.settings.groups import LARGEST_PARAMETER

LEAST_BACKOFF, RECOVERY = 1e-4, 1e-4
"""lms: smallest factor on the step size after guarded steps, and its relative growth a sample."""

PULL_EVERY, LARGEST_PULL, PAID_AT_ONCE = 64, 0.5, 1.0 / 256.0
"""Samples between two pulls towards the prior, and the largest one: above 1 it would overshoot. After an alarm a
256th of what is owed is paid at each, in 16,384 samples: by then what the drive visits is learned anew, and only the
rest goes back to the prior."""


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
def learn_lms(shape, theta, law, moments, status, x, error):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
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
def learn_nlms(shape, theta, ring, law, status, prior, x, error, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta += mu e D x / (eps + x' D x), one normaliser for all blocks, then the norm of A goes into W."""
    energy = law[at.FLOOR]
    for i in range(x.size):
        gain[i] = prior[i] * x[i]
        energy += gain[i] * x[i]
    step = _trusted(shape, ring, status, x, gain, law[at.STEP] * error / energy)
    if _step_along(theta, gain, step, status):
        _move_norm_into_weights(shape, theta)


@njit(cache=True)
def project(root, x, projected):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
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
def learn_rls(shape, theta, ring, law, moments, status, root, x, error, clipped, projected, r, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
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

    Returns w.
    """
    n = theta.size
    noise = max(1.0, COLOUR * moments[at.MISFIT_POWER] / law[at.RESIDUAL_VARIANCE])
    for i in range(n):
        gain[i] = _dot(root[i], projected)
    step = _trusted(shape, ring, status, x, gain, clipped / (noise + r))
    if not _step_along(theta, gain, step, status):
        return 0.0
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
    return w


@njit(cache=True)
def without_noise(shape, theta, root, prior_root, noise, status, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Take off what noise in the columns of the load seemed to tell: information N_j = sum w s_j, and a pull to 0.

    Least squares shrinks a coefficient by N_j P_jj, the share of its information that is noise; where that is put back,
    theta += N_j / (1 - N_j P_jj) P e_j theta_j, the information is (1 - N_j P_jj)^2 of what it seemed, which is at
    least R - 2 N_j e_j e_j'. With u = 2 N_j / (1 - 2 N_j P_jj) and f = S' e_j that is

        P <- P + u P e_j e_j' P,    S <- S (I + gamma f f'),    gamma = (sqrt(1 + u P_jj) - 1) / P_jj

    No variance comes to exceed the prior's; where one would, noise is half of the column's own part or more, nothing
    is known of the coefficient however many samples there were, and its value stays that of least squares, which
    predicts best (docs/decisions/0096-noise-is-no-excitation.md; Sagara and Wada, Int. J. Control 25 (1977) 329).
    """
    n = root.shape[0]
    start = n - shape[EXTENSIONS]
    for load in range(noise.shape[0]):
        seeming = noise[load, 0]
        noise[load, 0] = 0.0
        if not seeming > 0.0:
            continue
        row = root[start + load]
        r = _dot(row, row)
        rise = np.inf
        if 2.0 * seeming * r < 1.0:
            rise = 2.0 * seeming / (1.0 - 2.0 * seeming * r)
        known = True
        for i in range(n):
            gain[i] = _dot(root[i], row)
            room = max(0.0, SLACK * _dot(prior_root[i], prior_root[i]) - _dot(root[i], root[i]))
            if rise * gain[i] * gain[i] > room:
                rise = room / (gain[i] * gain[i])
                known = False
        noise[load, 1] = 0.0 if known else 1.0
        if known:
            _step_along(theta, gain, seeming / (1.0 - seeming * r) * theta[start + load], status)
        gamma = (np.sqrt(1.0 + rise * r) - 1.0) / r
        for i in range(n):
            if i != start + load:
                for j in range(n):
                    root[i, j] += gamma * gain[i] * row[j]
        for j in range(n):
            row[j] *= 1.0 + gamma * r


@njit(cache=True)
def mistaken(shape, root, noise, x, direction):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the variance of a prediction where a load of which nothing is known may be a force unit off.

    What least squares took for another load or for friction stands in the direction b = P e_j / P_jj: the prediction
    is off by x' b as soon as the drive tells them apart.
    """
    start = root.shape[0] - shape[EXTENSIONS]
    total = 0.0
    for load in range(noise.shape[0]):
        if noise[load, 1] == 0.0:
            continue
        row = root[start + load]
        for i in range(root.shape[0]):
            direction[i] = _dot(root[i], row)
        off = _dot(x, direction) / _dot(row, row)
        total += off * off
    return total


@njit(cache=True)
def pull(theta, root, mean, information, owed, moments, status, projected, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
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
