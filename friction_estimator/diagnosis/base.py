"""The base model of the diagnosis: theory + odd static curve, through one short FIR.

    f[k] = sum_i h_i S(v[k-i]),  h_0 = 1,  S(v; p, T) = a d(v; p, T) + sum_j w_j B_j(v),  B_j odd

The even part of the curve and its value at standstill are hypotheses (direction_asymmetry, sensor_bias), so they are
no part of it. One FIR acts on the whole static force: unlike separate ones it cannot differentiate the velocity, and
so does not swallow inertia. Fitted with frozen weights by Gauss-Newton; the tangent at the end is what
the evidence projects out.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from friction_estimator.core.model.theory import TheoryCurve, theory_from_config
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.products import inner
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.extension import theory_parts
from friction_estimator.effects.reference import Reference

SPLINES = 12
BEND = 60.0
"""Knots are asinh-spaced in velocity: v_max / BEND is where the spacing begins to grow."""

TAP_DEVIATION = 0.1
TAP_DECAY = 0.6
"""Prior standard deviation of tap i >= 1: TAP_DEVIATION TAP_DECAY^(i-1)."""

CURVE_DEVIATION = 30.0
"""Prior standard deviation of a spline weight over the rms of friction: keeps unvisited velocities at zero."""

GAUSS_NEWTON_STEPS = 5
PRESSURE_NODES = 5


class OddCurve:
    """Odd cubic splines of velocity, finest near standstill.

    >>> curve = OddCurve(0.1, 12)
    >>> v = np.linspace(-0.1, 0.1, 11)
    >>> bool(np.allclose(curve(v), -curve(-v)))
    True
    """

    def __init__(self, top_m_s: float, count: int = SPLINES) -> None:
        self.top = top_m_s
        self.bend = top_m_s / BEND
        self.count = count
        inner = np.linspace(-1.0, 1.0, 2 * count - 1)
        self._knots = np.concatenate([[-1.0] * 3, inner, [1.0] * 3])

    def __call__(self, velocity_m_s: Floats) -> Floats:
        """Return (n, count)."""
        place = np.arcsinh(np.clip(velocity_m_s, -self.top, self.top) / self.bend) / np.arcsinh(BEND)
        full = BSpline.design_matrix(np.clip(place, -1.0, 1.0), self._knots, 3).toarray()
        mirrored = full[:, ::-1]
        return np.asarray((full - mirrored)[:, full.shape[1] - self.count :])


@dataclass(frozen=True)
class BaseFit:
    """The fitted base model.

    Attributes
    ----------
    curve : splines of the static part.
    theory_gain : a. weights : (count,), N. taps : (order,), h_1, h_2, ....
    static_N, fitted_N, residual_N : (n,).
    tangent : (n, q), columns of the model's derivative, each of unit rms.
    penalty : (q,), ridge on the tangent's coefficients, in units of samples.
    condition : sum |h| / |sum h|: above 3 the FIR differentiates rather than smooths.
    """

    curve: OddCurve
    theory: TheoryCurve | None
    theory_gain: float
    weights: Floats
    taps: Floats
    extra_weights: Floats
    static_N: Floats
    fitted_N: Floats
    residual_N: Floats
    tangent: Floats
    penalty: Floats

    @property
    def condition(self) -> float:
        """Return sum |h| / |sum h|."""
        taps = np.concatenate([[1.0], self.taps])
        return float(np.abs(taps).sum() / max(abs(taps.sum()), 1e-9))

    def static_force(self, velocity_m_s: Floats, pressure_Pa: Floats, temperature_degC: float) -> Floats:
        """Return the static force times the FIR's gain, (n,), N."""
        force = self.curve(velocity_m_s) @ self.weights
        if self.theory is not None:
            warm = np.full(velocity_m_s.size, temperature_degC)
            force = force + self.theory_gain * self.theory.evaluate(velocity_m_s, pressure_Pa, warm)
        return np.asarray(force * (1.0 + self.taps.sum()))


def lagged(values: Floats, lag: int, piece_start: Floats) -> Floats:
    """Return values[k - lag], held at the first value of the gap-free piece; `piece_start` is its first index."""
    index = np.maximum(np.arange(values.shape[0]) - lag, piece_start.astype(np.int64))
    return np.asarray(values[index])


def piece_starts(restart: Bools) -> Floats:
    """Return for each sample the index at which its gap-free piece begins, (n,)."""
    starts = np.where(restart, np.arange(restart.size), 0)
    return np.asarray(np.maximum.accumulate(starts), np.float64)


