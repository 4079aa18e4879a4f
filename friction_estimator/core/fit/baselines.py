"""Static friction curves, the baselines that a learned model is judged beside.

Four curves of velocity alone, each the textbook's, each fitted as a competent engineer would fit it:

    coulomb_viscous             f = o + Fc S + Fv v
    coulomb_viscous_asymmetric  f = Fc± S + Fv± v
    stribeck                    f = o + S (Fc + dF E) + Fv v
    stribeck_asymmetric         f = S (Fc± + dF± E) + Fv± v

    S = tanh(v / w),   E = exp(-|v / vs|^p),   ± the direction of v

(Coulomb and viscous friction, the Stribeck term in the form of Bo and Pavelescu 1982 with its usual exponents 1 and 2;
Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30 (1994) 1083, sections 2 and 5; tanh for sign as in every
simulation.) An offset o cannot be told from a difference of Fc+ and Fc- but within a few widths of v = 0, so the
asymmetric curves have none: (Fc+ - Fc-) / 2 is what the others call o, and they pass through 0 at v = 0.

All signs are free. Fv is negative on the falling branch of a Stribeck curve, dF where friction rises to its level
slowly, and a negative Fc says that the sign of the data is wrong: clipping it at 0 would hide that and fit worse.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.points import Bins, Points
from friction_estimator.core.metrics import Prediction, nrmse
from friction_estimator.core.sample import Bools, Floats

LEAST_SAMPLES = 30
"""Fewer samples than this are not fitted: the richest curve has 8 parameters and a choice of exponent."""

NARROWEST, WIDEST = 1e-4, 0.5
"""Bounds of the width w, in units of the top speed: a sign at any sensor's resolution, to half of the range."""

EXPONENTS = (1.0, 2.0)
"""Exponents p of the Stribeck term, the first is kept at a tie."""

GRID = 12
"""Starts an axis: neighbours lie a factor of 2.2 apart, well inside the valley of a logarithm."""

REFINED = 3
"""Starts that are refined, the best of the grid: where few samples are slow, the valley may have another beside it."""

RIDGE_COULOMB, RIDGE_VISCOUS, RIDGE_STRIBECK, RIDGE_OFFSET = 1e-5, 1e-4, 3e-3, 1e-3
"""Ridge of each coefficient of unit columns, as the rms error that a coefficient of 1 is worth.

Where data tell the coefficients apart their squares (1e-10 to 1e-5) are far below any noise; where they do not, the
order decides who takes the force: the Coulomb level, then the viscous slope, then an offset. The Stribeck column
vanishes at all but low speeds; its ridge keeps a handful of slow samples from lifting the curve at 0 to the sky.
"""

RIDGE_HALF_DIFFERENCE = 10.0
"""Ridge of half the difference of the directions over that of their mean: the mean takes what either could."""

RIDGE_NEVER = 1e3
"""Ridge of a coefficient that is not to be fitted."""

NARROW = 6.0
"""Chi-square that the widest of widths must gain over the narrowest, log-linear between: else noise draws it wide."""


@dataclass(frozen=True)
class Form:
    """A curve as a sum of columns that are linear in its coefficients, in units of the top speed.

    Attributes
    ----------
    name : the curve's name.
    stribeck : whether it has the Stribeck term.
    asymmetric : whether each direction has its own coefficients (half their difference is fitted beside their mean).
    """

    name: str
    stribeck: bool
    asymmetric: bool

    @property
    def odd(self) -> dict[str, float]:
        """Parameters that belong to odd columns, with their ridge."""
        odd = {"coulomb_N": RIDGE_COULOMB, "viscous_N_s_m": RIDGE_VISCOUS}
        return odd | {"stribeck_N": RIDGE_STRIBECK} if self.stribeck else odd

    @property
    def size(self) -> int:
        """Number of coefficients m."""
        return 2 * len(self.odd) if self.asymmetric else len(self.odd) + 1

    def ridge(self, both_ways: bool) -> Floats:
        """Return the ridge of each coefficient, (m,)."""
        mean = list(self.odd.values())
        rest = [RIDGE_HALF_DIFFERENCE * r for r in mean] if self.asymmetric else [RIDGE_OFFSET]
        return np.array(mean + (rest if both_ways else [RIDGE_NEVER] * len(rest)))

    def columns(self, x: Floats, shape: "Shape") -> Floats:
        """Return the columns, (m, n), at velocities `x` (n,) in units of the top speed; none exceeds max(1, |x|).

        Odd ones first: S, x and S E; then |S|, |x|, |S| E for half the difference of the directions, or 1 for o.
        """
        out = np.empty((self.size, x.size))
        terms = len(self.odd)
        out[0] = np.tanh(x / shape.width)
        out[1] = x
        if self.stribeck:
            out[2] = out[0] * np.exp(-(np.abs(x / shape.stribeck) ** shape.exponent))
        if self.asymmetric:
            np.abs(out[:terms], out=out[terms:])
        else:
            out[terms] = 1.0
        return out


