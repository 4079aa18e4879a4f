"""Normalised lms in a metric: one step removes the share mu of the error on its own sample, whatever the scales are."""

from typing import ClassVar

from friction_estimator.compiled import njit
from friction_estimator.core.model.prediction import TAPS, WEIGHTS
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.steps import normalise_taps, step_along, tap_power, trusted
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config

NLMS = 1
"""Its number."""


@njit(no_cpython_wrapper=True, forceinline=True, fastmath={"reassoc", "contract"})
def learn_nlms(shape, theta, ring, law, status, theta_lines, metric_lines, x_lines, gain, gain_lines, error):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """theta += mu e D x / (eps + x' D x), one normaliser for all blocks, then the norm of A goes into W."""
    energy = power = size = 0.0
    for i in range(x_lines.size):
        direction = metric_lines[i] * x_lines[i]
        gain_lines[i] = direction
        energy += direction * x_lines[i]
        power += direction * direction
        size += theta_lines[i] * theta_lines[i]
    step = law[at.STEP] * error / (law[at.FLOOR] + energy)
    step = trusted(shape, ring, law, status, energy, gain, power, step)
    if step_along(theta_lines, size, gain_lines, power, step, status):
        _move_norm_into_weights(shape, theta)


@njit(no_cpython_wrapper=True, forceinline=True)
def _move_norm_into_weights(shape, theta):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Normalise A and multiply W by its norm, where it has left [0.8, 1.25]: the output does not change."""
    if 0.64 < tap_power(shape, theta) < 1.5625:
        return
    norm = normalise_taps(shape, theta)
    if norm > 0.0:
        for i in range(shape[TAPS], shape[TAPS] + shape[WEIGHTS]):
            theta[i] *= norm


@LAWS.named("nlms")
class Nlms:
    """theta += mu e D x / (eps + x' D x), one normaliser for all blocks, then the norm of A moves into W.

    The metric D is the prior variance of each parameter: it lets the weights learn faster than the taps behind them,
    without which the two chase each other. The a posteriori error of the linearised model is
    e (1 - mu x' D x / (eps + x' D x)): never larger than e for mu <= 1.
    """

    number: ClassVar[int] = NLMS
    keeps_covariance: ClassVar[bool] = False

    @staticmethod
    def constants(config: Config) -> tuple[float, float, float, float]:
        """Step size, floor of the normaliser, and the residual variance that the alarm refers to."""
        return config.nlms.step_size, config.nlms.regularisation, 0.0, config.prior.residual_deviation**2

    @staticmethod
    def metric(prior: Prior) -> Floats:
        """The metric D."""
        return prior.metric
