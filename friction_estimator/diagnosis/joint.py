"""Base model and named effects fitted together: nonlinear parameters refined, tangent, held-out loss, intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import SPLINES, BaseFit, fit_base, reference_of
from friction_estimator.diagnosis.evidence import Evidence, folds_of
from friction_estimator.diagnosis.library import columns_of, with_running_force
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.base import Effect
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

ROUNDS = 3
"""Rounds for a first comparison."""

SETTLED_ROUNDS = 10
SETTLED = 2e-3
"""Rounds for what is reported, and the relative change of the parameters at which they end."""

REFINE_EVALUATIONS = 14
ZOOM_POINTS, ZOOM_LEVELS = 13, 3
DERIVATIVE_STEP = 1e-3
"""Relative step of a refined parameter in numerical derivatives."""

HELD = 1e12
"""Penalty of a tangent coefficient that must stay zero."""


@dataclass(frozen=True)
class Capacity:
    """How fine the base model is: splines of the static curve, order of the FIR."""

    splines: int
    order: int


@dataclass(frozen=True)
class Term:
    """One effect in a model: its class, its parameters and the coefficients of its columns."""

    effect: type[Effect]
    params: dict[str, float]
    weights: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def name(self) -> str:
        """Id of the effect."""
        return self.effect.name


@dataclass(frozen=True)
class Joint:
    """Base model and effects fitted together.

    Attributes
    ----------
    base : the base model's part. terms : with fitted parameters and weights.
    reference : tables made from the base. features : of the record, with the running force.
    parts_N : one (n,) array for each term: its force.
    residual_N : (n,). tangent : (n, q), of the whole model. penalty : (q,).
    scales : (q,), what a unit of each tangent coefficient is in the parameter's own unit.
    """

    base: BaseFit
    terms: tuple[Term, ...]
    reference: Reference
    features: Features
    parts_N: tuple[Floats, ...]
    residual_N: Floats
    tangent: Floats
    penalty: Floats
    scales: Floats

    def evidence(self, record: Record, seed: int) -> Evidence:
        """Return the evidence machine for what this model leaves."""
        return Evidence(self.tangent, self.penalty, self.residual_N, record.used, record.block, seed)


def fit_joint(
    record: Record,
    config: Config,
    context: Context,
    terms: Sequence[Term] = (),
    start: BaseFit | None = None,
    rounds: int = ROUNDS,
    capacity: Capacity | None = None,
) -> Joint:
    """Fit base and effects jointly.

    Alternates between the refinement of the nonlinear parameters, one at a time, with base and other effects
    projected out, and a Gauss-Newton fit of base and coefficients; the reference curve follows.
    """
    capacity = capacity or Capacity(SPLINES, config.fir.order)
    splines, order = capacity.splines, capacity.order
    base = start or fit_base(record, config, splines=splines, order=order)
    terms = list(terms)
    best: tuple[float, BaseFit, list[Term], list[Floats], Reference, Features] | None = None
    for number in range(rounds if terms else 1):
        before = list(terms)
        reference = reference_of(base, record, context.sign_velocity_m_s)
        features = with_running_force(record.features, reference)
        columns = [columns_of(t.effect, t.params, features, reference) for t in terms]
        for i, term in enumerate(terms):
            if term.effect.refined:
                others = [c for k, c in enumerate(columns) if k != i]
                settled = sum(
                    (c[:, 0] for c, t in zip(others, _without(terms, i), strict=True) if t.effect.fixed_gain),
                    np.zeros(features.size),
                )
                free = [c for c, t in zip(others, _without(terms, i), strict=True) if not t.effect.fixed_gain]
                params = _refined(term, record, base, settled, free, features, reference, context)
                terms[i] = replace(term, params=params)
                columns[i] = columns_of(term.effect, params, features, reference)
        fixed = sum(
            (c[:, 0] for c, t in zip(columns, terms, strict=True) if t.effect.fixed_gain), np.zeros(features.size)
        )
        free = [c for c, t in zip(columns, terms, strict=True) if not t.effect.fixed_gain]
        moved = record.with_force(record.friction_N - fixed, record.used)
        base = fit_base(moved, config, np.column_stack(free) if free else None, splines, order, base, 2)
        terms = _weighted(terms, columns, base.extra_weights)
        power = float(np.mean(np.square(base.residual_N[record.used])))
        if best is None or power < best[0]:
            best = power, base, list(terms), list(columns), reference, features
        if number and _largest_change(before, terms) < SETTLED:
            break
    if best is not None:
        # The alternation swings where base and effect can stand in for each other: the best round counts.
        _, base, terms, columns, reference, features = best
    return _finished(record, base, terms, columns, reference, features)


def _largest_change(before: Sequence[Term], terms: Sequence[Term]) -> float:
    """Return the largest relative change of a refined parameter, or of a term's coefficients."""
    pairs = [(o.params[n], t.params[n]) for o, t in zip(before, terms, strict=True) for n in t.effect.refined]
    steps = [abs(new - old) / max(abs(old), 1e-300) for old, new in pairs]
    for old, new in zip(before, terms, strict=True):
        if old.weights.shape != new.weights.shape:
            return np.inf
        size = float(np.linalg.norm(new.weights)) or 1.0
        steps.append(float(np.linalg.norm(new.weights - old.weights)) / size)
    return max(steps, default=0.0)