@dataclass(frozen=True)
class Shape:
    """What a curve is not linear in: width w, Stribeck speed vs (both in units of the top speed) and exponent p."""

    width: float
    stribeck: float = 1.0
    exponent: float = 2.0

    @classmethod
    def at(cls, place: Floats, exponent: float) -> "Shape":
        """Return the shape at `place` in the unit square.

        The first coordinate is log w from NARROWEST to WIDEST, the second, if any, log vs from w to 1: a Stribeck term
        narrower than the sign it is multiplied with is a spike that no instrument sees.
        """
        width = NARROWEST * (WIDEST / NARROWEST) ** float(place[0])
        return cls(width, width ** (1.0 - float(place[1])) if place.size > 1 else 1.0, exponent)


BASELINES: Mapping[str, Form] = MappingProxyType(
    {
        form.name: form
        for form in (
            Form("coulomb_viscous", stribeck=False, asymmetric=False),
            Form("coulomb_viscous_asymmetric", stribeck=False, asymmetric=True),
            Form("stribeck", stribeck=True, asymmetric=False),
            Form("stribeck_asymmetric", stribeck=True, asymmetric=True),
        )
    }
)
"""The curves by name, simple ones first."""


@dataclass(frozen=True)
class StaticCurve:
    """A fitted static friction curve.

    Attributes
    ----------
    name : one of `BASELINES`.
    parameters : name to value, the unit is in the name:
        coulomb_N (Fc), viscous_N_s_m (Fv), stribeck_N (dF), offset_N (o), forces at v -> 0+, slopes in N s/m;
        coulomb_pos_N, coulomb_neg_N and so on where each direction has its own, so that f = -Fc- + Fv- v for v << 0;
        width_m_s (w), stribeck_m_s (vs), m/s; stribeck_exponent (p), 1 or 2.
    """

    name: str
    parameters: Mapping[str, float]

    def evaluate(self, velocity_m_s: Floats) -> Floats:
        """Return the friction at velocities (n,) m/s, (n,) N; any finite velocity, beyond the fitted ones as well.

        >>> par = {"coulomb_N": 2.0, "viscous_N_s_m": 3.0, "offset_N": 0.5, "width_m_s": 0.01}
        >>> StaticCurve("coulomb_viscous", par).evaluate(np.array([-1.0, 0.0, 1.0])).tolist()
        [-4.5, 0.5, 5.5]
        """
        v, par = np.asarray(velocity_m_s, np.float64), self.parameters

        def each(stem: str, unit: str) -> "Floats | float":
            if f"{stem}_{unit}" in par:
                return par[f"{stem}_{unit}"]
            return np.where(v >= 0.0, par[f"{stem}_pos_{unit}"], par[f"{stem}_neg_{unit}"])

        level = each("coulomb", "N")
        if BASELINES[self.name].stribeck:
            decay = np.exp(-(np.abs(v / par["stribeck_m_s"]) ** par["stribeck_exponent"]))
            level = level + each("stribeck", "N") * decay
        out: Floats = np.tanh(v / par["width_m_s"]) * level + each("viscous", "N_s_m") * v + par.get("offset_N", 0.0)
        return out

    def over(self, velocity_m_s: Floats) -> "Prediction":
        """Return what evaluates the curve over a part of a record, whose velocities are (n,)."""
        return lambda part: self.evaluate(velocity_m_s[part])


