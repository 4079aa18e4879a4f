"""Where a parameter is best: over a bracket, over jumps, and over the comb of minima of a time of the whole force."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from friction_estimator.diagnosis.base_problem import Coefficients
from friction_estimator.effects.grids import SHORTEST_TIME

EVALUATIONS, TOLERANCE = 14, 1e-4
"""Most evaluations over a bracket, and the share of its logarithm at which they end."""

ZOOM_POINTS, ZOOM_LEVELS = 13, 3

HALVINGS = 12
"""Halvings that find the edge of a plateau."""

SCAN_EVALUATIONS, SCAN_TOLERANCE = 8, 1e-3
"""The same between two times of a scan, where the tolerance is absolute."""

SCANNED = (0.1, 0.3, 0.6, 1.0, 2.0, 4.0)
"""Times of the whole force that are tried first, in samples."""

LADDER = 1.5
"""Ratio of the longer times that are tried of a force that is ahead, while each fits better than the one before: a
memory of a few samples can take back what the last one is too long."""

GRID = 2.0
"""Ratio of screening's times: how far the true one may lie from the best of them."""

MEMORY_MOVES = 6
"""Most times that the base's memory is moved over into a time of the whole force."""

MOVED, MOVED_AHEAD = 0.05, 0.005
"""Share of the time, or of a sample, below which no more is moved over: of a force that is late, and of one ahead."""

NEIGHBOURS = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75)
"""Samples beside the end of that walk that are tried too."""

DIPS = 2
"""Dips among the times tried that are looked into: the well of a sharp drive is a tenth of a sample wide."""

LEFT_OVER = 0.8
"""Mean delay of the memory left, in samples, from which a sample more is tried."""

WALKED = 4
"""Most steps of a walk over plateaus."""

AT_END = 1e-9
"""Share of a bracket within which a value stands at its end."""

Cost = Callable[[float], float]
Fit = TypeVar("Fit")


def over_bends(cost: Cost, low: float, high: float) -> float:
    """Return the place of least cost between two positive bounds."""
    return _bounded(cost, low, high, EVALUATIONS, TOLERANCE * float(np.log(high / low)))[0]


def over_jumps(cost: Cost, low: float, high: float) -> float:
    """Return the middle of the best plateau on a grid that zooms in on the best of the one before."""
    best = 0.5 * (low + high)
    for _ in range(ZOOM_LEVELS):
        points = np.linspace(low, high, ZOOM_POINTS)
        costs = np.array([cost(float(p)) for p in points])
        flat = np.flatnonzero(costs <= costs.min() + 1e-9 * abs(costs.min()))
        first = flat[0]
        last = first + int(np.argmax(np.append(np.diff(flat), 2) > 1))
        best = float(0.5 * (points[first] + points[last]))
        reach = (high - low) / (ZOOM_POINTS - 1)
        low, high = max(low, points[first] - reach), min(high, points[last] + reach)
    return best


def plateau(same: Callable[[float], bool], place: float, low: float, high: float) -> tuple[float, float]:
    """Return the ends of the plateau of a place, within bounds.

    `same` says of another place whether it lies on the same plateau.

    >>> [round(v, 2) for v in plateau(lambda v: int(v) == 3, 3.2, 0.0, 10.0)]
    [3.0, 4.0]
    """
    edges = []
    for end in (low, high):
        inside, outside = place, end
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if same(middle) else (inside, middle)
        edges.append(outside)
    return edges[0], edges[1]


def beside(same: Callable[[float, float], bool], place: float, low: float, high: float) -> list[float]:
    """Return the middle of each of the two plateaus beside that of a place, within bounds.

    `same` says of two places whether they lie on one plateau. A narrow plateau between wide ones is not passed over.

    >>> [round(v, 1) for v in beside(lambda a, b: int(a) == int(b), 3.2, 0.0, 10.0)]
    [2.5, 4.5]
    """
    first, last = plateau(lambda at: same(at, place), place, low, high)
    found = []
    for next_to in (first, last):
        if low < next_to < high:
            ends = plateau(lambda at, there=next_to: same(at, there), next_to, low, high)  # type: ignore[misc]
            found.append(0.5 * (ends[0] + ends[1]))
    return found


def at_end(value: float, low: float, high: float) -> bool:
    """Return whether a value stands at an end of its bracket.

    >>> at_end(0.5, 0.5, 2.0), at_end(0.6, 0.5, 2.0)
    (True, False)
    """
    return min(value - low, high - value) <= AT_END * (high - low)


def downhill(found: Fit, neighbours: Callable[[Fit], list[Fit]], cost: Callable[[Fit], float]) -> Fit:
    """Return the fit from which no neighbour costs less, at most `WALKED` steps from the first one.

    >>> downhill(0, lambda at: [at - 1, at + 1], lambda at: abs(at - 3.0))
    3
    """
    for _ in range(WALKED):
        best = min([found, *neighbours(found)], key=cost)
        if best is found:
            break
        found = best
    return found


