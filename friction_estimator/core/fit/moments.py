"""Second moments of a recording, and the cost of a model as a polynomial in its parameters.

The output of both models is bilinear in the FIR taps A and the rest, so with the over-parameterised coefficients

    t = [A_0 W, A1_0, A_1 W, A1_1, ..., C]                     (Kronecker, Bai 1998)

it is linear, f_hat = t' z with z[k] = [Psi[k], d[k], Psi[k-1], d[k-1], ..., extension[k]], and the mean square error is

    C(theta) = 1/2 (E f^2 - 2 t' E[z f] + t' (E[z z'] + ridge) t).

A recording is read once, into E[z z'], E[z f] and E f^2; cost, gradient and Hessian are then exact at a price that does
not depend on its length. C is quadratic in t and quartic in theta.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core import sums
from friction_estimator.core.errors import ConfigError, UnanswerableError
from friction_estimator.core.metrics import leave_out_restarts
from friction_estimator.core.model.structure import Inputs, Model
from friction_estimator.core.sample import Bools, Floats, Ints, Samples

BLOCK = 4096
"""Samples made dense at a time."""

LARGEST_PRODUCT = 4096
"""Largest number of over-parameterised coefficients: their moments take 8 N^2 bytes."""

RIDGE = 1e-8
"""Mean square output, in normalised units, that a coefficient of one prior deviation costs: 1e-4 of the friction's rms,
far below any load cell. What the record does not excite stays at zero."""

FREE_SLOPE, FREE_THEORY_TAP = 0.5, 0.1
"""How the ridge of a free fit scales: exponent of a weight's level, and the deviation of a theory tap."""


@dataclass(frozen=True)
class Moments:
    """Mean products of one recording in normalised units, and the cost that they define.

    Attributes
    ----------
    taps, weights, theory_taps, extensions : sizes of the blocks of theta = [A, W, A1, C].
    gram : (N, N), E[z z'] + diag(ridge).
    cross : (N,), E[z f].
    power : E f^2.
    ridge : (N,), what was added to the diagonal.
    count : samples that the means are over.
    noise : (loads,), mean variance of the noise in the columns of the load, the first of the extensions.
    """

    taps: int
    weights: int
    theory_taps: int
    extensions: int
    gram: Floats
    cross: Floats
    power: float
    ridge: Floats
    count: int
    noise: Floats

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.taps + self.weights + self.theory_taps + self.extensions

    def coefficients(self, theta: Floats) -> Floats:
        """Return t(theta), (N,)."""
        a, w = theta[: self.taps], theta[self.taps : self.taps + self.weights]
        lagged = np.zeros((self.taps, self._stride))
        lagged[:, : self.weights] = np.outer(a, w)
        if self.theory_taps:
            lagged[:, -1] = theta[self.taps + self.weights :][: self.taps]
        return np.concatenate([lagged.ravel(), theta[self.size - self.extensions :]])

    def pull(self, theta: Floats, rows: Floats) -> Floats:
        """Return (dt/dtheta)' rows, (n_parameters, ...), for rows (N, ...)."""
        a, w = theta[: self.taps], theta[self.taps : self.taps + self.weights]
        end = self.taps * self._stride
        lagged = rows[:end].reshape(self.taps, self._stride, *rows.shape[1:])
        nonlinear = lagged[:, : self.weights]
        parts = [np.einsum("ij...,j->i...", nonlinear, w), np.tensordot(a, nonlinear, axes=1)]
        if self.theory_taps:
            parts.append(lagged[:, -1])
        return np.concatenate([*parts, rows[end:]])

    def cost(self, theta: Floats) -> float:
        """Return C(theta): half the mean square error plus half the ridge's penalty."""
        t = self.coefficients(theta)
        return 0.5 * float(self.power - 2.0 * t @ self.cross + t @ self.gram @ t)

    def gradient(self, theta: Floats) -> Floats:
        """Return dC/dtheta, (n_parameters,)."""
        return self.pull(theta, self.gram @ self.coefficients(theta) - self.cross)

    def gauss_newton(self, theta: Floats, *, ridge: bool = True) -> Floats:
        """Return E[x x'] of the gradient regressor x, (n_parameters, n_parameters), with or without the ridge."""
        half = self.pull(theta, self.gram)
        if not ridge:
            half -= self.pull(theta, np.diag(self.ridge))
        return self.pull(theta, np.ascontiguousarray(half.T))

    def hessian(self, theta: Floats) -> Floats:
        """Return the Hessian of C: Gauss-Newton plus the cross term of A and W, weighted by the residual."""
        hessian = self.gauss_newton(theta)
        residual = self.gram @ self.coefficients(theta) - self.cross
        lagged = residual[: self.taps * self._stride].reshape(self.taps, self._stride)[:, : self.weights]
        a, w = slice(0, self.taps), slice(self.taps, self.taps + self.weights)
        hessian[a, w] += lagged
        hessian[w, a] += lagged.T
        return hessian

    def eliminate(self, taps: Floats) -> Floats:
        """Return theta of least cost for fixed FIR taps A: the rest is linear (variable projection)."""
        theta = np.zeros(self.size)
        theta[: self.taps] = taps
        # With A fixed, dt/dtheta of the other blocks does not depend on them.
        half = self.pull(theta, self.gram)[self.taps :]
        normal = self.pull(theta, np.ascontiguousarray(half.T))[self.taps :]
        theta[self.taps :] = solve(normal, self.pull(theta, self.cross)[self.taps :])
        return theta

    @property
    def _stride(self) -> int:
        return self.weights + (1 if self.theory_taps else 0)