def _without(terms: Sequence[Term], index: int) -> list[Term]:
    return [t for k, t in enumerate(terms) if k != index]


def _weighted(terms: Sequence[Term], columns: Sequence[Floats], weights: Floats) -> list[Term]:
    """Hand the fitted coefficients out to the terms; those of fixed gain have coefficient one."""
    place, out = 0, []
    for term, column in zip(terms, columns, strict=True):
        if term.effect.fixed_gain:
            out.append(replace(term, weights=np.ones(1)))
        else:
            out.append(replace(term, weights=weights[place : place + column.shape[1]]))
            place += column.shape[1]
    return out


def _refined(
    term: Term,
    record: Record,
    base: BaseFit,
    settled: Floats,
    free: Sequence[Floats],
    features: Features,
    reference: Reference,
    context: Context,
) -> dict[str, float]:
    """Return the term's parameters with the refined ones at their best, the others' columns projected out."""
    used = record.used
    z = np.column_stack([base.tangent, *free])[used]
    norm = np.maximum(np.sqrt(np.mean(np.square(z), axis=0)), 1e-300)
    z = z / norm
    penalty = np.concatenate([base.penalty, np.zeros(z.shape[1] - base.penalty.size)]) + 1e-9 * len(z)
    e = (record.friction_N - base.fitted_N - settled)[used]
    inverse = np.linalg.inv(inner(z, z) + np.diag(penalty))
    ze = inner(z, e)
    params = dict(term.params)

    def loss(name: str, value: float) -> float:
        x = columns_of(term.effect, params | {name: value}, features, reference)[used]
        zx, xx = inner(z, x), inner(x, x)
        left = xx - zx.T @ inverse @ zx
        pull = inner(x, e) - zx.T @ inverse @ ze
        if term.effect.fixed_gain:
            return float(left[0, 0] - 2.0 * pull[0])
        left = left + np.diag(1e-9 * np.maximum(np.diag(xx), 1e-300))
        return -float(pull @ np.linalg.solve(left, pull))

    for name in term.effect.refined:
        low, high = term.effect.bracket(name, params[name], context)
        if name in term.effect.steps:
            params[name] = _zoom(lambda v, n=name: loss(n, v), low, high)  # type: ignore[misc]
        else:
            found = minimize_scalar(
                lambda u, n=name: loss(n, float(np.exp(u))),
                bounds=(np.log(low), np.log(high)),
                method="bounded",
                options={"maxiter": REFINE_EVALUATIONS, "xatol": 1e-4 * (np.log(high) - np.log(low))},
            )
            params[name] = float(np.exp(found.x))
    return params


def _zoom(loss: Callable[[float], float], low: float, high: float) -> float:
    """Return the middle of the best plateau on a grid that zooms in on the best of the one before."""
    best = 0.5 * (low + high)
    for _ in range(ZOOM_LEVELS):
        points = np.linspace(low, high, ZOOM_POINTS)
        losses = np.array([loss(float(p)) for p in points])
        flat = np.flatnonzero(losses <= losses.min() + 1e-9 * abs(losses.min()))
        first = flat[0]
        last = first + int(np.argmax(np.append(np.diff(flat), 2) > 1))
        best = float(0.5 * (points[first] + points[last]))
        reach = (high - low) / (ZOOM_POINTS - 1)
        low, high = max(low, points[first] - reach), min(high, points[last] + reach)
    return best