def fit_baselines(
    velocity_m_s: Floats, friction_N: Floats, names: Collection[str] = tuple(BASELINES), use: Bools | None = None
) -> dict[str, StaticCurve]:
    """Fit each of `BASELINES`, or those of `names`, by least squares, deterministically.

    The coefficients are eliminated for a given shape (variable projection, Golub and Pereyra 1973); the shape is
    searched on a logarithmic grid and refined from its best points by a bounded Gauss-Newton method on the logarithms.
    The search sees samples gathered into bins 1 % wide in speed: least squares with a curve that is constant over a bin
    needs no more than means and counts, and the curves' curvature over 1 % of the speed is 1e-5 of their height.
    The coefficients of the shape found are then fitted to all samples, block by block.

    What data do not tell, a small ridge decides (see `RIDGE_COULOMB`), so every answer is finite and modest: from one
    direction the other is its mirror image, at a single speed friction is Coulomb's, and beyond the fastest samples the
    curves go on straight with their viscous slope. A width finer than the slowest samples is not visible: the narrowest
    is kept unless a wider one is better by more than noise (`NARROW`).

    Parameters
    ----------
    velocity_m_s : (n,) velocity in m/s; any other unit of velocity will do, the answer scales with it.
    friction_N : (n,) friction in N with the sign of the velocity that it opposes; likewise of any unit.
    names : curves to fit, all of them unless given.
    use : (n,), the samples to fit; all of them unless given.

    Raises
    ------
    ValueError : shapes differ or a value is not finite.
    UnanswerableError : fewer than `LEAST_SAMPLES` samples, or none of them moves.
    """
    return dict(fitted_in_turn(velocity_m_s, friction_N, names, use))


def fitted_in_turn(
    velocity_m_s: Floats, friction_N: Floats, names: Collection[str] = tuple(BASELINES), use: Bools | None = None
) -> Iterator[tuple[str, StaticCurve]]:
    """Yield the curves of `fit_baselines` one by one: of a long record, each takes a while."""
    v, f = np.asarray(velocity_m_s, np.float64), np.asarray(friction_N, np.float64)
    if v.ndim != 1 or v.shape != f.shape:
        raise ValueError(f"velocity {v.shape} and friction {f.shape} must be of one shape (n,)")
    points = Points(v, f, use)
    if not points.finite:
        raise ValueError("velocity and friction must be finite")
    if points.size < LEAST_SAMPLES:
        raise UnanswerableError(f"a friction curve needs {LEAST_SAMPLES} samples at least, there are {points.size}")
    speed, force = points.top_speed, points.largest_force
    if not speed > 0.0:
        raise UnanswerableError("nothing moves: all velocities are 0, a friction curve cannot be fitted")
    bins = points.gathered(speed, force)
    for name in names:
        form = BASELINES[name]
        ridge = form.ridge(bins.both_ways)
        shape = best_shape(form, ridge, bins)
        coefficients = on_all(form, shape, ridge, points, speed, force)
        yield name, StaticCurve(name, in_units(form, shape, coefficients, speed, force))


def scores(curves: Mapping[str, StaticCurve], velocity_m_s: Floats, friction_N: Floats) -> dict[str, float]:
    """Return the nrmse of each curve on samples (n,) m/s, (n,) N, by name; NaN where friction is constant."""
    return {name: nrmse(friction_N, curve.evaluate(velocity_m_s)) for name, curve in curves.items()}


