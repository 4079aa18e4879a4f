"""Compiled: what the steps of several laws have in common. x is the regressor of a sample, the gradient of its
prediction.

These, and the laws' own steps, are called by `kernels.run` only, and compiled into it: kept with it, not apart, without
a wrapper for callers in Python.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.model.prediction import HEAD, TAPS, WEIGHTS
from friction_estimator.core.online import workspace as at
from friction_estimator.core.settings.groups import LARGEST_PARAMETER


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def dot(a, b):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return a' b, summed in the order that vectorises (the same for every call)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def powers(a, b):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return a' a and b' b, in one go."""
    of_a = of_b = 0.0
    for i in range(a.size):
        of_a += a[i] * a[i]
        of_b += b[i] * b[i]
    return of_a, of_b


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def tap_power(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return A' A."""
    power = 0.0
    for i in range(shape[TAPS]):
        power += theta[i] * theta[i]
    return power


@njit(no_cpython_wrapper=True, forceinline=True)
def normalise_taps(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Divide A by its norm (the paper's A = A*/||A*||); return the norm, 0 where A vanished and was left alone."""
    taps = shape[TAPS]
    norm = np.sqrt(tap_power(shape, theta))
    if norm > 1e-12:
        share = 1.0 / norm
        for i in range(taps):
            theta[i] *= share
        return norm
    return 0.0


@njit(no_cpython_wrapper=True, forceinline=True)
def step_along(theta, size, direction, power, gain, status):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta += gain direction, unless |theta| could leave the guarded range: then nothing is learned here.

    `size` is theta' theta, `power` direction' direction. Most steps are far from the bound, and seen to be so without
    a root: (a + b)^2 <= 2 (a^2 + b^2).
    """
    if not 2.0 * (size + gain * gain * power) < LARGEST_PARAMETER**2:
        reach = np.sqrt(size) + abs(gain) * np.sqrt(power)
        if not reach < LARGEST_PARAMETER:  # also true for NaN
            status[at.GUARDED] += 1
            return False
    for i in range(theta.size):
        theta[i] += gain * direction[i]
    return True


@njit(no_cpython_wrapper=True, forceinline=True)
def trusted(shape, ring, law, status, along, direction, power, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return `gain`, shortened until the model's bilinear term agrees with its linearisation.

    Along gain * direction the prediction changes by gain x' direction + gain^2 sum_i dA_i dW' Psi[k-i] exactly. The
    second term, which the law does not know of, is kept below half of the first: then a step that removes at most the
    whole error of the linearised model never enlarges the error on its own sample. Mostly that is seen without the
    sum: it is below |dW| max |Psi| sum_i |dA_i|.

    Parameters
    ----------
    along : x' direction. power : direction' direction.
    """
    total = 0.0
    for i in range(shape[TAPS]):
        total += abs(direction[i])
    if abs(gain) * total * np.sqrt(power * law[at.ROW_POWER]) < 0.49 * abs(along):
        return gain
    return _shortened(shape, ring, status, along, direction, gain)


@njit(no_cpython_wrapper=True)
def _shortened(shape, ring, status, along, direction, gain):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    taps, weights = shape[TAPS], shape[WEIGHTS]
    step = direction[taps : taps + weights]
    bilinear = 0.0
    place = status[HEAD] % taps
    for i in range(taps):
        bilinear += direction[i] * dot(step, ring[place])
        place = place - 1 if place > 0 else taps - 1
    linear, bilinear = abs(gain * along), gain * gain * abs(bilinear)
    if bilinear <= 0.5 * linear:
        return gain
    status[at.GUARDED] += 1
    return gain * 0.5 * linear / bilinear
