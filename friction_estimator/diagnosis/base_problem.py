"""The base model of the diagnosis: theory and odd static curve through one short FIR, the theory with lags of its own.

    f[k] = sum_i h_i S(v[k-i]) + sum_i c_i (d[k-i] - d[k]),   h_0 = 1,   S(v; p, T) = a d(v; p, T) + sum_j w_j B_j(v)

with odd splines B_j: the even part of the curve and its value at standstill are hypotheses (direction_asymmetry,
sensor_bias), so they are no part of it. h acts on the whole static force and is not negative: it cannot differentiate,
and so does not swallow inertia. c lets theory and mismatch have unlike memory, as the paper's parallel structure does.

Taps have the TC prior of the learned model (`core.model.prior.decaying`), the error power is weighed by its `COLOUR`:
what a structure leaves repeats with the drive. The fit minimises the negative log posterior by Gauss-Newton steps that
are halved until they descend, from several starts; everything happens in the products of `lagged`.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dposv

from friction_estimator.core.fit.posterior import COLOUR
from friction_estimator.core.model.prior import decaying
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.lagged import Extra, LaggedProducts, total
from friction_estimator.diagnosis.odd_curve import SPLINES, OddCurve
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.static_grid import StaticGrid
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.whole import StaticTables

TAP_DEVIATION, TAP_DECAY = 0.15, 0.4
"""Of the TC kernel of the taps h_1, h_2, ...: a memory of the rig of a sample or two is usual, a longer one is news."""

OWN_LAGS = 3.0
"""Deviation of the theory's own lags over that of the taps."""

CURVE_DEVIATION = 30.0
"""Prior standard deviation of a spline weight over the rms of friction: keeps unvisited velocities at zero."""

THEORY_DEVIATION = 2.0
"""Prior standard deviation of the theory's gain: its scale is an assumption. Wider, and a film's lag and the gain trade
against each other where a record has one period only, since the splines take up the static difference."""

STARTS: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.3, 0.3), (1.0, 0.6), (2.0, 0.8))
"""First tap and ratio of the taps that the fit starts from."""

STEPS = 40
HALVINGS = 12
CONVERGED = 1e-6
"""Relative decrease of the cost at which the descent ends."""

ALARM = 0.05
"""Share of the error power that the tangent may promise beyond the fit before the fit is called unfinished."""

PRESSURE_NODES = 5


@dataclass(frozen=True)
class Capacity:
    """How fine the base model is: splines of the static curve, order of the FIR."""

    splines: int
    order: int


@dataclass(frozen=True)
class Coefficients:
    """Parameters of the base model with those of further linear columns, and the cost that they reach.

    Attributes
    ----------
    weights : (m,), theory's gain first where there is one, then the splines', N. taps : (p,), h_1 ....
    own : (p,), c_1 ..., or empty without a theory. extra : (c,).
    cost : negative log posterior times twice the residual variance, N^2. power : error power, summed, N^2.
    count : samples. promise : share of the power that one more undamped step promises.
    """

    weights: Floats
    taps: Floats
    own: Floats
    extra: Floats
    cost: float
    power: float
    count: float
    variance: float
    promise: float

    @property
    def memory_energy(self) -> float:
        """Squared prior deviations of the memory from none: minus twice the log prior of taps and own lags."""
        if not self.taps.size:
            return 0.0
        inverse = np.linalg.inv(tap_covariance(self.taps.size))
        own = self.own / OWN_LAGS
        return float(self.taps @ inverse @ self.taps + (own @ inverse @ own if own.size else 0.0))


def tap_covariance(order: int) -> Floats:
    """Return the prior covariance of h_1 ... h_p."""
    return decaying(order, TAP_DEVIATION, TAP_DECAY)


