"""The compiled sample loop that replay and the live node share.

One sample is: push the new row into the delay lines, predict, learn. `run` does this over arrays; the node calls
it with arrays of one. All state lives in the arrays of `Workspace`, so it can be copied, compared and restored bit
for bit. `model.prediction` has the prediction and its gradient x, the regressor of every law.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.addresses import (
    LINE,
    Addresses,
    Layout,
    bools,
    float_blocks,
    float_rows,
    floats,
    int32_rows,
    ints,
    lines,
    table_at,
)
from friction_estimator.core.fit.band import EXTRAPOLATION, note_error, usual_variance
from friction_estimator.core.intake.standstill import stands, stays, stopping
from friction_estimator.core.model.load import DOUBTFUL
from friction_estimator.core.model.prediction import EXTENSIONS, TAPS, push, regress, rubbing
from friction_estimator.core.model.structure import Inputs
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.lms import LMS, learn_lms
from friction_estimator.core.online.nlms import NLMS, learn_nlms
from friction_estimator.core.online.recovery import (
    FORMER,
    HELD,
    PRESENT,
    alarming,
    begin_hold,
    judge,
    predicted_by,
    surprise_of,
)
from friction_estimator.core.online.rls import PULL_EVERY, RLS, learn_rls, mistaken, project, pull, without_noise
from friction_estimator.core.online.steps import dot
from friction_estimator.core.sample import Bools, Floats, Samples

CLIP = 6.0
"""Errors beyond this many running rms are shortened before nlms and rls learn from them (Huber)."""

ERROR_MEMORY = 200.0
"""Samples over which the running error power is averaged."""

LEAST_POWER = 1e-12
"""Floor of the running powers: float noise of a perfect model is no alarm."""

LEAST_EXCITATION, LARGEST_EXCITATION = 1e-14, 1e14
"""rls learns from samples whose x' P x lies between: below there is nothing to learn, above rounding would rule."""

KNOWN_LEVERAGE = 0.1
"""Errors where x' P x is larger tell of what was not learned yet, not of what cannot be: the band leaves them out."""

MISFIT_MEMORY = 5000.0
"""Samples over which the power of known errors is averaged."""

LARGEST_RESIDUAL = 1.0
"""Force units: an error beyond the friction's own size is a fault, and tells nothing of how well the model fits."""

GROW_AFTER = 20
"""Samples in a row beyond an edge of the range after which it grows: a wild velocity is alone."""

DECIDED_AFTER = 4
"""The first of these, which say how far. While the others come a live estimator gets ready, in more pauses than
`growth.Growth` has parts."""


@njit(cache=True)
def _beyond(moments, status, velocity, beyond, learn):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Count samples in a row beyond one edge; return whether the range is to grow."""
    if beyond == 0.0 or not learn:
        status[at.BEYOND] = 0
        return False
    side = 1 if velocity > 0.0 else -1
    if status[at.BEYOND] * side <= 0:
        status[at.BEYOND] = 0
        moments[at.NEAREST] = moments[at.FARTHEST] = velocity
    status[at.BEYOND] += side
    if abs(status[at.BEYOND]) <= DECIDED_AFTER:
        if abs(velocity) < abs(moments[at.NEAREST]):
            moments[at.NEAREST] = velocity
        if abs(velocity) > abs(moments[at.FARTHEST]):
            moments[at.FARTHEST] = velocity
    return status[at.MAY_GROW] == 1 and abs(status[at.BEYOND]) >= GROW_AFTER


@njit(cache=True, forceinline=True)
def noise_in(theta, shape, column_noise):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the variance that noise in the columns of the load gives a prediction."""
    start = theta.size - shape[EXTENSIONS]
    total = 0.0
    for load in range(column_noise.size):
        total += theta[start + load] * theta[start + load] * column_noise[load]
    return total


