"""The adaptation laws: one class a law, which sets up what the compiled rule of kernels.py works on.

All laws predict before they learn and use the same gradient regressor x; they differ in the step they take along it.
"""

from typing import ClassVar, Protocol

import numpy as np

from friction_estimator.core import kernels
from friction_estimator.core.config import Config
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats


class Law(Protocol):
    """One adaptation law."""

    number: ClassVar[int]
    """Its number in the dispatch of `kernels.run`."""

    @staticmethod
    def constants(config: Config) -> Floats:
        """Return the (4,) constants of the compiled rule, in the places that kernels.py names."""

    @staticmethod
    def initial_deviation(config: Config, prior: Floats) -> Floats:
        """Return the initial standard deviation of each parameter, (n,), or (0,) where the law keeps no covariance.

        `prior` is the model's relative prior standard deviation, (n,).
        """


LAWS: Registry[type[Law]] = Registry("law")


@LAWS.named("lms")
class Lms:
    """The paper's law: theta += mu e x, then A = A / ||A||.

    Stable while mu |x|^2 < 2; the guard shortens the step where mu |x|^2 > 1 and counts it.
    """

    number: ClassVar[int] = kernels.LMS

    @staticmethod
    def constants(config: Config) -> Floats:
        """Step size."""
        return np.array([config.lms.step_size, 0.0, 1.0, 0.0])

    @staticmethod
    def initial_deviation(config: Config, prior: Floats) -> Floats:  # noqa: ARG004 - the law keeps no covariance
        """No covariance."""
        return np.zeros(0)


@LAWS.named("nlms")
class Nlms:
    """theta += mu e x / (eps + |x|^2), |x|^2 over all blocks, then the norm of A moves into W.

    The a posteriori error of the linearised model is e (1 - mu |x|^2 / (eps + |x|^2)): never larger than e for mu <= 1.
    """

    number: ClassVar[int] = kernels.NLMS

    @staticmethod
    def constants(config: Config) -> Floats:
        """Step size and floor of the normaliser."""
        return np.array([config.nlms.step_size, config.nlms.regularisation, 1.0, 0.0])

    @staticmethod
    def initial_deviation(config: Config, prior: Floats) -> Floats:  # noqa: ARG004 - the law keeps no covariance
        """No covariance."""
        return np.zeros(0)


@LAWS.named("rls")
class Rls:
    """Recursive prediction error method on the gradient regressor (Ljung and Soderstrom 1983).

    Square-root covariance with directional forgetting (Kulhavy and Karny 1984); see `kernels`.
    """

    number: ClassVar[int] = kernels.RLS

    @staticmethod
    def constants(config: Config) -> Floats:
        """Forgetting factor and the cap of every variance (that of the start)."""
        return np.array([0.0, 0.0, config.rls.forgetting_factor, config.rls.initial_variance])

    @staticmethod
    def initial_deviation(config: Config, prior: Floats) -> Floats:
        """sqrt(initial variance) times the prior."""
        return np.asarray(np.sqrt(config.rls.initial_variance) * prior)