def _finished(
    record: Record,
    base: BaseFit,
    terms: Sequence[Term],
    columns: Sequence[Floats],
    reference: Reference,
    features: Features,
) -> Joint:
    """Assemble the result with the tangent of the whole model."""
    parts = tuple(c @ t.weights for c, t in zip(columns, terms, strict=True))
    tangents, scales = [base.tangent], [np.ones(base.tangent.shape[1])]
    held: list[Floats] = []
    for term, column, part in zip(terms, columns, parts, strict=True):
        slopes = [] if term.effect.fixed_gain else [column]
        units = [] if term.effect.fixed_gain else [np.ones(column.shape[1])]
        for name in term.effect.refined:
            step = DERIVATIVE_STEP * abs(term.params[name])
            if name in term.effect.steps:
                step = 2.0 * float(np.median(features.step_s))
            if step == 0.0:
                continue
            moved = term.params | {name: term.params[name] + step}
            other = columns_of(term.effect, moved, features, reference) @ term.weights
            slopes.append(((other - part) / step)[:, None])
            units.append(np.ones(1))
        block = np.column_stack(slopes)
        norm = np.sqrt(np.mean(np.square(block), axis=0))
        shown = norm > 1e-12 * float(np.sqrt(np.mean(np.square(record.friction_N))))
        # A parameter that changes nothing here (a step between two samples) is held where it is.
        tangents.append(np.where(shown, block / np.where(shown, norm, 1.0), 0.0))
        scales.append(np.where(shown, np.concatenate(units) / np.where(shown, norm, 1.0), 0.0))
        held.append(np.where(shown, 0.0, HELD))
    residual = record.friction_N - base.fitted_N - sum(parts, np.zeros(features.size))
    tangent = np.column_stack(tangents)
    penalty = np.concatenate([base.penalty, *held])
    return Joint(base, tuple(terms), reference, features, parts, residual, tangent, penalty, np.concatenate(scales))


def parameter_covariance(joint: Joint, record: Record, seed: int) -> Floats:
    """Return the covariance of the tangent's coefficients in the parameters' own units, (q, q).

    Sandwich over blocks: H^-1 (sum_b s_b s_b') H^-1 with s_b = X_b' e_b, B / (B - 1), so that neither coloured
    nor uneven noise makes the intervals too narrow.
    """
    evidence = joint.evidence(record, seed)
    hessian = evidence.zz.sum(0) + np.diag(joint.penalty)
    hessian = hessian + np.diag(1e-10 * np.maximum(np.diag(hessian), 1e-300))
    scores = evidence.ze - evidence.ze.mean(axis=0)
    inverse = np.linalg.inv(hessian)
    blocks = evidence.blocks
    middle = scores.T @ scores * blocks / (blocks - 1)
    white = hessian * float(evidence.ee.sum()) / max(evidence.samples - hessian.shape[0], 1)
    # Few blocks make the sandwich noisy: it never falls below what white noise alone would give.
    sandwich, plain = inverse @ middle @ inverse, inverse @ white @ inverse
    known = np.maximum(np.diag(sandwich), 1e-300)
    lift = np.sqrt(np.fmax(np.diag(plain) / known, np.ones(known.size)))
    return np.asarray(sandwich * np.outer(lift, lift) * np.outer(joint.scales, joint.scales))


@dataclass(frozen=True)
class Estimate:
    """A fitted physical quantity with its 95 % interval."""

    value: float
    unit: str
    low: float
    high: float


def estimates(joint: Joint, record: Record, context: Context, seed: int) -> list[dict[str, Estimate]]:
    """Return the physical parameters of each term with intervals .

    Sampling error by the delta method with Student t over blocks, and the effect's systematic share beside it.
    """
    covariance = parameter_covariance(joint, record, seed)
    quantile = float(student.ppf(0.975, max(record.blocks - 1, 1)))
    place = joint.base.tangent.shape[1]
    out = []
    for term in joint.terms:
        free = 0 if term.effect.fixed_gain else term.weights.size
        names = [n for n in term.effect.refined if term.params[n] != 0.0]
        theta = np.concatenate([term.weights[:free], [term.params[n] for n in names]])
        part = covariance[place : place + theta.size, place : place + theta.size]
        place += theta.size

        def values(
            point: Floats, term: Term = term, free: int = free, names: list[str] = names
        ) -> dict[str, tuple[float, str]]:
            params = term.params | dict(zip(names, point[free:].tolist(), strict=True))
            weights = point[:free] if free else np.ones(1)
            return term.effect.physical(params, weights, context)

        centre = values(theta)
        found = {}
        for name, (value, unit) in centre.items():
            slope = np.zeros(theta.size)
            for i in range(theta.size):
                step = 1e-4 * abs(theta[i]) + 1e-12
                moved = theta.copy()
                moved[i] += step
                slope[i] = (values(moved)[name][0] - value) / step
            reach = quantile * float(np.sqrt(max(float(slope @ part @ slope), 0.0)))
            reach = float(np.hypot(reach, term.effect.systematic.get(name, 0.0) * abs(value)))
            found[name] = Estimate(float(value), unit, float(value - reach), float(value + reach))
        out.append(found)
    return out


def cross_validated_loss(joint: Joint, record: Record, seed: int) -> Floats:
    """Return the error power of each block under coefficients fitted without it, (blocks,), N^2.

    The model is linear about its fit to everything; its refined parameters are among the coefficients.
    """
    return joint.evidence(record, seed).base_loss()


def fold_masks(record: Record, seed: int) -> list[np.ndarray]:
    """Return for each fold which samples it tests."""
    folds = folds_of(record.blocks, seed)
    return [np.isin(record.block, np.flatnonzero(folds == k)) for k in range(int(folds.max()) + 1)]