@njit(cache=True, forceinline=True)
def doubt_in(theta, shape, column_doubt, root, law):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the square of what the doubt about the acceleration does to a prediction and its target.

    Of a coefficient the mean square counts, theta_j^2 + P_jj: a load that nothing is known of yet may be large.
    """
    total = 0.0
    for load in range(column_doubt.size):
        if column_doubt[load] > 0.0:
            if load == column_doubt.size - 1:  # that of the known load
                total += column_doubt[load]
                continue
            place = theta.size - shape[EXTENSIONS] + load
            square = theta[place] * theta[place]
            if root.shape[0] > 0:
                square += law[at.RESIDUAL_VARIANCE] * dot(root[place], root[place])
            total += square * column_doubt[load]
    return total


SAMPLES = Layout(
    index=np.int32,
    value=np.float64,
    cell=np.int64,
    beyond=np.float64,
    velocity=np.float64,
    position=np.float64,
    theory=np.float64,
    extension=np.float64,
    column_noise=np.float64,
    column_doubt=np.float64,
    known=np.float64,
    target=np.float64,
    restart=np.bool_,
    learn=np.bool_,
    predicted=np.float64,
    deviation=np.float64,
)
"""What `run` takes of n samples.

index, value : (n, width), rows of Psi. cell : (n,), cell of the velocity. beyond : (n,), relative distance outside
    the range. velocity : (n,), m/s. position : (n,), m, NaN where unknown, or (0,).
theory : (n,), d. extension : (n, columns).
    column_noise : (n, loads), variance of the noise in the columns of the load.
    known : (n, 1), known load, where the last of these is the sign of friction that follows the load, else (n, 0).
    target : (n,), measured friction.
    All finite; forces in normalised units.
