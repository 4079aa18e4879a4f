"""The posterior of a model's parameters given a record: cost, its minimum, and the covariance there.

With the moments of a record (`moments`), the prior N(mu, P0) and the residual variance rho of `prior`, the negative
logarithm of the posterior is, up to a constant,

    phi(theta) = n / rho C(theta) + 1/2 (theta - mu)' P0^-1 (theta - mu)

with C half the mean square error and n the effective number of samples. A record of one sine does not say more when it
goes on: its misfit repeats. So n stops growing where the mean leverage of a sample, E[x' P x] / rho with P the
posterior covariance, has come down to 1 - lambda: the same bound by which rls stops (see `online.rls`). And rho is
`COLOUR` times the record's own mean square error where that is more than the prior's: what the structure cannot follow
would outvote any prior otherwise.

For fixed FIR taps the rest is linear and is eliminated (variable projection, Golub and Pereyra 1973); phi over the few
taps is minimised by a trust-region Newton method with its exact Hessian, which never accepts a step that is worse.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.fit.moments import Moments
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.sample import Floats

NEWTON: Any = {"gtol": 1e-4, "maxiter": 100, "initial_trust_radius": 0.5, "max_trust_radius": 8.0}
"""Of the minimisation, in prior deviations of the taps: phi is of the order of the number of parameters, so a gradient
of 1e-4 is a ten thousandth of a standard error."""

COLOUR = 10.0
"""Factor on the error power before it is compared with the prior's residual variance: errors that repeat with the drive
average out that much more slowly than white ones."""

SLACK = 1.001
"""Of the prior's variance where noise is taken off: what the record does not tell has it but for rounding."""

TINY = float(np.finfo(np.float64).tiny)

ROUNDS = 6
"""Most times that the effective number of samples is computed anew from the fit that it led to."""


@dataclass(frozen=True)
class Posterior:
    """Negative log posterior of theta = [A, W, A1, C].

    Attributes
    ----------
    moments : of the record, without ridge.
    prior : of the model.
    effective : number n of samples that the record is worth.
    variance : residual variance rho, where the record's own errors are larger than the prior's; 0: the prior's.
    """

    moments: Moments
    prior: Prior
    effective: float
    variance: float = 0.0

    @property
    def weight(self) -> float:
        """The factor n / rho on the mean square error."""
        return self.effective / (self.variance or self.prior.residual_variance)

    def cost(self, theta: Floats) -> float:
        """Return phi(theta)."""
        away = theta - self.prior.mean
        return self.weight * self.moments.cost(theta) + 0.5 * float(away @ self.prior.information @ away)

    def gradient(self, theta: Floats) -> Floats:
        """Return d phi / d theta, (n,)."""
        pull = self.prior.information @ (theta - self.prior.mean)
        return np.asarray(self.weight * self.moments.gradient(theta) + pull)

    def hessian(self, theta: Floats) -> Floats:
        """Return the Hessian of phi, (n, n)."""
        return np.asarray(self.weight * self.moments.hessian(theta) + self.prior.information)

    def information(self, theta: Floats) -> Floats:
        """Return the Gauss-Newton information n / rho E[x x'] + P0^-1, (n, n), positive definite."""
        return np.asarray(self.weight * self.moments.gauss_newton(theta, ridge=False) + self.prior.information)

    def covariance(self, theta: Floats) -> Floats:
        """Return the covariance of theta, (n, n), in squared normalised units.

        It is the inverse of `information` less what noise in the columns of the load seemed to bring (see
        `online.rls.without_noise`).
        """
        return self._without_noise(theta)[0]

    def compensated(self, theta: Floats) -> Floats:
        """Return theta without what noise in the columns of the load shrinks it by, where the drive tells more."""
        return self._without_noise(theta)[1]

    def _without_noise(self, theta: Floats) -> tuple[Floats, Floats]:
        covariance, theta = self._inverse(theta), theta.copy()
        start = theta.size - self.moments.extensions
        for place, noise in enumerate(self.weight * self.moments.noise, start):
            if not noise > 0.0:
                continue
            own = covariance[place]
            left = 1.0 - 2.0 * noise * own[place]
            rise = 2.0 * noise / left if left > 0.0 else np.inf
            room = np.maximum(SLACK * np.diag(self.prior.covariance) - np.diag(covariance), 0.0)
            most = float(np.min(room / np.maximum(np.square(own), TINY)))
            if rise <= most:
                theta += noise / (1.0 - noise * own[place]) * theta[place] * own
            covariance = covariance + min(rise, most) * np.outer(own, own)
        return covariance, theta

    def _inverse(self, theta: Floats) -> Floats:
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(self.information(theta)), np.eye(theta.size))
        return np.asarray(0.5 * (inverse + inverse.T))

    def eliminate(self, taps: Floats) -> Floats:
        """Return theta of least phi for fixed FIR taps A: the rest is linear."""
        q, known, mean = self.moments.taps, self.prior.information, self.prior.mean
        theta = np.zeros(mean.size)
        theta[:q] = taps
        half = self.moments.pull(theta, self.moments.gram)[q:]  # dt/dtheta of the rest depends on A only
        normal = self.weight * self.moments.pull(theta, np.ascontiguousarray(half.T))[q:] + known[q:, q:]
        target = self.weight * self.moments.pull(theta, self.moments.cross)[q:] + known[q:, q:] @ mean[q:]
        theta[q:] = scipy.linalg.cho_solve(scipy.linalg.cho_factor(normal), target)
        return theta

    def minimum(self, taps: Floats) -> Floats:
        """Return theta at the local minimum that Newton's method reaches from FIR taps `taps`, (q,)."""
        from scipy.optimize import minimize  # noqa: PLC0415 - slow to import

        q = self.moments.taps
        if q == 1 and self.moments.weights == 0:
            return self.eliminate(taps)
        root = self.prior.root[:q, :q]  # steps in prior deviations
        memory: dict[bytes, Floats] = {}

        def theta_at(z: Floats) -> Floats:
            key = z.tobytes()
            if key not in memory:
                memory.clear()
                memory[key] = self.eliminate(taps + root @ z)
            return memory[key]

        def cost(z: Floats) -> float:
            return self.cost(theta_at(z))

        def gradient(z: Floats) -> Floats:
            return np.asarray(root.T @ self.gradient(theta_at(z))[:q])

        def hessian(z: Floats) -> Floats:
            whole = self.hessian(theta_at(z))
            reduced = whole[:q, :q] - whole[:q, q:] @ np.linalg.solve(whole[q:, q:], whole[q:, :q])
            return np.asarray(root.T @ (0.5 * (reduced + reduced.T)) @ root)

        answer = minimize(cost, np.zeros(q), jac=gradient, hess=hessian, method="trust-exact", options=NEWTON)
        return theta_at(_without_slope(np.asarray(answer.x, np.float64), gradient, hessian))

    def degrees_of_freedom(self, theta: Floats) -> float:
        """Return tr(n / rho E[x x'] P): the number of parameters that the record, and not the prior, determines."""
        from_data = self.weight * self.moments.gauss_newton(theta, ridge=False)
        return float(np.sum(from_data * self._inverse(theta)))


