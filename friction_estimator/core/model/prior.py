"""What is believed of a model before any sample: one Gaussian, shared by rls, the batch fit and nlms' metric.

    Hammerstein    A ~ N(e0, S),   S_ij = deviation^2 decay^max(i, j)
    parallel       A, A1 ~ N(e0, S/6 given that the taps sum to 1) + N(0, gain^2) e0
    W  ~ N(0, diag(d_m^2)) given g(0) ~ 0,   d_m = deviation 2^(slope (m - M))
    C  ~ N(0, 100^2)   in force units for the load, in the term's own unit for what a diagnosis added

with e0 = [1, 0, ..] and S the TC kernel (Chen, Ohlsson and Ljung 2012): H and H1 pass their input through, impulse
responses die out smoothly (Pillonetto and De Nicolao 2010), g is smooth, and where nothing was seen nothing is learned.
In the parallel model, where two filters share the dynamics, static gains are held apart from the shapes: the scale of
the curve belongs to g and to the theory's gain, and taps that sum to more than one are what fast reversals teach and
slow ones suffer from. Beside an unknown load the same is done in both models: free gains learned while the load is
not known yet keep its mark for long. `rest_deviation` says how exactly g vanishes at standstill: a film that lags bends
the curve there, and on a drive that rests half of the time such an offset would be the whole error.

The misfit of a model repeats with the drive and is no white noise, so `residual_deviation` is several times what is
left over: a thousand samples of one sine say little more than a hundred (docs/decisions/0003-one-prior.md).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from friction_estimator.core.model.structure import Model
from friction_estimator.core.sample import Floats
from friction_estimator.core.triangular import inverse

LEAST_SHARE = 1e-9
"""Least share of a variance that conditioning leaves: below, rounding would make the covariance indefinite."""

PARALLEL_SHARE = 0.4
"""Of `prior.tap_deviation` in the parallel model: both filters act on the same reversals. A Stribeck curve that was
found from the drive's own samples leaves little to g, and its filter has the dynamics for itself: it takes all."""

METRIC_SLOPE, METRIC_TAP, PARALLEL_METRIC_TAP = 0.5, 0.1, 0.03
"""Of nlms: exponent of a weight's level, and deviations of taps against coarse weights. In the parallel model g starts
at zero and says nothing of the taps behind it: noise would move looser ones."""

LOAD_DEVIATION, LOAD_METRIC = 100.0, 0.3
"""Of a load coefficient in force units: its prior deviation (any load is possible), and its metric deviation."""

SHARE_DEVIATION = 0.3
"""Of the share of the load that joins the friction: a few per cent in most gears, a half in a worm."""

ASYMMETRY_DEVIATION = 0.5
"""Force units by which friction may differ between the directions as a whole, where a load that does not is unknown:
a constant and an unlike Coulomb friction differ at standstill only, where nothing is learned."""

ASYMMETRY_WIDTH, ASYMMETRY_POINTS = 0.02, 512
"""Share of the speed scale over which that difference sets in, and points at which it is fitted with the basis."""

EXTENSION_DEVIATION = 100.0
"""Of a coefficient of an extension term in a unit of the term's own, such as a mass: how large one is nobody knows."""

EXTENSION_FORCE = 20.0
"""The same in force units where the coefficient is a force: on every rig alike, and no more than it can be."""

MEASURED = 3.0
"""Of the rms of the coefficients of one cause that a diagnosis measured, where it did: what hardly shows in a column,
as a ripple where the shaft stands, does not make them a hundred times as large."""

LEAST_MEASURED = 0.01
"""Force units: the least of these deviations."""