class BaseProblem:
    """The base model on one record: its columns, their products, its prior.

    Parameters
    ----------
    record : the data. config : theory. capacity : of the curve and the FIR (default `SPLINES` and `fir.order`).
    """

    def __init__(self, record: Record, config: Config, capacity: Capacity | None = None) -> None:
        f = record.features
        capacity = capacity or Capacity(SPLINES, config.fir.order)
        self.record, self.config, self.capacity = record, config, capacity
        self.theory = theory_from_config(config)
        self.curve = OddCurve(float(np.abs(f.velocity_m_s).max()), capacity.splines)
        self.axis = VelocityAxis(self.curve.top)
        nodes, warm = pressure_nodes(f.pressure_Pa), float(f.temperature_degC.mean())
        self.grid = StaticGrid(self.curve, self.theory, self.axis, nodes, warm)
        static = self.columns(f.velocity_m_s, f.pressure_Pa, f.temperature_degC)
        used = record.used
        self.products = LaggedProducts(static, capacity.order, record.friction_N, used, record.restart, record.block)
        self.scale = float(np.sqrt(np.mean(np.square(record.friction_N[used])))) or 1.0
        lead = 1 if self.theory is not None else 0
        self.own = capacity.order * lead
        curve = np.full(static.shape[1], 1.0 / (CURVE_DEVIATION * self.scale) ** 2)
        curve[:lead] = 1.0 / THEORY_DEVIATION**2
        taps = np.linalg.inv(tap_covariance(capacity.order)) if capacity.order else np.zeros((0, 0))
        size = static.shape[1] + capacity.order + self.own
        self.information = np.zeros((size, size))
        m, p = static.shape[1], capacity.order
        self.information[:m, :m] = np.diag(curve)
        self.information[m : m + p, m : m + p] = taps
        if self.own:
            self.information[m + p :, m + p :] = taps / OWN_LAGS**2

    def columns(self, velocity_m_s: Floats, pressure_Pa: Floats, temperature_degC: Floats) -> Floats:
        """Return theory (where there is one) and splines, (n, m)."""
        static = self.curve(velocity_m_s)
        if self.theory is None:
            return static
        return np.column_stack([self.theory.evaluate(velocity_m_s, pressure_Pa, temperature_degC), static])

    @cached_property
    def tables(self) -> StaticTables:
        """The columns over velocity and pressure, at the mean temperature."""
        grid = self.grid

        def columns(velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
            return self.columns(velocity_m_s, pressure_Pa, np.full(velocity_m_s.size, grid.temperature_degC))

        return StaticTables.of(columns, self.axis, grid.pressures_Pa)

    def theory_alone(self, beside: Coefficients) -> Coefficients:
        """Return the coefficients of the theory as it is, in place of others; these where there is no theory."""
        if self.theory is None:
            return beside
        weights = np.zeros(beside.weights.size)
        weights[0] = 1.0
        return replace(beside, weights=weights, taps=np.zeros(beside.taps.size), own=np.zeros(beside.own.size))

    def mean_delay(self, found: Coefficients) -> float:
        """Return the mean delay of the memory behind the static force, in samples: its phase at low frequency."""
        force = self.products.static @ found.weights
        lags = np.arange(1, found.taps.size + 1)
        delay = float(lags @ found.taps)
        if found.own.size:
            share = float(self.products.static[:, 0] @ force) / max(float(force @ force), 1e-300)
            delay += share * float(lags @ found.own)
        return delay / max(1.0 + float(found.taps.sum()), 1e-3)

    def with_static(self, static: Floats, chosen: Bools | None = None) -> "BaseProblem":
        """Return the problem with other static columns, (n, m), on some blocks (bool) or all."""
        other = copy(self)
        other.products = self.products.of(static, chosen)
        return other

    def tied(self, found: Extra) -> tuple["BaseProblem", Extra]:
        """Return the problem, for a fit alone, with columns added to its own: see `LaggedProducts.tied`."""
        other = copy(self)
        other.products, rest = self.products.tied(found)
        return other, rest

    # Coefficients of the lagged columns

    def spread(self, weights: Floats, taps: Floats, own: Floats) -> Floats:
        """Return the coefficients of the lagged columns, (L,)."""
        out = np.outer(np.concatenate([[1.0], taps]), weights)
        if own.size:
            out[1:, 0] += own
            out[0, 0] -= own.sum()
        return out.ravel()

    def jacobian(self, weights: Floats, taps: Floats, own: Floats, level: bool = False) -> Floats:
        """Return d spread / d (weights, taps, own), (L, m + p + own).

        `level` takes from each tap's column what would change the static gain: the same span, better conditioned.
        """
        m, p = weights.size, taps.size
        out = np.zeros((p + 1, m, m + p + own.size))
        unit, lag = np.arange(m), np.arange(p)
        out[:, unit, unit] = np.concatenate([[1.0], taps])[:, None]
        out[lag + 1, :, m + lag] = weights
        if level:
            out[0, :, m : m + p] -= weights[:, None]
        if own.size:
            out[lag + 1, 0, m + p + lag] = 1.0
            out[0, 0, m + p :] = -1.0
        return out.reshape((p + 1) * m, -1)

    def fit(
        self,
        extra: Extra | None = None,
        settled: Extra | None = None,
        rows: Bools | None = None,
        starts: Sequence[Coefficients] = (),
    ) -> Coefficients:
        """Fit the base model, jointly with linear columns where given.

        Parameters
        ----------
        extra : columns with free coefficients. settled : one column of coefficient one, already taken off the products
            of `extra` with the force.
        rows : (blocks,) bool, blocks that are fitted (default all).
        starts : fits to start from (their taps), in place of `STARTS`.
        """
        normal = _Normal(self, extra, settled, rows)
        if starts:
            found = [normal.descend(s.taps, s) for s in starts]
        else:
            order = self.capacity.order
            found = [
                normal.descend(np.asarray(first * ratio ** np.arange(order), np.float64))
                for first, ratio in STARTS[: 4 if order else 1]
            ]
        return min(found, key=lambda c: c.cost)


class _Normal:
    """Normal equations of one fit, summed over its blocks."""

    def __init__(self, problem: BaseProblem, extra: Extra | None, settled: Extra | None, rows: Bools | None) -> None:
        products = problem.products
        self.problem = problem
        size = products.size
        width = 0 if extra is None else extra.xx.shape[1]
        self.gram = np.empty((size + width, size + width))
        self.right = np.empty(size + width)
        self.gram[:size, :size] = products.whole_gram if rows is None else total(products.gram, rows)
        self.right[:size] = total(products.cross, rows)
        self.power = float(total(products.power, rows))
        self.count = max(float(total(products.count, rows)), 1.0)
        if extra is not None:
            self.gram[:size, size:] = total(extra.mx, rows)
            self.gram[size:, :size] = self.gram[:size, size:].T
            self.gram[size:, size:] = total(extra.xx, rows)
            self.right[size:] = total(extra.xy, rows)
        if settled is not None:
            self.right[:size] -= total(settled.mx, rows)[:, 0]
            self.power += float(total(settled.xx, rows)[0, 0] - 2.0 * total(settled.xy, rows)[0])
        self.width = width
        # The columns of `linear` and of `step`, of which taps and weights change a part: they are worked out often.
        m, p, own = products.width, problem.capacity.order, problem.own
        base, at_taps = m + p + own, np.s_[m : m + p]
        self._columns = np.zeros((size + width, base + width))
        self._columns[:size, :base] = problem.jacobian(np.zeros(m), np.zeros(p), np.zeros(own))
        self._columns[size:, base:] = np.eye(width)
        self._known = np.zeros((base + width, base + width))
        self._known[:base, :base] = problem.information
        self._extra_known = np.zeros(0) if extra is None else extra.known
        self._known[base:, base:] = np.diag(self._extra_known)
        self._linear = np.delete(self._columns, at_taps, axis=1)
        # Rows and columns of each tap in it: the coefficient of every curve at that lag.
        self._taps_at = np.arange(m, m + p * m).reshape(p, m), np.arange(m)
        self._known_linear = np.delete(np.delete(self._known, at_taps, axis=0), at_taps, axis=1)

    def error_power(self, all_: Floats) -> float:
        return float(self.power - 2.0 * self.right @ all_ + all_ @ self.gram @ all_)

    def linear(self, taps: Floats, variance: float) -> tuple[Floats, Floats, Floats]:
        """Return weights, own lags and extra coefficients of least cost for fixed taps."""
        m, own, t = self.problem.products.width, self.problem.own, self._linear
        t[self._taps_at] = taps[:, None]
        theta = _solved(t.T @ self.gram @ t + variance * self._known_linear, t.T @ self.right)
        return theta[:m], theta[m : m + own], theta[m + own :]

    def cost(self, weights: Floats, taps: Floats, own: Floats, extra: Floats, variance: float) -> tuple[float, float]:
        """Return cost and error power, N^2."""
        power = self.error_power(np.concatenate([self.problem.spread(weights, taps, own), extra]))
        theta = np.concatenate([weights, taps, own])
        known = float(theta @ self.problem.information @ theta) + float(self._extra_known @ np.square(extra))
        return power + variance * known, power

    def descend(self, taps: Floats, start: Coefficients | None = None) -> Coefficients:
        """Gauss-Newton with step halving from these taps; nothing, at infinite cost, where numbers end.

        Columns of bristles on a level that has run away are too large for the others to be told beside them.
        """
        try:
            return self._descended(taps, start)
        except np.linalg.LinAlgError:
            sizes = self.problem.products.width, taps.size, self.problem.own, self.width
            weights, taps, own, extra = (np.zeros(size) for size in sizes)
            variance = COLOUR * self.power / self.count
            return Coefficients(weights, taps, own, extra, np.inf, self.power, self.count, variance, 0.0)

    def _descended(self, taps: Floats, start: Coefficients | None) -> Coefficients:
        problem = self.problem
        floor = 1e-18 * self.problem.scale**2
        variance = COLOUR * max(start.power / start.count, floor) if start else (0.1 * problem.scale) ** 2
        taps = np.array(taps)
        weights, own, extra = self.linear(taps, variance)
        promise = 0.0
        for _ in range(3):  # the variance is that of the fit itself
            cost, power = self.cost(weights, taps, own, extra, variance)
            for _ in range(STEPS):
                step, promise = self.step(weights, taps, own, extra, variance)
                share = 1.0
                for _ in range(HALVINGS):
                    trial = np.maximum(taps + share * step, 0.0)
                    w, c, x = self.linear(trial, variance)
                    new, new_power = self.cost(w, trial, c, x, variance)
                    if new < cost:
                        break
                    share *= 0.5
                else:
                    break
                gained = cost - new
                weights, taps, own, extra, cost, power = w, trial, c, x, new, new_power
                if gained < CONVERGED * cost:
                    break
            last, variance = variance, COLOUR * max(power / self.count, floor)
            if abs(variance - last) < 0.05 * last:
                break
        return Coefficients(weights, taps, own, extra, cost, power, self.count, variance, promise / max(power, 1e-300))

    def step(self, weights: Floats, taps: Floats, own: Floats, extra: Floats, variance: float) -> tuple[Floats, float]:
        """Return the Gauss-Newton step of the taps (taps at zero that would go below stay), and what it promises."""
        m, p, t = weights.size, taps.size, self._columns
        t[: self.problem.products.size, : m + p + own.size] = self.problem.jacobian(weights, taps, own)
        known = variance * self._known
        theta = np.concatenate([weights, taps, own, extra])
        all_ = np.concatenate([self.problem.spread(weights, taps, own), extra])
        hessian = t.T @ self.gram @ t + known
        pull = t.T @ (self.right - self.gram @ all_) - known @ theta
        free = np.ones(theta.size, np.bool_)
        for _ in range(p + 1):
            move = np.zeros(theta.size)
            move[free] = _solved(hessian[np.ix_(free, free)], pull[free])
            low = (taps <= 0.0) & (move[m : m + p] < 0.0)
            if not low.any():
                break
            free[m : m + p] &= ~low
        promise = float(2.0 * pull @ move - move @ hessian @ move)
        return move[m : m + p], promise


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solve a symmetric positive system after scaling its diagonal to one; rounding's share is added to it.

    LAPACK is called as it is: a fit solves hundreds of these small systems, and the checks of `cho_factor` and
    `cho_solve` take longer than the work.
    """
    size = np.sqrt(np.maximum(matrix.diagonal(), 1e-300))
    scaled = matrix / (size[:, None] * size)
    scaled.flat[:: size.size + 1] += 1e-11
    _, answer, info = dposv(scaled, right / size)
    if info or not np.isfinite(answer).all():
        raise np.linalg.LinAlgError(f"not positive definite, or not finite: dposv says {info}")
    return np.asarray(answer / size)


def pressure_nodes(pressure_Pa: Floats) -> Floats:
    """Return the pressures at which curves are tabulated, Pa."""
    low, high = float(pressure_Pa.min()), float(pressure_Pa.max())
    return np.array([low]) if high - low < 1e-3 * max(abs(high), 1.0) else np.linspace(low, high, PRESSURE_NODES)