def best_shape(form: Form, ridge: Floats, bins: Bins) -> Shape:
    """Return the shape of least error: the grid's best points refined, over all exponents."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow to import

    weight = np.sqrt(bins.share)
    unit = float(np.sqrt(bins.scatter + np.sum(bins.share * bins.y**2))) or 1.0  # errors relative to the rms friction
    y, scatter = bins.y / unit, np.sqrt(bins.scatter) / unit

    def residual(place: Floats, exponent: float) -> Floats:
        columns = form.columns(bins.x, Shape.at(place, exponent))
        coefficients = solved((columns * bins.share) @ columns.T, columns @ (bins.share * y), ridge)
        error = np.concatenate([weight * (y - coefficients @ columns), ridge * coefficients, [scatter]])
        out: Floats = error * np.sqrt(1.0 + NARROW * place[0] / bins.samples)
        return out

    def cost(place: Floats, exponent: float) -> float:
        return float(np.sum(np.square(residual(place, exponent))))

    axis = np.linspace(0.0, 1.0, GRID)
    places = [np.array([a, b]) for a in axis for b in axis] if form.stribeck else [np.array([a]) for a in axis]
    best, least = (places[0], EXPONENTS[0]), np.inf
    for exponent in EXPONENTS if form.stribeck else EXPONENTS[:1]:
        costs = np.array([cost(place, exponent) for place in places])
        for k in np.argsort(costs, kind="stable")[:REFINED]:
            refined = least_squares(
                residual, places[k], args=(exponent,), bounds=(0.0, 1.0), xtol=1e-7, ftol=1e-9, gtol=1e-13, max_nfev=40
            ).x
            for place in (places[k], refined):
                # a difference that rounding can make does not move the answer from the grid's first
                if (value := cost(place, exponent)) < least * (1.0 - 1e-9):
                    best, least = (place, exponent), value
    return Shape.at(*best)


def on_all(form: Form, shape: Shape, ridge: Floats, points: Points, speed: float, force: float) -> Floats:
    """Return the coefficients (m,) of a shape on all samples, in units of speed and force.

    The ridge's square grows by s^2 / (n rms(f)^2), with s the standard deviation of the residual: what Bayes' rule
    makes of white noise and coefficients of about the rms friction. It is nothing where there are samples enough to
    tell the coefficients, and it holds them at modest values where a few noisy ones, or speeds too close, do not. The
    Coulomb level is spared: it takes what the others may not.
    """
    n = points.size
    gram, moment, power = np.zeros((form.size, form.size)), np.zeros(form.size), 0.0
    for velocity, friction in points:
        x, y = velocity / speed, friction / force
        columns = form.columns(x, shape)
        gram += columns @ columns.T / n
        moment += columns @ y / n
        power += float(y @ y) / n
    first = solved(gram, moment, ridge)
    left = max(power - 2.0 * float(first @ moment) + float(first @ gram @ first), 0.0)
    noise = left / (n - form.size) / power if power > 0.0 else 0.0
    others = np.arange(form.size) > 0
    return solved(gram, moment, np.sqrt(ridge**2 + noise * others))


def solved(gram: Floats, moment: Floats, ridge: Floats) -> Floats:
    """Return the coefficients (m,) of the normal equations per sample with a ridge (m,).

    The columns are of order 1 and the ridge's square is 1e-10 at least: the condition number stays below about 1e11
    (what is held at 0 by `RIDGE_NEVER` has its own scale), and rounding, 1e-16 of it, below 1e-5 of the coefficients
    where the data tell nothing and far below where they do.
    """
    out: Floats = np.asarray(np.linalg.solve(gram + np.diag(np.square(ridge)), moment), np.float64)
    return out


def in_units(form: Form, shape: Shape, coefficients: Floats, speed: float, force: float) -> dict[str, float]:
    """Return the parameters in the units of the samples: slopes over `speed`, forces times `force`."""
    terms = len(form.odd)
    mean, rest = coefficients[:terms] * force, coefficients[terms:] * force
    out = {}
    for k, key in enumerate(form.odd):
        unit = speed if key.startswith("viscous") else 1.0
        if form.asymmetric:
            stem, tail = key.split("_", 1)
            out[f"{stem}_pos_{tail}"] = float((mean[k] + rest[k]) / unit)
            out[f"{stem}_neg_{tail}"] = float((mean[k] - rest[k]) / unit)
        else:
            out[key] = float(mean[k] / unit)
    if not form.asymmetric:
        out["offset_N"] = float(rest[0])
    out["width_m_s"] = shape.width * speed
    if form.stribeck:
        out |= {"stribeck_m_s": shape.stribeck * speed, "stribeck_exponent": shape.exponent}
    return out
