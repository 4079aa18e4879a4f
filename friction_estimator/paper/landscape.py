"""The claim of a quadratic cost with a unique global minimum: orbits, saddles, other minima, and where lms ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from friction_estimator.core.fit.moments import Moments, gather, solve
from friction_estimator.core.fit.variable_projection import NEWTON, reduced_hessian, refine, start_taps
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Floats
from friction_estimator.paper.claims import Claim, verdict
from friction_estimator.paper.study import Plan, derived, record
from friction_estimator.rig.drive import CONDITIONS

RANDOM_STARTS = 16
SUMMIT_STARTS = 4
LMS_STARTS = 8

STATIONARY = 1e-6
"""Gradient of the cost, in squared normalised units with |A| = 1, below which a point counts as stationary."""

APART = 1e-3
"""Relative difference of cost beyond which two ends are different."""

SETTLED = 0.01
"""A run of lms has come to rest where a Newton step promises less than this share of its cost."""


@dataclass(frozen=True)
class Stationary:
    """A stationary point: cost, gradient norm, extreme eigenvalues of the Hessian of the cost.

    Attributes
    ----------
    cost_over_lowest : C over that of the best minimum found.
    gradient_norm : of the full cost.
    lowest_eigenvalue, highest_eigenvalue : of the full Hessian, the flat scale orbit included.
    negative_reduced : negative eigenvalues of the Hessian in A with the rest at its optimum.
    is_minimum : none of them.
    """

    cost_over_lowest: float
    gradient_norm: float
    lowest_eigenvalue: float
    highest_eigenvalue: float
    negative_reduced: int
    is_minimum: bool


def examine(plan: Plan, condition: str, model_type: str, seed: int = 0) -> dict[str, Any]:
    """Return what is found in the cost of one recording: orbits, curvature, stationary points, ends of lms."""
    samples = record(plan, condition, seed)
    config = derived(samples, model_type, model__law="lms")
    moments = gather(Model(config), samples)
    generator = np.random.default_rng([seed, 11])
    best = min((refine(moments, taps) for taps in start_taps(moments, generator)), key=moments.cost)
    lowest = moments.cost(best)
    random_taps = generator.standard_normal((RANDOM_STARTS, moments.taps))
    ends = [_describe(moments, refine(moments, taps), lowest) for taps in random_taps]
    summits = [_describe(moments, _summit(moments, taps), lowest) for taps in random_taps[:SUMMIT_STARTS]]
    return {
        "orbits": _orbits(moments, best),
        "not_quadratic": _not_quadratic(moments, best),
        "origin": _describe(moments, moments.eliminate(np.zeros(moments.taps)), lowest),
        "minima": _distinct([end for end in ends if end.is_minimum and end.gradient_norm < STATIONARY]),
        "others": _distinct([top for top in summits if not top.is_minimum and top.gradient_norm < STATIONARY]),
        "lms": [
            _lms_end(moments, samples, config, taps / np.linalg.norm(taps), lowest) for taps in random_taps[:LMS_STARTS]
        ],
    }


def _orbits(moments: Moments, theta: Floats) -> dict[str, float]:
    """Return the largest relative change of cost along the sign and scale orbits, and how far apart the points are."""
    a, w = slice(0, moments.taps), slice(moments.taps, moments.taps + moments.weights)
    cost, change, apart = moments.cost(theta), 0.0, 0.0
    for factor in (-1.0, 0.5, 2.0, 10.0):
        moved = theta.copy()
        moved[a] *= factor
        moved[w] /= factor
        change = max(change, abs(moments.cost(moved) / cost - 1.0))
        apart = max(apart, float(np.linalg.norm(moved - theta) / np.linalg.norm(theta)))
    return {"largest_relative_change_of_cost": change, "largest_relative_distance": apart}


def _not_quadratic(moments: Moments, theta: Floats) -> dict[str, float]:
    """Compare the cost on the segment from theta to its mirror image (-A, -W) with what a convex function allows."""
    a_and_w = slice(0, moments.taps + moments.weights)
    mirror, middle = theta.copy(), theta.copy()
    mirror[a_and_w] *= -1.0
    middle[a_and_w] = 0.0
    ends = moments.cost(theta), moments.cost(mirror)
    line = [moments.cost(theta + s * (mirror - theta)) for s in (0.0, 0.25, 0.5, 0.75, 1.0)]
    fourth = abs(float(np.dot([1, -4, 6, -4, 1], line)))
    return {
        "cost_at_either_end": float(np.mean(ends)),
        "cost_halfway": moments.cost(middle),
        "fourth_difference_over_largest_cost": fourth / max(line),
    }


def _describe(moments: Moments, theta: Floats, lowest: float) -> Stationary:
    spectrum = np.linalg.eigvalsh(moments.hessian(theta))
    taps = theta[: moments.taps]
    if np.any(taps):
        reduced = np.linalg.eigvalsh(reduced_hessian(moments, theta))
        negative = int(np.count_nonzero(reduced < -1e-7 * max(1e-6, float(np.abs(reduced).max()))))
    else:
        negative = int(np.count_nonzero(spectrum < -1e-9 * np.abs(spectrum).max()))
    return Stationary(
        cost_over_lowest=moments.cost(theta) / lowest,
        gradient_norm=float(np.linalg.norm(moments.gradient(theta))),
        lowest_eigenvalue=float(spectrum[0]),
        highest_eigenvalue=float(spectrum[-1]),
        negative_reduced=negative,
        is_minimum=negative == 0,
    )


def _summit(moments: Moments, taps: Floats) -> Floats:
    """Return the stationary point at a local maximum over A of the least cost that A allows.

    That cost is a smooth function on the projective space of directions of A, which is compact: its maximum exists
    and is stationary, and there are at least as many stationary points as taps (Lusternik and Schnirelmann 1934).
    """

    def height(a: Floats) -> float:
        return -moments.cost(moments.eliminate(a))

    def slope(a: Floats) -> Floats:
        return -moments.gradient(moments.eliminate(a))[: moments.taps]

    def bend(a: Floats) -> Floats:
        return -reduced_hessian(moments, moments.eliminate(a))

    start = taps / np.linalg.norm(taps)
    answer = minimize(height, start, jac=slope, hess=bend, method="trust-exact", options=NEWTON)
    end = np.asarray(answer.x, np.float64)
    return moments.eliminate(end / np.linalg.norm(end))


def _lms_end(moments: Moments, samples: Any, config: Any, taps: Floats, lowest: float) -> dict[str, Any]:
    """Run lms from the given unit vector of taps; say where it ended and whether it came to rest.

    A Newton step at the end promises g' H^-1 g / 2 (Gauss-Newton Hessian, which is never indefinite).
    """
    estimator = Estimator(config.updated({"learned.fir_taps": taps}))
    estimator.run(samples)
    theta = estimator.parameters.theta
    gradient = moments.gradient(theta)
    promised = 0.5 * float(gradient @ solve(moments.gauss_newton(theta), gradient))
    cost = moments.cost(theta)
    return {
        "cost_over_lowest": cost / lowest,
        "gradient_norm": float(np.linalg.norm(gradient)),
        "share_a_newton_step_promises": promised / cost,
        "stationary": promised < SETTLED * cost,
    }


def _distinct(points: Sequence[Stationary]) -> list[Stationary]:
    """Return one point for each cost, lowest first."""
    kept: list[Stationary] = []
    for point in sorted(points, key=lambda p: p.cost_over_lowest):
        if not kept or point.cost_over_lowest > (1.0 + APART) * kept[-1].cost_over_lowest:
            kept.append(point)
    return kept


def unique_minimum(plan: Plan, found: dict[tuple[str, str], dict[str, Any]]) -> Claim:
    """Judge the claim: refuted where the cost is not quadratic or different parameters share the least cost."""
    orbits = all(f["orbits"]["largest_relative_change_of_cost"] < 1e-6 for f in found.values())
    apart = all(f["orbits"]["largest_relative_distance"] > 0.1 for f in found.values())
    quartic = all(
        f["not_quadratic"]["cost_halfway"] > 2.0 * f["not_quadratic"]["cost_at_either_end"]
        and f["not_quadratic"]["fourth_difference_over_largest_cost"] > 1e-6
        for f in found.values()
    )
    origins = [f["origin"] for f in found.values()]
    others = sum(len(f["others"]) for f in found.values()) + sum(
        o.gradient_norm < STATIONARY and o.lowest_eigenvalue < 0.0 for o in origins
    )
    minima = {f"{model} {condition}": len(f["minima"]) for (condition, model), f in found.items()}
    several = [name for name, count in minima.items() if count > 1]
    ends = [end for f in found.values() for end in f["lms"]]
    rest = [end for end in ends if end["stationary"]]
    trapped = [end for end in rest if end["cost_over_lowest"] > 1.0 + APART]
    shared = orbits and apart
    lms = (
        f"{len(trapped)} of {len(ends)} lms runs came to rest at a higher cost"
        if trapped
        else f"of {len(ends)} lms runs {len(ends) - len(rest)} were still descending at the end and none rests at a "
        "higher cost, so lms is slow here rather than stuck"
    )
    return Claim(
        id="quadratic_cost_with_unique_minimum",
        statement="C(Theta) has a unique global minimum, since it is a quadratic function of A and W.",
        experiment=f"Seed 0 of conditions {', '.join(CONDITIONS)}, both models, {plan.seconds:g} s at {plan.rate_hz:g} "
        "Hz: cost, gradient and Hessian exact from the recording's second moments. Orbits (-A, -W) and (cA, W/c); cost "
        "on the segment between a minimum and its mirror image, where a quadratic has no fourth difference and a "
        f"convex function no hill; the point A = W = 0 and local maxima over A reached from {SUMMIT_STARTS} random "
        f"taps (stationary: gradient below {STATIONARY:g}); minima by trust-region descent from {RANDOM_STARTS} random "
        f"taps; lms from {LMS_STARTS} of them, at rest where a Newton step promises less than {100 * SETTLED:g} % of "
        "the cost. Refuted where orbits and hill are found in every case.",
        numbers={
            "cases": {f"{model} {condition}": f for (condition, model), f in found.items()},
            "stationary_points_that_are_no_minima": others,
            "distinct_minima_up_to_orbits": minima,
            "lms_runs": len(ends),
            "lms_runs_at_rest": len(rest),
            "lms_runs_at_rest_above_the_lowest_cost": len(trapped),
        },
        verdict=verdict([not (shared and quartic)] if shared == quartic else [True, False]),
        why=f"{'The' if shared else 'Not always the'} same cost is met at (cA, W/c) for every c and either sign, "
        f"{'with' if quartic else 'without'} a hill between, {others} stationary points are no minima, "
        f"more than one minimum up to these orbits exists for {', '.join(several) or 'no case'}, and {lms}.",
    )