def solve(matrix: Floats, target: Floats) -> Floats:
    """Solve a positive semidefinite system, target (n,) or (n, k); below rounding the least-norm answer is given."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix * scale[:, None] * scale
    right = (target.T * scale).T
    try:
        answer = scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled), right)
    except np.linalg.LinAlgError:
        answer = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True) @ right
    return np.asarray((answer.T * scale).T)


def products(model: Model) -> int:
    """Return the number of over-parameterised coefficients of a structure."""
    taps, weights, theory_taps, extensions = (int(v) for v in model.shape)
    return taps * (weights + (1 if theory_taps else 0)) + extensions


def gather(
    model: Model,
    samples: Samples,
    use: Bools | bool = True,
    ridge: float = RIDGE,
    load_weights: Floats | None = None,
) -> Moments:
    """Read a recording into its moments.

    The delay lines are those of `kernels`: at a restart they are filled with the first row. Samples outside the basis'
    velocity range, or not in `use`, carry no equation but stay in the delay lines of those that follow.

    With r_i[k] the row of lag i, G_ij = sum_k r_i r_j' obeys G_(i+1)(j+1) = G_ij + (first rows) - (last rows) of each
    run of consecutive samples, since the lags shift; only G_0j are summed over the record (the displacement structure
    of the covariance method of linear prediction).

    Parameters
    ----------
    model : structure, with units set.
    samples : the recording.
    use : (n,) or one value, the samples to fit.
    ridge : penalty on a coefficient of one prior deviation, see `RIDGE`.
    load_weights : coefficients of the load, from which friction that follows it has its column; 0 unless given.

    Raises
    ------
    UnanswerableError : no sample to fit. ConfigError : the structure has more than `LARGEST_PRODUCT` coefficients.
    """
    if products(model) > LARGEST_PRODUCT:
        taps, weights = model.shape[:2]
        raise ConfigError(
            f"the batch fit of {taps} taps and {weights} weights has {products(model)} products, more than "
            f"{LARGEST_PRODUCT}: lower fir.order, or set a larger basis.velocity_unit or basis.finest_level"
        )
    used = fitted(model, samples, use)
    if not used.any():
        raise UnanswerableError("no sample lies inside basis.velocity_range, with its past: nothing to fit")
    if model.extension is not None:
        model.extension.restart()
    weights = np.zeros(model.load.size) if load_weights is None else load_weights
    blocks = (
        model.inputs(samples[begin : begin + BLOCK]).under_load(weights) for begin in range(0, len(samples), BLOCK)
    )
    return accumulate(model, blocks, samples.restart, used, ridge)


def accumulate(model: Model, blocks: Iterable[Inputs], restart: Bools, used: Bools, ridge: float) -> Moments:
    """Return the moments of inputs that come block by block; see `gather`.

    Parameters
    ----------
    model : structure, with units set.
    blocks : consecutive parts of the record.
    restart, used : (n,), of the whole record: where the delay lines start anew, and the samples to fit (at least one).
    ridge : penalty on a coefficient of one prior deviation, see `RIDGE`.
    """
    taps, weights, theory_taps, extensions = (int(v) for v in model.shape)
    stride = weights + (1 if theory_taps else 0)
    total = products(model)
    count = int(np.count_nonzero(used))
    lagged = np.zeros((taps, stride, stride))  # G_0j
    displaced = np.zeros((taps - 1, taps - 1, stride, stride))  # G_(i+1)(j+1) - G_ij
    others = extensions + 1  # extension columns and the target
    cross = np.zeros((taps, stride, others))
    small = np.zeros((others, others))
    noise = np.zeros(model.load.size)
    dense = np.zeros((0, stride))
    begin = segment = 0
    for inputs in blocks:
        place = np.arange(begin, begin + inputs.target.size)
        first_of = _segment_starts(place, restart[place[0] : place[-1] + 1], segment)
        segment = int(first_of[-1])
        past = dense[dense.shape[0] - min(taps - 1, dense.shape[0]) :]
        dense = np.concatenate([past, _dense(inputs, weights, stride)])
        oldest = begin - past.shape[0]
        begin += inputs.target.size
        lag_places = [np.maximum(place - i, first_of) - oldest for i in range(taps)]
        keep = used[place, None]
        now = dense[lag_places[0]] * keep
        plain = np.column_stack([inputs.extension, inputs.target]) * keep
        for i in range(taps):
            rows = dense[lag_places[i]]
            lagged[i] += now.T @ rows
            cross[i] += rows.T @ plain
        small += plain.T @ plain
        noise += keep[:, 0] @ inputs.noise
        at_start, at_end = _run_ends(used, restart, place[0], begin)
        first = [dense[at[at_start]] for at in lag_places]
        last = [dense[at[at_end]] for at in lag_places]
        for i in range(taps - 1):
            for j in range(taps - 1):
                if at_start.size:
                    displaced[i, j] += first[i + 1].T @ first[j + 1]
                if at_end.size:
                    displaced[i, j] -= last[i].T @ last[j]
    lags = np.empty((taps, stride, taps, stride))
    for i in range(taps):
        lags[0, :, i] = lagged[i]
        lags[i, :, 0] = lagged[i].T
    for i in range(taps - 1):
        for j in range(taps - 1):
            lags[i + 1, :, j + 1] = lags[i, :, j] + displaced[i, j]
    gram = np.empty((total, total))
    end = taps * stride
    gram[:end, :end] = lags.reshape(end, end)
    del lags, displaced
    gram[:end, end:] = cross[:, :, :-1].reshape(end, extensions)
    gram[end:, :end] = gram[:end, end:].T
    gram[end:, end:] = small[:-1, :-1]
    gram += gram.T
    gram *= 0.5
    gram /= count
    penalty = _penalty(model, ridge)
    gram[np.diag_indices(total)] += penalty
    return Moments(
        taps=taps,
        weights=weights,
        theory_taps=theory_taps,
        extensions=extensions,
        gram=gram,
        cross=np.concatenate([cross[:, :, -1].ravel(), small[:-1, -1]]) / count,
        power=float(small[-1, -1]) / count,
        ridge=penalty,
        count=count,
        noise=noise / count,
    )


def fitted(model: Model, samples: Samples, use: Bools | bool = True) -> Bools:
    """Return which samples of a record carry an equation, (n,): those in `use`, inside the range, with their past.

    The samples that follow a restart err by several deviations, since it fills the delay lines as if the shaft had
    stood there, and would bend a fit. The first sample of a record restarts them too.
    """
    n = len(samples)
    used = np.array(np.broadcast_to(np.asarray(use, np.bool_), (n,)))
    for part in sums.parts(n):
        used[part] &= model.basis.inside(samples.velocity_m_s[part])
    memory = int(model.shape[0]) - 1
    used[:memory] = False
    leave_out_restarts(used, samples.restart, memory)
    return used


def _run_ends(used: Bools, restart: Bools, begin: int, end: int) -> tuple[Ints, Ints]:
    """Return where in [begin, end) runs of consecutive used samples start and where they end, from `begin` on."""
    known = np.zeros(end - begin + 2, np.bool_)  # with the sample before and the one behind
    low, high = max(begin - 1, 0), min(end + 1, used.size)
    known[low - begin + 1 : high - begin + 1] = used[low:high]
    goes_on = known[1:] & known[:-1]  # sample k with the one before it
    goes_on[: high - begin] &= ~restart[begin:high]
    own = known[1:-1]
    return np.flatnonzero(own & ~goes_on[:-1]), np.flatnonzero(own & ~goes_on[1:])


def _segment_starts(place: Ints, restart: Bools, before: int) -> Ints:
    """Return for each sample of a block the index of the first of its segment, (n,); `before` the block it is that."""
    return np.maximum.accumulate(np.where(restart, place, before))


def _dense(inputs: Inputs, weights: int, stride: int) -> Floats:
    """Return the rows [Psi, d], (n, stride)."""
    dense = np.zeros((inputs.target.size, stride))
    np.put_along_axis(dense[:, :weights], inputs.index.astype(np.int64), inputs.value, axis=1)
    if stride > weights:
        dense[:, -1] = inputs.theory
    return dense


def _penalty(model: Model, ridge: float) -> Floats:
    """Return the ridge of each coefficient, smaller for coarse weights: g of a free fit is no rougher than it must be.

    The penalty on A_i W_j sums to ridge |A|^2 sum_j (W_j / s_j)^2: it does not change along the scale orbit.
    """
    taps, _, theory_taps, extensions = (int(v) for v in model.shape)
    row = np.concatenate([model.basis.prior_scale(FREE_SLOPE), np.full(min(theory_taps, 1), FREE_THEORY_TAP)])
    return ridge * np.concatenate([np.tile(row, taps), np.ones(extensions)]) ** -2.0