def fit_base(
    record: Record,
    config: Config,
    extra: Floats | None = None,
    splines: int = SPLINES,
    order: int | None = None,
    start_at: BaseFit | None = None,
    steps: int = GAUSS_NEWTON_STEPS,
) -> BaseFit:
    """Fit the base model, jointly with extra linear columns where given.

    Parameters
    ----------
    record : the data. config : theory and FIR order.
    extra : (n, c), N; columns of effects already named. They are fitted too, but are no part of `fitted_N`;
        `residual_N` is what is left after both.
    splines, order : capacity of the static curve and of the FIR (default: `fir.order`).
    start_at : an earlier fit of the same capacity to start from. steps : of Gauss-Newton.
    """
    f, y, used = record.features, record.friction_N, record.used
    order = config.fir.order if order is None else order
    theory = theory_from_config(config)
    top = float(np.abs(f.velocity_m_s).max())
    curve = OddCurve(top, splines)
    static = curve(f.velocity_m_s)
    if theory is not None:
        static = np.column_stack([theory.evaluate(f.velocity_m_s, f.pressure_Pa, f.temperature_degC), static])
    columns = static.shape[1]
    extra = np.zeros((y.size, 0)) if extra is None else extra
    start = piece_starts(record.restart)
    scale = float(np.sqrt(np.mean(np.square(y[used])))) or 1.0
    taps = np.zeros(order) if start_at is None else start_at.taps.copy()
    weights = np.zeros(columns)
    noise = 0.1 * scale
    if start_at is not None:
        lead = [start_at.theory_gain] if theory is not None else []
        weights = np.concatenate([lead, start_at.weights])
        noise = float(np.sqrt(np.mean(np.square(start_at.residual_N[used]))))
    tap_prior = TAP_DEVIATION * TAP_DECAY ** np.arange(order)
    curve_prior = np.full(columns, CURVE_DEVIATION * scale)
    if theory is not None:
        curve_prior[0] = 10.0
    coefficients = np.zeros(extra.shape[1])
    for step in range(steps) if start_at is None else range(1, steps + 1):
        filtered = static + sum((h * lagged(static, i + 1, start) for i, h in enumerate(taps)), np.zeros(static.shape))
        force = static @ weights
        if step == 0:
            design = np.column_stack([filtered, extra])
        else:
            slopes = [lagged(force, i + 1, start) - force for i in range(order)]
            design = np.column_stack([filtered, *slopes, extra])
        # theta holds weights, the change of taps, coefficients; penalties act on the taps themselves.
        priors = np.concatenate([curve_prior, tap_prior if step else [], np.full(extra.shape[1], np.inf)])
        ridge = np.square(noise / priors)
        pull = np.zeros(design.shape[1])
        if step:
            pull[columns : columns + order] = -ridge[columns : columns + order] * taps
        a = design[used]
        gram = inner(a, a) + np.diag(ridge)
        gram[np.diag_indices_from(gram)] += 1e-10 * np.maximum(np.diag(gram), 1e-300)
        right = inner(a, y[used]) + pull
        theta = _non_negative(gram, right, slice(columns, columns + (order if step else 0)), taps)
        weights = theta[:columns]
        coefficients = theta[theta.size - extra.shape[1] :]
        if step:
            change = theta[columns : columns + order]
            # force was subtracted in the slopes: h_0 became 1 - sum(change); scale back to h_0 = 1.
            lead = 1.0 - change.sum()
            taps = (taps + change) / lead if abs(lead) > 0.2 else taps
            weights = weights * lead
        fitted = _filtered(static @ weights, taps, start)
        residual = y - fitted - extra @ coefficients
        noise = max(float(np.sqrt(np.mean(np.square(residual[used])))), 1e-9 * scale)
    force = static @ weights
    filtered = static + sum((h * lagged(static, i + 1, start) for i, h in enumerate(taps)), np.zeros(static.shape))
    slopes = [lagged(force, i + 1, start) - force for i in range(order)]
    tangent = np.column_stack([filtered, *slopes])
    norm = np.maximum(np.sqrt(np.mean(np.square(tangent), axis=0)), 1e-12 * scale)
    penalty = np.square(noise / (np.concatenate([curve_prior, tap_prior]) * norm))
    return BaseFit(
        curve=curve,
        theory=theory,
        theory_gain=float(weights[0]) if theory is not None else 0.0,
        weights=weights[1:] if theory is not None else weights,
        taps=taps,
        extra_weights=coefficients,
        static_N=force,
        fitted_N=fitted,
        residual_N=residual,
        tangent=tangent / norm,
        penalty=penalty,
    )


def _non_negative(gram: Floats, right: Floats, part: slice, start: Floats) -> Floats:
    """Solve gram theta = right with start + theta[part] >= 0: taps that go negative are held at zero, one by one."""
    theta = np.asarray(cho_solve(cho_factor(gram), right))
    held: list[int] = []
    numbers = range(part.start, part.stop)
    for _ in numbers:
        worst = min((n for n in numbers if n not in held), key=lambda n: start[n - part.start] + theta[n], default=-1)
        if worst < 0 or start[worst - part.start] + theta[worst] >= 0.0:
            break
        held.append(worst)
        free = np.setdiff1d(np.arange(right.size), held)
        fixed = np.array([-start[n - part.start] for n in held])
        theta[held] = fixed
        theta[free] = cho_solve(
            cho_factor(gram[np.ix_(free, free)]), right[free] - gram[np.ix_(free, np.array(held))] @ fixed
        )
    return theta


def _filtered(force: Floats, taps: Floats, start: Floats) -> Floats:
    out = force.copy()
    for i, tap in enumerate(taps):
        out += tap * lagged(force, i + 1, start)
    return out


def reference_of(fit: BaseFit, record: Record, sign_velocity_m_s: float) -> Reference:
    """Return the tables from which dynamic regressors are made."""
    f = record.features
    temperature = float(f.temperature_degC.mean())
    low, high = float(f.pressure_Pa.min()), float(f.pressure_Pa.max())
    nodes = np.array([low]) if high - low < 1e-3 * max(abs(high), 1.0) else np.linspace(low, high, PRESSURE_NODES)
    gain = fit.theory_gain * (1.0 + float(fit.taps.sum()))
    viscous, boundary, theory = theory_parts(fit.theory, gain, temperature)
    return Reference.tabulate(
        lambda v, p: fit.static_force(v, p, temperature),
        viscous,
        boundary,
        theory,
        fit.curve.top,
        nodes,
        sign_velocity_m_s,
        fit.taps,
    )