def best_time(
    fitted: Callable[[float], Coefficients],
    start: Coefficients,
    mean_delay: Callable[[Coefficients], float],
    step_s: float,
    ahead: bool = False,
    longest_s: float = np.inf,
    hint_s: float = 0.0,
) -> float:
    """Return the time of the whole force at which everything else fits best, s.

    Parameters
    ----------
    fitted : the fit at a time. start : the fit without it. mean_delay : of the base's memory in a fit, samples.
    step_s : sample period. ahead : the time is one by which the force is ahead, as for a velocity that is late: the
        memory can take up nothing of it, and what it delays the time has to make up for. longest_s : that the record
        can show. hint_s : where it is, or where screening sees it, tried, too: so no search ends worse than it began,
        and where the force is ahead nothing gets better far below the true time.
    """
    tried = _Tried(fitted)
    for share in SCANNED:
        tried(share * step_s)
    last = max(SCANNED) * step_s
    while ahead and LADDER * last < longest_s and tried.is_best(last):
        last *= LADDER
        tried(last)
    if 0.0 < hint_s <= longest_s:
        tried(hint_s)
        if hint_s > last and tried.is_best(hint_s):
            tried.between(hint_s / GRID, min(hint_s * GRID, longest_s))
    # What the base's memory has taken up belongs to the whole force's time: moved over until none is left. No memory
    # takes up a force that is ahead: it delays what too long a time has put too far ahead, and the wells are narrow.
    value, left, way, enough = 0.0, start, 1.0, MOVED
    if ahead:
        value = tried.best
        left, way, enough = tried(value), -1.0, MOVED_AHEAD
    for _ in range(MEMORY_MOVES):
        more = way * mean_delay(left) * step_s
        if (abs(more) if ahead else more) <= enough * max(value, step_s) or value + more <= 0.0:
            break
        value += more
        left = tried(value)
    # Beside whole samples more an FIR does as well: neighbours of the end of that walk.
    if value > step_s:  # and so is each of them above zero
        for share in NEIGHBOURS:
            tried(value + share * step_s)
    # Nothing was tried below the shortest yet. Beside a wrong memory screening sees a short time as a longer one.
    while tried.shortest >= GRID * SHORTEST_TIME * step_s and tried.is_best(tried.shortest):
        tried(tried.shortest / GRID)
    for low, high in _dips(tried.costs())[:DIPS]:
        tried.between(low, high)
    best = tried.best
    while not ahead and mean_delay(tried(best)) > LEFT_OVER:
        # One sample more and one sample less of memory fit nearly as well: a comb of minima, one sample apart.
        other = tried.between(best + 0.75 * step_s, best + 1.25 * step_s)
        if not tried.is_best(other):
            break
        best = other
    return best


class _Tried:
    """The times of the whole force that were tried, and the fits there.

    Parameters
    ----------
    fitted : the fit at a time.
    """

    def __init__(self, fitted: Callable[[float], Coefficients]) -> None:
        self._fitted = fitted
        self._fits: dict[float, Coefficients] = {}

    def __call__(self, time_s: float) -> Coefficients:
        """Return the fit at a time."""
        if time_s not in self._fits:
            self._fits[time_s] = self._fitted(time_s)
        return self._fits[time_s]

    def between(self, low_s: float, high_s: float) -> float:
        """Try times between two others, and return the best of them, the only one that is kept."""
        inside: dict[float, Coefficients] = {}

        def cost(time_s: float) -> float:
            inside[time_s] = self._fitted(time_s)
            return inside[time_s].cost

        best, _ = _bounded(cost, low_s, high_s, SCAN_EVALUATIONS, SCAN_TOLERANCE)
        self._fits[best] = inside[best]
        return best

    def is_best(self, time_s: float) -> bool:
        """Return whether no other time that was tried costs as little."""
        return all(self._fits[time_s].cost < fit.cost for time, fit in self._fits.items() if time != time_s)

    def costs(self) -> list[tuple[float, float]]:
        """Return the times and what each costs, the shortest first."""
        return [(time, self._fits[time].cost) for time in sorted(self._fits)]

    @property
    def best(self) -> float:
        """The time of least cost."""
        return min(self.costs(), key=lambda tried: tried[1])[0]

    @property
    def shortest(self) -> float:
        """The shortest time."""
        return min(self._fits)


def _dips(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the neighbours of each point (place, cost) that lies below both of its own, the lowest first.

    >>> _dips([(1.0, 5.0), (2.0, 4.0), (3.0, 6.0), (4.0, 3.0)])
    [(3.0, 4.0), (1.0, 3.0)]
    """
    ends = [points[0], *points, points[-1]]
    dips = [
        (here[1], before[0], after[0])
        for before, here, after in zip(ends, points, ends[2:], strict=False)
        if here[1] <= min(before[1], after[1])
    ]
    return [(low, high) for _, low, high in sorted(dips)]


def _bounded(cost: Cost, low: float, high: float, evaluations: int, tolerance: float) -> tuple[float, float]:
    """Return place and cost of the least cost between two positive bounds, sought over the logarithm."""
    found = minimize_scalar(
        lambda u: cost(float(np.exp(u))),
        bounds=(np.log(low), np.log(high)),
        method="bounded",
        options={"maxiter": evaluations, "xatol": tolerance},
    )
    return float(np.exp(found.x)), float(found.fun)