restart, learn : (n,).
predicted, deviation : (n,), filled with the a priori prediction and its standard deviation.
"""

_S, _W = SAMPLES.at, at.LAYOUT.at


def batch(inputs: Inputs, samples: Samples, learn: Bools, predicted: Floats, deviation: Floats) -> Addresses:
    """Return samples as `run` takes them; see `SAMPLES`. What it reads may be strided, what it fills may not."""
    read: dict[str, NDArray[Any]] = {
        "index": inputs.index,
        "value": inputs.value,
        "cell": inputs.cell,
        "beyond": inputs.beyond,
        "velocity": samples.velocity_m_s,
        "position": np.zeros(0) if samples.position_m is None else samples.position_m,
        "theory": inputs.theory,
        "extension": inputs.extension,
        "column_noise": inputs.noise,
        "column_doubt": inputs.doubt,
        "known": inputs.known,
        "target": inputs.target,
        "restart": inputs.restart,
        "learn": learn,
    }
    read = {name: np.ascontiguousarray(array) for name, array in read.items()}
    return SAMPLES.addresses(**read, predicted=predicted, deviation=deviation)


@njit(cache=True, nogil=True)
def run(law_number, samples, work):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Predict and learn over n samples, or until the range is to grow.

    Parameters
    ----------
    law_number : LMS, NLMS or RLS.
    samples : address of the table of a `batch`. work : of that of a `Workspace`, which is updated in place.

    Returns
    -------
    0, or, where the range is to grow, the number of samples taken: the caller has to see to it before it goes on.
    """
    samples, work = table_at(samples, len(_S)), table_at(work, len(_W))
    index, value = int32_rows(samples, _S.index), float_rows(samples, _S.value)
    cell, beyond = ints(samples, _S.cell), floats(samples, _S.beyond)
    velocity, theory, target = floats(samples, _S.velocity), floats(samples, _S.theory), floats(samples, _S.target)
    extension, column_noise = float_rows(samples, _S.extension), float_rows(samples, _S.column_noise)
    column_doubt = float_rows(samples, _S.column_doubt)
    known, restart, learn = float_rows(samples, _S.known), bools(samples, _S.restart), bools(samples, _S.learn)
    position = floats(samples, _S.position)
    predicted, deviation = floats(samples, _S.predicted), floats(samples, _S.deviation)

    shape, theta = ints(work, _W.shape), floats(work, _W.theta)
    ring, ring_theory = float_rows(work, _W.ring), floats(work, _W.ring_theory)
    root, mean = float_rows(work, _W.root), floats(work, _W.mean)
    information, prior_root = float_rows(work, _W.information), float_rows(work, _W.prior_root)
    residual = floats(work, _W.residual)
    noise, owed, law = float_rows(work, _W.noise), floats(work, _W.owed), floats(work, _W.law)
    moments, status, errors = floats(work, _W.moments), ints(work, _W.status), float_rows(work, _W.errors)
    rest, hold, trial = floats(work, _W.rest), floats(work, _W.hold), float_rows(work, _W.trial)
    kept, kept_root = float_rows(work, _W.kept), float_blocks(work, _W.kept_root)
    scratch = float_rows(work, _W.scratch)

    n = theta.size
    begin = -shape[TAPS] % LINE
    x, projected, gain = scratch[0, begin : begin + n], scratch[1], scratch[2, begin : begin + n]
    theta_lines, metric_lines = lines(work, _W.theta, begin), lines(work, _W.prior, begin)
    x_lines, gain_lines = scratch[0, : theta_lines.size], scratch[2, : theta_lines.size]
    settled = shape[TAPS] - 1
    last = noise.shape[0] - 1
    follows = known.shape[1] > 0
    for k in range(target.size):
        begins = restart[k] or status[at.SEEN] == 0
        push(shape, ring, ring_theory, status, index[k], value[k], theory[k], begins)
        status[at.SEEN] += 1
        scale = law[at.TOP_SPEED]
        steady = position.size > 0 and stays(rest, position[k], velocity[k], begins, scale)
        standing = stands(rest, velocity[k], begins, scale) or steady
        holding = hold[at.HOLDING] == 1.0
        if holding:
            # Scratch that the challenger's own prediction fills anew.
            if follows:
                sign = extension[k, last]
                extension[k, last] = sign * rubbing(shape, kept[HELD, :n], extension[k], last, known[k, 0])
            held, held_variance = predicted_by(
                kept[HELD], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            held_variance += noise_in(kept[HELD, :n], shape, column_noise[k])
            if law_number == RLS:
                held_variance += law[at.RESIDUAL_VARIANCE] * project(kept_root[HELD], x, projected)
            if follows:
                extension[k, last] = sign * rubbing(shape, kept[FORMER, :n], extension[k], last, known[k, 0])
            former, former_variance = predicted_by(
                kept[FORMER], cell[k], extension[k], shape, theta, owed, errors, ring, ring_theory, status, x
            )
            former_variance += noise_in(kept[FORMER, :n], shape, column_noise[k])
            if follows:
                extension[k, last] = sign
            hold[at.HELD_SINCE] += 1.0
        if follows:
            extension[k, last] *= rubbing(shape, theta, extension[k], last, known[k, 0])
        predicted[k] = regress(shape, theta, ring, ring_theory, status, extension[k], x)
        error = target[k] - predicted[k]
        variance = usual_variance(errors, cell[k], moments[at.ERROR_POWER])
        r = 0.0
        open_variance = noise_in(theta, shape, column_noise[k])
        if law_number == RLS:
            r = project(root, x, projected)
            open_variance += law[at.RESIDUAL_VARIANCE] * r
        variance += open_variance
        outside = EXTRAPOLATION * beyond[k]
        doubt = doubt_in(theta, shape, column_doubt[k], root, law)
        doubtful = doubt > DOUBTFUL * variance
        deviation[k] = np.sqrt(variance + doubt + outside * outside)
        if holding:
            predicted[k] = held
            deviation[k] = np.sqrt(held_variance + hold[at.HELD_POWER] + doubt + outside * outside)
        limit = CLIP * np.sqrt(moments[at.ERROR_POWER])
        clipped = min(max(error, -limit), limit)
        moving = abs(velocity[k]) > law[at.LEAST_SPEED]
        if moving and not doubtful:
            moments[at.ERROR_POWER] += (clipped * clipped - moments[at.ERROR_POWER]) / ERROR_MEMORY
            moments[at.ERROR_POWER] = max(moments[at.ERROR_POWER], LEAST_POWER)
        if beyond[k] > 0.0:
            status[at.OUTSIDE] += 1
            status[at.FOLLOWS] = 0
            if _beyond(moments, status, velocity[k], beyond[k], learn[k]):
                return k + 1
            continue
        status[at.BEYOND] = 0
        if doubtful:
            status[at.FOLLOWS] = 0
            continue
        if learn[k] and (standing or (law_number != LMS and stopping(rest, velocity[k], scale))):
            # Below breakaway friction is whatever holds the shaft: the band may know how much that is, the curve not.
            # lms, the paper's to the letter, learns until the rest is known.
            status[at.STOOD] += standing
            status[at.FOLLOWS] = 0
            if r < KNOWN_LEVERAGE:
                note_error(errors, cell[k], clipped, 0.0, np.bool_(False))
            continue
        # lms is the paper's to the letter; the others wait until the delay lines hold measured samples only.
        if not learn[k] or (law_number != LMS and status[at.HEAD] < settled):
            status[at.FOLLOWS] = 0
            continue
        status[at.LEARNED] += 1
        if r < KNOWN_LEVERAGE:
            if moving:
                moments[at.MISFIT_POWER] += (clipped * clipped - moments[at.MISFIT_POWER]) / MISFIT_MEMORY
            note_error(errors, cell[k], clipped, moments[at.LAST_ERROR], status[at.FOLLOWS] == 1 and not begins)
            moments[at.LAST_ERROR] = clipped
            status[at.FOLLOWS] = 1
        else:
            status[at.FOLLOWS] = 0
        if law_number == LMS:
            learn_lms(shape, theta, law, moments, status, theta_lines, x_lines, error)
            continue
        if clipped != error:
            status[at.CLIPPED] += 1
        if holding:
            row, former_row = kept[HELD], kept[FORMER]
            judge(
                hold, kept, kept_root, trial, theta, owed, errors, moments, residual, status, root, law,
                velocity[k], cell[k], target[k] - held,
                surprise_of(row, target[k] - held, held_variance, moments, law),
                surprise_of(former_row, target[k] - former, former_variance, moments, law),
                surprise_of(row, error, held_variance, moments, law),
            )  # fmt: skip
            if hold[at.HOLDING] == 0.0:
                continue
        elif law_number == NLMS or law[at.LEAST_LEVERAGE] > 0.0:
            if law_number == RLS and error * error > variance:
                open_variance += mistaken(shape, root, noise, x, gain)
            if alarming(
                hold, kept, theta, owed, errors, moments, residual, velocity[k], cell[k], error, open_variance, law
            ):
                hold[at.HELD_SINCE] = 0.0
                begin_hold(
                    hold, kept, kept_root, trial, theta, owed, errors, moments, residual, status, root, prior_root,
                    mean, error,
                )  # fmt: skip
                continue
        if law_number == NLMS:
            learn_nlms(shape, theta, ring, law, status, theta_lines, metric_lines, x_lines, gain, gain_lines, clipped)
            continue
        # Of linear least squares the sum of e^2 / (1 + r) is the sum of the squares that a fit to all samples leaves.
        bounded = min(abs(error), max(limit, LARGEST_RESIDUAL))
        memory = min(float(status[at.LEARNED]), MISFIT_MEMORY)
        residual[PRESENT] += (bounded * bounded / (1.0 + r) - residual[PRESENT]) / memory
        if LEAST_EXCITATION < r < LARGEST_EXCITATION:
            w = learn_rls(shape, theta, ring, law, moments, status, root, error, clipped, projected, r, gain)
            for load in range(noise.shape[0]):
                noise[load, 0] += w * column_noise[k, load]
        status[at.UNPULLED] += 1
        if status[at.UNPULLED] >= PULL_EVERY:
            status[at.UNPULLED] = 0
            without_noise(shape, theta, root, prior_root, noise, status, gain)
            pull(theta, root, mean, information, owed, moments, status, projected, gain)
    return 0
