"""The adaptation laws: one class a law, which sets up what the compiled rule of kernels.py works on.

All laws predict before they learn and use the same gradient regressor x; they differ in the step they take along it.
"""

from typing import ClassVar, Protocol

import numpy as np

from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import kernels
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config


class Law(Protocol):
    """One adaptation law."""

    number: ClassVar[int]
    """Its number in the dispatch of `kernels.run`."""

    @staticmethod
    def constants(config: Config) -> Floats:
        """Return the (6,) constants of the compiled rule, in the places that workspace.py names."""

    keeps_covariance: ClassVar[bool]
    """Whether it starts from the prior's covariance and keeps one."""

    @staticmethod
    def metric(prior: Prior) -> Floats:
        """Return the metric of its steps, (n,), or (0,) where it has none."""


MOTION = 0.02
"""Share of the velocity scale above which the shaft moves: errors at rest say nothing of the usual error."""


def speeds(config: Config) -> tuple[float, float]:
    """Return the speed above which running errors are averaged, and the top speed known so far, m/s.

    The latter grows with the range: a first contact that saw little motion must not make standstill too fine.
    """
    top = max((config.velocity_scale, *map(abs, config.reach or ())))
    return MOTION * config.velocity_scale, top


LAWS: Registry[type[Law]] = Registry("law")


@LAWS.named("lms")
class Lms:
    """The paper's law: theta += mu e x, then A = A / ||A||.

    Stable while mu |x|^2 < 2; the guard shortens the step where mu |x|^2 > 1 and counts it.
    """

    number: ClassVar[int] = kernels.LMS
    keeps_covariance: ClassVar[bool] = False

    @staticmethod
    def constants(config: Config) -> Floats:
        """Step size, and whether it is guarded (in the place of the floor)."""
        return np.array([config.lms.step_size, float(config.lms.guard), 0.0, 0.0, *speeds(config)])

    @staticmethod
    def metric(prior: Prior) -> Floats:  # noqa: ARG004 - steepest descent has no metric
        """None: steepest descent."""
        return np.zeros(0)


@LAWS.named("nlms")
class Nlms:
    """theta += mu e D x / (eps + x' D x), one normaliser for all blocks, then the norm of A moves into W.

    The metric D is the prior variance of each parameter: it lets the weights learn faster than the taps behind them,
    without which the two chase each other. The a posteriori error of the linearised model is
    e (1 - mu x' D x / (eps + x' D x)): never larger than e for mu <= 1.
    """

    number: ClassVar[int] = kernels.NLMS
    keeps_covariance: ClassVar[bool] = False

    @staticmethod
    def constants(config: Config) -> Floats:
        """Step size, floor of the normaliser, and the residual variance that the alarm refers to."""
        residual = config.prior.residual_deviation**2
        return np.array([config.nlms.step_size, config.nlms.regularisation, 0.0, residual, *speeds(config)])

    @staticmethod
    def metric(prior: Prior) -> Floats:
        """The metric D."""
        return prior.metric


@LAWS.named("rls")
class Rls:
    """Recursive prediction error method on the gradient regressor (Ljung and Soderstrom 1983).

    Square-root covariance under a prior that is never spent; see `kernels`.
    """

    number: ClassVar[int] = kernels.RLS
    keeps_covariance: ClassVar[bool] = True

    @staticmethod
    def constants(config: Config) -> Floats:
        """Least leverage and residual variance."""
        leverage, residual = 1.0 - config.rls.forgetting_factor, config.prior.residual_deviation**2
        return np.array([0.0, 0.0, leverage, residual, *speeds(config)])

    @staticmethod
    def metric(prior: Prior) -> Floats:  # noqa: ARG004 - the covariance is its metric
        """None beside the covariance."""
        return np.zeros(0)
