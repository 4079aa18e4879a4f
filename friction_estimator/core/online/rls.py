"""Recursive least squares on the gradient: the recursive prediction error method, with a prior that is never spent."""

from typing import ClassVar

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.fit.posterior import COLOUR, SLACK
from friction_estimator.core.model.prediction import EXTENSIONS
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.steps import dot, step_along, trusted
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config

RLS = 2
"""Its number."""

PULL_EVERY, LARGEST_PULL, PAID_AT_ONCE = 64, 0.5, 1.0 / 256.0
"""Samples between two pulls towards the prior, and the largest one: above 1 it would overshoot. After an alarm a
256th of what is owed is paid at each, in 16,384 samples: by then what the drive visits is learned anew, and only the
rest goes back to the prior."""


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def project(root, x, projected):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill projected = S' x and return x' P x.

    Only the rows of S where x differs from zero are read: functions that no velocity of late has met are half of all.
    """
    size = root.shape[1]
    for j in range(size):
        projected[j] = 0.0
    for i in range(x.size):
        entry = x[i]
        if entry != 0.0:
            for j in range(size):
                projected[j] += entry * root[i, j]
    total = 0.0
    for j in range(size):
        total += projected[j] * projected[j]
    return total


@njit(no_cpython_wrapper=True, forceinline=True)
def learn_rls(shape, theta, ring, law, moments, status, root, error, clipped, projected, r, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
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
    n, size = theta.size, root.shape[1]
    noise = max(1.0, COLOUR * moments[at.MISFIT_POWER] / law[at.RESIDUAL_VARIANCE])
    floor = law[at.LEAST_LEVERAGE]
    # S is read and written once: as for a step that nothing shortens, and put right by a second update where one does.
    given = clipped / (noise + r)
    whole = _weight(1.0 / noise if clipped == error else _told_by(given, error, r, noise), r, noise, floor)
    gamma = _shrinkage(whole, r)
    power = update(root, projected, gamma, gain, n, size)
    step = trusted(shape, ring, law, status, r, gain, power, given)
    learned = step_along(theta, dot(theta, theta), gain, power, step, status)
    w = 0.0
    if learned:
        w = whole if step == given else _weight(_told_by(step, error, r, noise), r, noise, floor)
    if w != whole:
        excess = gamma - _shrinkage(w, r)
        for i in range(n):
            factor = excess * gain[i]
            for j in range(size):
                root[i, j] += factor * projected[j]
    if learned:
        moments[at.ABSORBED] += w * noise
        moments[at.PULL] += (1.0 - w * noise) / max(moments[at.ABSORBED], 1.0)
    return w


@njit(no_cpython_wrapper=True, forceinline=True)
def _weight(w, r, noise, floor):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the information that a sample adds: no more than leaves it the least leverage."""
    return min(w, max(0.0, 1.0 / (floor * noise) - 1.0 / r)) if floor > 0.0 else w


@njit(no_cpython_wrapper=True, forceinline=True)
def _told_by(step, error, r, noise):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the information of a sample that moves theta by `step`.

    step = error / (rho + r): rho is the noise variance at which this step is the whole one.
    """
    return 1.0 / max(noise, error / step - r) if step != 0.0 else 1.0 / noise


@njit(no_cpython_wrapper=True, forceinline=True)
def _shrinkage(w, r):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    return (1.0 - 1.0 / np.sqrt(1.0 + w * r)) / r if w > 0.0 else 0.0


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def update(root, projected, gamma, gain, n, size):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill gain = S f for f = `projected`, and S <- S - gamma gain f' row by row; return gain' gain."""
    power = 0.0
    for i in range(n):
        row = root[i]
        g = 0.0
        for j in range(size):
            g += row[j] * projected[j]
        gain[i] = g
        power += g * g
        factor = gamma * g
        for j in range(size):
            row[j] -= factor * projected[j]
    return power


@njit(no_cpython_wrapper=True)
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
        r = dot(row, row)
        rise = np.inf
        if 2.0 * seeming * r < 1.0:
            rise = 2.0 * seeming / (1.0 - 2.0 * seeming * r)
        known = True
        for i in range(n):
            gain[i] = dot(root[i], row)
            room = max(0.0, SLACK * dot(prior_root[i], prior_root[i]) - dot(root[i], root[i]))
            if rise * gain[i] * gain[i] > room:
                rise = room / (gain[i] * gain[i])
                known = False
        noise[load, 1] = 0.0 if known else 1.0
        if known:
            step = seeming / (1.0 - seeming * r) * theta[start + load]
            step_along(theta, dot(theta, theta), gain, dot(gain, gain), step, status)
        gamma = (np.sqrt(1.0 + rise * r) - 1.0) / r
        for i in range(n):
            if i != start + load:
                for j in range(n):
                    root[i, j] += gamma * gain[i] * row[j]
        for j in range(n):
            row[j] *= 1.0 + gamma * r


@njit(no_cpython_wrapper=True)
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
            direction[i] = dot(root[i], row)
        off = dot(x, direction) / dot(row, row)
        total += off * off
    return total


@njit(no_cpython_wrapper=True)
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
        force = dot(information[i], gain)
        for j in range(n):
            projected[j] += root[i, j] * force
    for i in range(n):
        gain[i] = dot(root[i], projected)
    step_along(theta, dot(theta, theta), gain, dot(gain, gain), -1.0, status)


@LAWS.named("rls")
class Rls:
    """Recursive prediction error method on the gradient regressor (Ljung and Soderstrom 1983).

    Square-root covariance under a prior that is never spent; see `learn_rls`.
    """

    number: ClassVar[int] = RLS
    keeps_covariance: ClassVar[bool] = True

    @staticmethod
    def constants(config: Config) -> tuple[float, float, float, float]:
        """Least leverage and residual variance."""
        return 0.0, 0.0, 1.0 - config.rls.forgetting_factor, config.prior.residual_deviation**2

    @staticmethod
    def metric(prior: Prior) -> Floats:  # noqa: ARG004 - the covariance is its metric
        """None beside the covariance."""
        return np.zeros(0)
