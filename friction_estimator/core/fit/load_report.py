"""What was learned of the load: value, interval, and whether the drive tells it from friction and from other loads.

With R the information (n / rho) E[x x'] + P0^-1 about all parameters and P its inverse, the column of coefficient j
stands at the angle phi_j to all other columns of the model, the prior taken for what it says:

    sin^2 phi_j = 1 / (R_jj P_jj)

Where the angle is small the drive does not separate the term: many combinations with friction, or with another load,
predict the same, and the value is what prior and chance make of it (Bjoerck and Golub, Math. Comp. 27 (1973) 579). The
interval holds the posterior's deviation, and what a misfit e that repeats with the drive would move the value by if
its correlation with the part of the column that is the term's own were `UNSEEN_CORRELATION`: such a misfit does not
average out (docs/decisions/0072-intervals-of-the-load.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_estimator.core.model.load import LOADS, LoadPart
from friction_estimator.core.model.structure import Model
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Floats

LEAST_SIN2 = 0.005
"""Least sin^2 of the angle (some 4 degrees) at which a term counts as separated."""

LARGEST_SHARE = 0.2
"""Largest force of a term that its interval may leave open, in force units, where it counts as separated."""

UNSEEN_CORRELATION = 0.2
"""Correlation of the misfit with a term's own part of its column that is reckoned with; see benchmarks/load."""

NORMAL_95 = 1.96

ROUNDING = 1e-13
"""Relative variance that keeps a covariance invertible."""


@dataclass(frozen=True)
class LearnedLoad:
    """One coefficient of the load, as the JSON has it.

    Attributes
    ----------
    term : of `load.terms`, with the coefficient where the term has several ("gravity:sin").
    value : learned, in `unit`.
    ci95 : its 95 % interval; None where it is not separated, or not known.
    separated : whether the drive tells it from friction and from the other loads.
    reason : why not; empty where it is.
    """

    term: str
    value: float
    unit: str
    ci95: tuple[float, float] | None
    separated: bool
    reason: str

    def told(self, quantities: Quantities) -> tuple[str, str]:
        """Return value and interval in words, in the reader's units; no interval where there is none.

        >>> load = LearnedLoad("inertia", 2.0, "kg", (1.9, 2.1), True, "")
        >>> load.told(Quantities())
        ('2 kg', '[1.9, 2.1] kg')
        """
        unit = LOADS[self.term.partition(":")[0]].unit
        ends = "" if self.ci95 is None else quantities.range_text(self.ci95, unit, ".5g")
        return quantities.text(self.value, unit, ".5g").removesuffix(" 1"), ends.removesuffix(" 1")

    def text(self, quantities: Quantities) -> str:
        """Value, unit and interval in words, or why there is none."""
        value, ends = self.told(quantities)
        return f"{value}, 95 % interval {ends}" if ends else f"{value}: not separated, {self.reason}"


def learned_loads(
    model: Model, theta: Floats, covariance: Floats | None, weight: float, misfit: float
) -> list[LearnedLoad]:
    """Return what is known of each unknown term.

    Parameters
    ----------
    theta, covariance : (n,) and (n, n), parameters and their posterior covariance; None for laws that keep none.
    weight : n / rho, what the information has of E[x x'].
    misfit : rms of the errors that are left, in force units.
    """
    parts, scales = model.load.unknown, model.load.scales
    values = theta[model.load_places] * scales
    units = [model.config.quantities.si.unit(part.load.unit) for part in parts]
    if covariance is None:
        reason = "this law keeps no covariance: rls and identify tell"
        rows = zip(parts, values, units, strict=True)
        return [LearnedLoad(part.label, float(value), unit, None, False, reason) for part, value, unit in rows]
    information = _inverse(covariance)
    start = model.load_places.start
    found = []
    for i, (part, value, unit, scale) in enumerate(zip(parts, values, units, scales, strict=True)):
        j = start + i
        variance, alone = float(covariance[j, j]), float(information[j, j])
        own = 1.0 / math.sqrt(variance * weight) if weight > 0.0 else 0.0  # rms of the column's own part
        whole = math.sqrt(alone / weight) if weight > 0.0 else 0.0
        half = math.hypot(NORMAL_95 * math.sqrt(variance), UNSEEN_CORRELATION * misfit / own if own > 0.0 else math.inf)
        separated = 1.0 / (variance * alone) >= LEAST_SIN2 and half * whole <= LARGEST_SHARE
        ends = (float(value - half * scale), float(value + half * scale))
        reason = "" if separated else _reason(parts, i, covariance, information, start)
        found.append(LearnedLoad(part.label, float(value), unit, ends if separated else None, separated, reason))
    return found


def _inverse(matrix: Floats) -> Floats:
    """Return the inverse of a covariance or information, (n, n), whatever the units of its rows."""
    scale = np.sqrt(np.diag(matrix))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale) + ROUNDING * np.eye(scale.size))
    return np.asarray(inverse / np.outer(scale, scale))


def _reason(parts: Sequence[LoadPart], i: int, covariance: Floats, information: Floats, start: int) -> str:
    """Say what the term is not told from, and the drive that helps."""
    places = np.arange(start, start + len(parts))
    friction = np.delete(np.arange(covariance.shape[0]), places)
    among = np.append(friction, places[i])
    # P of friction and this term were the others known.
    alone = _inverse(information[np.ix_(among, among)])
    apart = 1.0 / (alone[-1, -1] * information[places[i], places[i]])
    deviation = np.sqrt(np.diag(covariance)[places])
    alike = np.abs(covariance[places[i], places] / deviation / deviation[i])
    alike[i] = 0.0
    advice = LOADS[parts[i].name].advice
    if len(parts) > 1 and apart >= LEAST_SIN2 and alike.max() > 0.5:
        other = parts[int(np.argmax(alike))].label
        return f"on this drive {other} acts alike, only both together are known: {advice}"
    return f"on this drive friction can act alike: {advice}"