def _without_slope(z: Floats, gradient: Callable[[Floats], Floats], hessian: Callable[[Floats], Floats]) -> Floats:
    """Return z, or where Newton's step from it ends if the slope is less there.

    Near the minimum a step changes the cost by less than rounding does, so a trust region that compares costs refuses
    it: of a million samples it left a slope of 0.035, and this step 5e-7.
    """
    slope = gradient(z)
    if np.linalg.norm(slope) < NEWTON["gtol"]:
        return z
    try:
        stepped = z - scipy.linalg.cho_solve(scipy.linalg.cho_factor(hessian(z)), slope)
    except np.linalg.LinAlgError:  # no minimum near: the trust region has run out of its iterations
        return z
    return stepped if np.linalg.norm(gradient(stepped)) < np.linalg.norm(slope) else z


def settle(moments: Moments, prior: Prior, least_leverage: float, taps: Floats) -> tuple[Posterior, Floats]:
    """Return the posterior with its effective number of samples, and its minimum from FIR taps `taps`.

    Parameters
    ----------
    least_leverage : 1 - lambda, share of an error that a sample keeps removing; 0 counts every sample.
    """
    count = float(moments.count)
    posterior = Posterior(moments, prior, count, prior.residual_variance)
    theta = posterior.minimum(taps)
    for _ in range(ROUNDS):
        freedom = posterior.degrees_of_freedom(theta)
        worth = min(count, max(1.0, freedom / least_leverage)) if least_leverage > 0.0 else count
        variance = max(prior.residual_variance, COLOUR * 2.0 * moments.cost(theta))
        if abs(worth / variance - posterior.weight) <= 0.02 * posterior.weight:
            break
        posterior = Posterior(moments, prior, worth, variance)
        theta = posterior.minimum(theta[: moments.taps])
    return posterior, theta
