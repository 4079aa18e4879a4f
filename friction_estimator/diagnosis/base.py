"""The fitted base model: its force, its tangent, its static curve, and the tables for dynamic regressors."""

from dataclasses import dataclass

import numpy as np

from friction_estimator.core.model.theory import TheoryCurve
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base_problem import BaseProblem, Capacity, Coefficients
from friction_estimator.diagnosis.odd_curve import OddCurve
from friction_estimator.diagnosis.record import Record
from friction_estimator.diagnosis.tangent import Tangent
from friction_estimator.effects.reference import Reference


@dataclass(frozen=True)
class BaseFit:
    """The fitted base model.

    Attributes
    ----------
    problem : what was fitted. coefficients : the fit.
    fitted_N : (n,), the model's force.
    tangent : (n, q), columns of the model's derivative, each of unit rms over the samples in use.
    penalty : (q,), ridge on the tangent's coefficients, in units of samples.
    """

    problem: BaseProblem
    coefficients: Coefficients
    fitted_N: Floats
    tangent: Tangent
    penalty: Floats

    @classmethod
    def of(cls, problem: BaseProblem, found: Coefficients) -> "BaseFit":
        """Evaluate fitted coefficients on the whole record."""
        products = problem.products
        jacobian = problem.jacobian(found.weights, found.taps, found.own, level=True)
        power = np.einsum("iq,iq->q", jacobian, products.whole_gram @ jacobian) / max(float(products.count.sum()), 1.0)
        norm = np.maximum(np.sqrt(np.maximum(power, 0.0)), 1e-12 * problem.scale)
        known = np.diag(problem.information)
        return cls(
            problem=problem,
            coefficients=found,
            fitted_N=products.fitted(found.weights, found.taps, found.own),
            tangent=Tangent(products, found.weights, found.taps, norm),
            penalty=found.power / found.count * known / np.square(norm),
        )

    @property
    def static_N(self) -> Floats:
        """Static force of gain one, (n,), N."""
        return self.problem.products.static @ self.coefficients.weights

    @property
    def residual_N(self) -> Floats:
        """What the base model leaves, (n,), N."""
        return self.problem.record.friction_N - self.fitted_N

    @property
    def theory(self) -> TheoryCurve | None:
        """The theoretical curve, or None."""
        return self.problem.theory

    @property
    def curve(self) -> OddCurve:
        """The splines."""
        return self.problem.curve

    @property
    def theory_gain(self) -> float:
        """Gain a of the theory."""
        return float(self.coefficients.weights[0]) if self.theory is not None else 0.0

    @property
    def weights(self) -> Floats:
        """Weights of the splines, (count,), N."""
        return self.coefficients.weights[1:] if self.theory is not None else self.coefficients.weights

    @property
    def taps(self) -> Floats:
        """Taps h_1, h_2, ..., (order,)."""
        return self.coefficients.taps

    @property
    def own_lags(self) -> Floats:
        """The theory's own lags c_1, c_2, ..., (order,)."""
        own = self.coefficients.own
        return own if own.size else np.zeros(self.taps.size)

    @property
    def effective_taps(self) -> Floats:
        """Taps of the one FIR through which the whole force passes nearly: h plus the theory's share of c."""
        force = self.static_N
        share = 0.0
        if self.theory is not None:
            share = float(self.problem.products.static[:, 0] @ force) / max(float(force @ force), 1e-300)
        taps = self.taps + share * self.own_lags
        lead = 1.0 - share * float(self.own_lags.sum())
        return np.asarray(taps / lead if abs(lead) > 0.2 else self.taps)


def fit_base(record: Record, config: Config, capacity: Capacity | None = None) -> BaseFit:
    """Fit the base model alone to a record; `capacity` defaults to `SPLINES` and `fir.order`."""
    problem = BaseProblem(record, config, capacity)
    return BaseFit.of(problem, problem.fit())


def reference_of(fit: BaseFit, sign_velocity_m_s: float) -> Reference:
    """Return the tables from which dynamic regressors are made."""
    lead = 1.0 + float(fit.taps.sum())
    return fit.problem.grid.reference(fit.weights, fit.theory_gain, lead, sign_velocity_m_s, fit.taps)


def theory_reference(problem: BaseProblem, sign_velocity_m_s: float) -> Reference:
    """Return the tables of the theory alone, of gain one and without a FIR behind them."""
    if problem.theory is None:
        raise ValueError("the base has no theory")
    return problem.grid.reference(None, 1.0, 1.0, sign_velocity_m_s, None)
