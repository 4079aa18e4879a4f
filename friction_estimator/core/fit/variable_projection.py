"""Least cost over the FIR taps with the rest eliminated (variable projection, Golub and Pereyra 1973)."""

from typing import Any

import numpy as np
from scipy.optimize import minimize

from friction_estimator.core.fit.moments import Moments, solve
from friction_estimator.core.sample import Floats

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
