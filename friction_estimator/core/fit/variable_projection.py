"""The free fit, without a prior: least cost over the FIR taps with the rest eliminated (Golub and Pereyra 1973).

It shows what the cost surface looks like (the paper's claims are about it) and how well a structure could do on one
record. As a model of the machine use `batch`: a free fit to one drive need not hold on the next.

The scale orbit (c A, W / c) is closed by |A| = 1, the sign by a positive static gain of H.
"""

from typing import Any

import numpy as np
from scipy.linalg import eigh

from friction_estimator.core.fit.moments import Moments, solve
from friction_estimator.core.sample import Floats

RANDOM_STARTS = 3
"""Starts at random taps beside the constructed ones."""

START_RIDGES = (1.0, 1e2, 1e4)
"""Multiples of the ridge under which the over-parameterised problem is solved: its many coefficients need more."""

NEWTON: Any = {"gtol": 1e-10, "maxiter": 200, "initial_trust_radius": 0.1, "max_trust_radius": 1.0}
"""Of the refinement: largest gradient at the end, in squared normalised units for a unit vector of taps; most steps
(ten to forty are usual); trust radii."""


def refine(moments: Moments, taps: Floats, options: Any = NEWTON) -> Floats:
    """Return theta at the local minimum that the trust-region Newton method reaches from `taps`.

    The reduced cost phi(A) = min over the rest of C has gradient C_A (the rest is at its optimum) and Hessian
    C_AA - C_AR C_RR^-1 C_RA. phi does not change with the length of A.
    """
    if moments.taps == 1:
        return moments.eliminate(np.ones(1))
    from scipy.optimize import minimize  # noqa: PLC0415 - slow to import

    memory: dict[bytes, Floats] = {}

    def eliminated(a: Floats) -> Floats:
        key = a.tobytes()
        if key not in memory:
            memory.clear()
            memory[key] = moments.eliminate(a)
        return memory[key]

    def cost(a: Floats) -> float:
        return moments.cost(eliminated(a))

    def gradient(a: Floats) -> Floats:
        return moments.gradient(eliminated(a))[: moments.taps]

    def hessian(a: Floats) -> Floats:
        return reduced_hessian(moments, eliminated(a))

    start = taps / np.linalg.norm(taps)
    answer = minimize(cost, start, jac=gradient, hess=hessian, method="trust-exact", options=options)
    end = np.asarray(answer.x, np.float64)
    return moments.eliminate(end / np.linalg.norm(end))


def reduced_hessian(moments: Moments, theta: Floats) -> Floats:
    """Return the Hessian of the cost with respect to A, the rest following at its optimum, (taps, taps)."""
    hessian, q = moments.hessian(theta), moments.taps
    follow = solve(hessian[q:, q:], hessian[q:, :q])
    reduced = hessian[:q, :q] - hessian[:q, q:] @ follow
    return np.asarray(0.5 * (reduced + reduced.T))


def start_taps(moments: Moments, generator: np.random.Generator) -> list[Floats]:
    """Return starts for A: rank-one factors of the over-parameterised solution, no dynamics, and random ones."""
    memoryless = np.zeros(moments.taps)
    memoryless[0] = 1.0
    starts = [memoryless]
    if moments.taps == 1:
        return starts
    stride = (moments.gram.shape[0] - moments.extensions) // moments.taps
    output = moments.gram[: moments.weights, : moments.weights]  # E[Psi Psi']: |w|^2 in it is the power of g
    for factor in START_RIDGES:
        penalised = moments.gram + np.diag((factor - 1.0) * moments.ridge)
        lagged = solve(penalised, moments.cross)[: moments.taps * stride].reshape(moments.taps, stride)
        free = lagged[:, : moments.weights]
        _, vectors = eigh(free @ output @ free.T)
        starts.append(vectors[:, -1])
    return starts + list(generator.standard_normal((RANDOM_STARTS, moments.taps)))


def on_gauge(moments: Moments, theta: Floats) -> Floats:
    """Return the point of theta's orbit with |A| = 1 and sum(A) >= 0 (the largest tap positive where the sum is 0)."""
    theta = theta.copy()
    taps = theta[: moments.taps]
    length = float(np.linalg.norm(taps))
    if length > 0.0:
        gain = float(taps.sum())
        decisive = gain if abs(gain) > 1e-6 * length else float(taps[np.argmax(np.abs(taps))])
        factor = float(np.copysign(length, decisive))
        theta[: moments.taps] /= factor
        theta[moments.taps : moments.taps + moments.weights] *= factor
    return theta
