"""Compiled: a row into the delay lines, the prediction and its gradient. All that predicts goes this way.

With theta = [A, W, A1, C] (FIR taps, wavelet weights, theory taps, extension coefficients) the model is

    f_hat[k] = sum_i A_i W' Psi[k-i] + sum_i A1_i d[k-i] + C' z[k]

and its gradient, the regressor x of every law, is [F, A(q) Psi, F1, z] with F_i = W' Psi[k-i] for the present W (Kwak,
Yagle, Levitt 1998, section 3; the printed F1 repeats lag 0, which is read as a misprint).

The loops over weights are what a sample costs. They take three rows of Psi at a time, the oldest first (the newest was
just written entry by entry, and reading it as vectors has to wait for that), each row in whole cache lines whose spare
entries are zero (`addresses.placed`): nothing is left over that vectors do not take.
"""

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.addresses import LINE, padded
from friction_estimator.core.sample import Floats, Ints

TAPS, WEIGHTS, THEORY_TAPS, EXTENSIONS = range(4)
"""Places in `Model.shape`."""

HEAD = 0
"""Place in `status` of the number of rows that were put into the delay lines since they were restarted, less one."""


def delay_lines(shape: Ints) -> tuple[Floats, Floats, Ints]:
    """Return empty delay lines: ring, (taps, padded weights), ring_theory, (max(theory taps, 1),), and status."""
    taps, weights, theory_taps, _ = shape
    return np.zeros((taps, padded(int(weights)))), np.zeros(max(1, theory_taps)), np.array([-1], np.int64)


@njit(cache=True, forceinline=True)
def push(shape, ring, ring_theory, status, index, value, theory, restart):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Put the newest row into the delay lines; a restart fills them with it (as if it had stood there)."""
    taps = shape[TAPS]
    status[HEAD] = 0 if restart else status[HEAD] + 1
    row = ring[status[HEAD] % taps]
    for k in range(row.size):
        row[k] = 0.0
    for k in range(index.size):
        row[np.uint32(index[k])] = value[k]  # unsigned: else each entry is asked whether it counts from the end
    if restart:
        for i in range(1, taps):
            for k in range(row.size):
                ring[i, k] = row[k]
        for i in range(ring_theory.size):
            ring_theory[i] = theory
    else:
        ring_theory[status[HEAD] % ring_theory.size] = theory


# Without numba's reference counts, which parts of arrays would have: ten calls a sample.
@njit(cache=True, restrict=True, _nrt=False, fastmath={"reassoc", "contract"})
def regress(shape, theta, ring, ring_theory, status, extension, x):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill the gradient x and return the prediction.

    Behind the last entries of theta and x there is room for a cache line, which is read and written.
    """
    taps, theory_taps, size = shape[TAPS], shape[THEORY_TAPS], ring.shape[1]
    start = taps + shape[WEIGHTS]
    w, filtered = theta[taps:], x[taps:]
    for k in range(size):
        filtered[k] = 0.0
    prediction = 0.0
    # In threes: where taps are no multiple, what lies behind the oldest of them counts for nothing.
    lag = taps - 1 + -taps % 3
    place = (status[HEAD] - lag) % taps
    while lag >= 2:
        row_a = ring[place]
        place = place + 1 if place + 1 < taps else 0
        row_b = ring[place]
        place = place + 1 if place + 1 < taps else 0
        row_c = ring[place]
        place = place + 1 if place + 1 < taps else 0
        tap_a = theta[lag] if lag < taps else 0.0
        tap_b = theta[lag - 1] if lag - 1 < taps else 0.0
        tap_c = theta[lag - 2]
        g_a = g_b = g_c = 0.0
        for k in range(size):
            a, b, c, weight = row_a[k], row_b[k], row_c[k], w[k]
            g_a += a * weight
            g_b += b * weight
            g_c += c * weight
            filtered[k] += tap_a * a + tap_b * b + tap_c * c
        if lag < taps:
            x[lag] = g_a
        if lag - 1 < taps:
            x[lag - 1] = g_b
        x[lag - 2] = g_c
        prediction += tap_a * g_a + tap_b * g_b + tap_c * g_c
        lag -= 3
    place = status[HEAD] % ring_theory.size
    for i in range(theory_taps):
        lagged = ring_theory[place]
        place = place - 1 if place > 0 else theory_taps - 1
        x[start + i] = lagged
        prediction += theta[start + i] * lagged
    start += theory_taps
    for i in range(shape[EXTENSIONS]):
        x[start + i] = extension[i]
        prediction += theta[start + i] * extension[i]
    return prediction


@njit(cache=True)
def rubbing(shape, theta, extension, last, known):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the size of the load, the known one and the first `last` columns of the extension with their weights."""
    start = theta.size - shape[EXTENSIONS]
    total = known
    for i in range(last):
        total += theta[start + i] * extension[i]
    return abs(total)


@njit(cache=True, nogil=True)
def predict_fixed(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    index, value, theory, extension, known, last, restart, predicted, shape, theta, ring, ring_theory, status
):
    """Fill `predicted`, (n,), with the output of fixed parameters.

    Parameters
    ----------
    index, value : (n, width), rows of Psi. theory : (n,), d. extension : (n, columns). restart : (n,) bool.
    known : (n, 1), the known load, where column `last` of the extension is the sign of friction that follows the load,
        else (n, 0).
    shape, theta : of the model.
    ring, ring_theory, status : from `delay_lines`, updated in place, so that a record can be taken in parts.
    """
    x, roomy = np.zeros(theta.size + LINE), np.zeros(theta.size + LINE)
    roomy[: theta.size] = theta
    for k in range(predicted.size):
        push(shape, ring, ring_theory, status, index[k], value[k], theory[k], restart[k] or status[HEAD] < 0)
        if known.shape[1] > 0:
            extension[k, last] *= rubbing(shape, theta, extension[k], last, known[k, 0])
        predicted[k] = regress(shape, roomy, ring, ring_theory, status, extension[k], x)
