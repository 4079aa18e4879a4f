"""The paper's law (Kwak, Yagle and Levitt 1998, section 3): a step down the gradient of the squared error."""

from typing import ClassVar

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.steps import normalise_taps, powers, step_along
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config

LMS = 0
"""Its number."""

LEAST_BACKOFF, RECOVERY = 1e-4, 1e-4
"""Smallest factor on the step size after guarded steps, and its relative growth a sample."""


@njit(no_cpython_wrapper=True, forceinline=True)
def learn_lms(shape, theta, law, moments, status, theta_lines, x_lines, error):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """A* = A + mu e F, A = A*/||A*||, W += mu e A(q) Psi, A1 += mu e F1.

    Guard: where mu |x|^2 > 1 the step would overshoot the sample that it learns from, the first sign of divergence.
    It is shortened to mu = 1/|x|^2 and counted, and mu itself backs off to half; it recovers over 1 / RECOVERY samples.
    Without the guard (`law[FLOOR]` 0) a diverging law stops at `LARGEST_PARAMETER`.
    """
    step = law[at.STEP] * moments[at.BACKOFF]
    energy, size = powers(x_lines, theta_lines)
    if law[at.FLOOR] > 0.0 and step * energy > 1.0:
        step = 1.0 / energy
        status[at.GUARDED] += 1
        moments[at.BACKOFF] = max(0.5 * moments[at.BACKOFF], LEAST_BACKOFF)
    elif moments[at.BACKOFF] < 1.0:
        moments[at.BACKOFF] = min(1.0, moments[at.BACKOFF] * (1.0 + RECOVERY))
    if step_along(theta_lines, size, x_lines, energy, step * error, status):
        normalise_taps(shape, theta)


@LAWS.named("lms")
class Lms:
    """theta += mu e x, then A = A / ||A||.

    Stable while mu |x|^2 < 2; the guard shortens the step where mu |x|^2 > 1 and counts it.
    """

    number: ClassVar[int] = LMS
    keeps_covariance: ClassVar[bool] = False

    @staticmethod
    def constants(config: Config) -> tuple[float, float, float, float]:
        """Step size, and whether it is guarded (in the place of the floor)."""
        return config.lms.step_size, float(config.lms.guard), 0.0, 0.0

    @staticmethod
    def metric(prior: Prior) -> Floats:  # noqa: ARG004 - steepest descent has no metric
        """None: steepest descent."""
        return np.zeros(0)