@dataclass(frozen=True)
class Prior:
    """Gaussian over theta = [A, W, A1, C] in normalised units.

    Attributes
    ----------
    mean : (n,).
    covariance : (n, n), symmetric positive definite.
    residual_variance : variance rho that one sample is taken to err with, in squared force units.
    metric : (n,), squared deviations by which nlms scales its steps. Finer weights and taps than the prior's would
        allow move too: a step along one gradient reaches a weight only through its own function.
    """

    mean: Floats
    covariance: Floats
    residual_variance: float
    metric: Floats

    @classmethod
    def of(cls, model: Model) -> "Prior":
        """Return the prior of a structure, from `prior.*` of its configuration."""
        settings = model.config.prior
        taps, weights, theory_taps, beside = (int(v) for v in model.shape)
        load, extensions = model.load.size, beside - model.load.size
        mean = np.zeros(model.size)
        mean[0] = 1.0
        if theory_taps:
            mean[taps + weights] = 1.0
        deviation = settings.weight_deviation * model.basis.prior_scale(settings.weight_slope)
        rest = model.basis.rows(np.zeros(1))
        at_rest = np.zeros(weights)
        if model.basis.reach[0] <= 0.0 <= model.basis.reach[1]:
            at_rest[rest[0][0]] = rest[1][0]
        nonlinear = conditioned(np.diag(deviation**2), at_rest, settings.rest_deviation)
        if model.load.even:
            step = ASYMMETRY_DEVIATION * even_step(model, nonlinear)
            nonlinear = nonlinear + np.outer(step, step)
            nonlinear[np.diag_indices_from(nonlinear)] *= 1.0 + LEAST_SHARE  # where the step is all there is
        mean[mean.size - extensions :], extension = measured_terms(model)
        alone = not theory_taps or model.config.finds_stribeck
        shared = settings.tap_deviation * (1.0 if alone else PARALLEL_SHARE)
        decay = settings.tap_decay
        covariance = block_diagonal(
            impulse_response(taps, shared, decay, settings.gain_deviation)
            if theory_taps or load
            else decaying(taps, settings.tap_deviation, decay),
            nonlinear,
            impulse_response(theory_taps, shared, decay, settings.theory_gain_deviation),
            np.diag([SHARE_DEVIATION**2 if part.load.follows else LOAD_DEVIATION**2 for part in model.load.unknown]),
            np.diag(extension**2),
        )
        tap = PARALLEL_METRIC_TAP if theory_taps else METRIC_TAP
        metric = [
            np.full(taps, tap),
            model.basis.prior_scale(METRIC_SLOPE),
            np.full(theory_taps, METRIC_TAP),
            np.full(load, LOAD_METRIC),
            np.ones(extensions),
        ]
        return cls(mean, covariance, settings.residual_deviation**2, np.square(np.concatenate(metric)))

    @cached_property
    def root(self) -> Floats:
        """Lower triangular square root of the covariance, (n, n)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @cached_property
    def inverse_root(self) -> Floats:
        """Inverse of `root`, (n, n)."""
        return inverse(self.root)

    @cached_property
    def information(self) -> Floats:
        """Inverse of the covariance, (n, n)."""
        return np.asarray(self.inverse_root.T @ self.inverse_root)

    @property
    def deviation(self) -> Floats:
        """Prior standard deviation of each parameter, (n,)."""
        return np.sqrt(np.diag(self.covariance))


def measured_terms(model: Model) -> tuple[Floats, Floats]:
    """Return mean and deviation of the coefficients of extension terms, (columns,): what a diagnosis knows of them."""
    extension = model.extension
    if extension is None:
        return np.zeros(0), np.zeros(0)
    unit_N, given = model.config.unit_N, model.config.learned.extension_weights
    mean = np.array(given) if len(given) == extension.size else np.zeros(extension.size)
    deviation = np.where(extension.forces, EXTENSION_FORCE * unit_N, EXTENSION_DEVIATION)
    names = np.array(extension.names)
    for name in set(extension.names):
        of_it = extension.forces & (names == name)
        if mean[of_it].any():
            rms_N = float(np.sqrt(np.mean(np.square(mean[of_it]))))
            deviation[of_it] = max(MEASURED * rms_N, LEAST_MEASURED * unit_N)
    return mean, deviation


def even_step(model: Model, covariance: Floats) -> Floats:
    """Return the weights of g(v) = |tanh(v / v_s)|, (size,): friction that is one unit more one way and less the other.

    Parameters
    ----------
    covariance : (size, size), prior of the weights: of those that fit alike the most probable are taken.
    """
    low, high = model.basis.reach
    top = max(abs(low), abs(high))
    # Finer about standstill, where the step is.
    velocity = top * np.linspace(-1.0, 1.0, ASYMMETRY_POINTS) ** 3
    velocity = velocity[(velocity >= low) & (velocity <= high)]
    index, value = model.basis.rows(velocity)
    dense = np.zeros((velocity.size, model.basis.size))
    np.put_along_axis(dense, index.astype(np.int64), value, axis=1)
    wanted = np.abs(np.tanh(velocity / (ASYMMETRY_WIDTH * top)))
    # In deviations of the weights the system has their number, not that of the points.
    root = np.linalg.cholesky(covariance)
    columns = dense @ root
    gram = columns.T @ columns
    noise = LEAST_SHARE**0.5 * float(np.trace(gram)) / velocity.size
    return np.asarray(root @ np.linalg.solve(gram + noise * np.eye(len(gram)), columns.T @ wanted))


def block_diagonal(*blocks: Floats) -> Floats:
    """Return square matrices along a diagonal, (n, n): scipy's in a tenth of the time, which a growing range waits for.

    >>> block_diagonal(np.eye(1), np.full((2, 2), 3.0))
    array([[1., 0., 0.],
           [0., 3., 3.],
           [0., 3., 3.]])
    """
    total = np.zeros((sum(map(len, blocks)),) * 2)
    start = 0
    for block in blocks:
        end = start + len(block)
        total[start:end, start:end] = block
        start = end
    return total


def conditioned(covariance: Floats, direction: Floats, deviation: float) -> Floats:
    """Return the covariance once direction' x was found to be 0 with this standard deviation, (n, n)."""
    along = covariance @ direction
    before = float(direction @ along)
    power = before + max(deviation**2, LEAST_SHARE * before)
    return np.asarray(covariance - np.outer(along, along) / power if before > 0.0 else covariance)


def impulse_response(taps: int, deviation: float, decay: float, gain_deviation: float) -> Floats:
    """Return the covariance of FIR taps, (taps, taps): decaying, with a static gain known apart from their shape.

    The TC kernel given that the taps sum to 0, plus the gain's variance on the first tap.

    >>> np.round(impulse_response(2, 1.0, 0.5, 0.3), 2)
    array([[ 0.19, -0.1 ],
           [-0.1 ,  0.1 ]])
    """
    if not taps:
        return np.zeros((0, 0))
    shape = conditioned(decaying(taps, deviation, decay), np.ones(taps), 0.0)
    shape[0, 0] += gain_deviation**2
    return shape


def decaying(taps: int, deviation: float, decay: float) -> Floats:
    """Return the TC kernel deviation^2 decay^max(i, j), (taps, taps).

    >>> decaying(2, 1.0, 0.5)
    array([[1. , 0.5],
           [0.5, 0.5]])
    """
    lag = np.arange(taps)
    return np.asarray(deviation**2 * decay ** np.maximum.outer(lag, lag).astype(np.float64))
