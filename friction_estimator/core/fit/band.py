"""The learned curve with its 95 % band, and the standard deviation of a prediction.

What a curve may err by at a velocity has two parts: what the samples left open of the parameters,

    J C J',   C = posterior covariance under residuals that repeat with the drive (`prior.residual_deviation`)

and what no parameter can follow, the misfit. The latter is read off the errors themselves, cell of velocity by cell:
the mean product of an error with the one before it is the power of all that is not white (a sensor's noise averages
out), so a film that lags, which bends the curve differently on the way up and down, shows as a wide band there. Beyond
the velocities seen the band widens with the distance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core import sums
from friction_estimator.core.fit.posterior import COLOUR
from friction_estimator.core.model.basis import Basis
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import CHUNK, Model
from friction_estimator.core.sample import Bools, Floats, Samples

COUNT, POWER, PRODUCT = range(3)
"""Columns of a table of running errors: samples in the cell, mean e[k]^2 and mean e[k] e[k-1], normalised."""

MEMORY = 64.0
"""Samples in a cell over which its errors are averaged."""

POINTS = 401
"""Of a curve."""

MISFIT_FACTOR = 3.0
"""A misfit counts for this many times its power in a prediction on another drive: on the one that was learned, taps and
curve were bent to hide it (benchmarks/transfer)."""

CURVE_FACTOR, SPARSE_FACTOR = 1.35, 6.0
"""The same for the curve, and where samples skip cells: between two of them the curve is bent to neither."""

NOISE_QUANTILE, NOISE_MARGIN = 0.1, 1.5
"""The quietest cells show the sensor's noise; what exceeds it by more than the scatter of a mean of `MEMORY` squares is
misfit, even where the shaft crosses a cell in less than a sample and the products say nothing."""

REACH = 5
"""Cells on either side whose largest errors a prediction may have: at another acceleration they come elsewhere."""

CLEARLY, SCATTER = 1.6, 0.25
"""Ratio of two means of `MEMORY` squares, and share of a mean product in them, that white noise does not reach."""

NEIGHBOURS = 1
"""Cells on either side whose misfit counts for a cell too: taps smear what happens in one over the next."""

NORMAL_95 = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""

EXTRAPOLATION = 0.5
"""Standard deviation of the curve, in force units, at twice the fastest speed that was learned; grows in proportion to
the distance."""


@dataclass(frozen=True)
class Curve:
    """Friction at constant velocity with a 95 % band.

    Attributes
    ----------
    velocity_m_s : (m,).
    friction_N, low_N, high_N : (m,), N.
    learned_share : (m,), share of the prior variance of the curve that the data removed; None for laws without
        covariance.
    pressure_Pa, temperature_degC : gauge pressure and temperature that the curve holds for.
    """

    velocity_m_s: Floats
    friction_N: Floats
    low_N: Floats
    high_N: Floats
    learned_share: Floats | None
    pressure_Pa: float
    temperature_degC: float


@njit(cache=True, forceinline=True)
def note_error(errors, cell, error, last, follows):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Add an error to its cell's running means; `last` is the error of the sample before, where it `follows`."""
    row = errors[cell]
    row[COUNT] += 1.0
    gain = 1.0 / min(row[COUNT], MEMORY)
    row[POWER] += gain * (error * error - row[POWER])
    if follows:
        row[PRODUCT] += gain * (error * last - row[PRODUCT])


@njit(cache=True, forceinline=True)
def usual_variance(errors, cell, unknown):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the variance of a prediction's error at a cell: its power, and what is coloured of it.

    Where a cell in reach has clearly larger errors, theirs count; `unknown` where none in reach was seen.
    """
    power = product = most = 0.0
    fewest = np.inf
    # Without a branch: what was not seen has neither power nor product.
    for near in range(max(0, cell - REACH), min(errors.shape[0], cell + REACH + 1)):
        row = errors[near]
        fewest, most = min(fewest, row[COUNT]), max(most, row[COUNT])
        power, product = max(power, row[POWER]), max(product, row[PRODUCT])
    if most == 0.0:
        return unknown
    if fewest == 0.0:
        return SPARSE_FACTOR * power + MISFIT_FACTOR * product
    own = errors[cell]
    if power < CLEARLY * own[POWER] and product < CLEARLY * max(own[PRODUCT], SCATTER * own[POWER]):
        power, product = own[POWER], own[PRODUCT]
    return power + MISFIT_FACTOR * max(product - SCATTER * power, 0.0)


@njit(cache=True)
def _note_errors(errors, cell, error, use, restart, first):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Fill a table of running errors from the samples of a record, `first` and those behind it."""
    for k in range(first, error.size):
        if use[k]:
            follows = k > 0 and use[k - 1] and not restart[k]
            note_error(errors, cell[k], error[k], error[k - 1] if follows else 0.0, follows)


def errors_by_cell(
    basis: Basis, velocity_m_s: Floats, error: Callable[[slice], Floats], use: Bools, restart: Bools
) -> Floats:
    """Return the table of running errors, (cell_count, 3).

    Parameters
    ----------
    velocity_m_s : (n,). error : gives the errors in a part of the record, in normalised units.
    use, restart : (n,), the samples that count, and those that do not follow the one before.
    """
    errors = np.zeros((basis.cell_count, 3))
    for part in sums.parts(velocity_m_s.size, CHUNK):  # the basis' rows come with the cells
        first = min(part.start, 1)  # the one before comes along
        here = slice(part.start - first, part.stop)
        cell = basis.cells(velocity_m_s[here])
        _note_errors(errors, cell, np.ascontiguousarray(error(here)), use[here], restart[here], first)
    return errors


def misfit_variance(errors: Floats) -> Floats:
    """Return the power of the errors that are not white, by cell, (cells,); neighbours stand in for empty cells."""
    power, seen = _filled(errors, POWER), errors[:, COUNT] > 1.0
    white = NOISE_MARGIN * float(np.quantile(power[seen] if seen.any() else power, NOISE_QUANTILE))
    coloured = _filled(errors, PRODUCT) - power / np.sqrt(MEMORY)  # less its standard error: white noise is no misfit
    power = np.maximum(np.maximum(coloured, power - white), 0.0)
    skipped = _largest_about(np.asarray(errors[:, COUNT] <= 1.0, np.float64)) > 0.0
    return np.where(skipped, SPARSE_FACTOR, CURVE_FACTOR) * _largest_about(power)


def _largest_about(values: Floats) -> Floats:
    """Return the largest value of each cell and its neighbours, (cells,)."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, NEIGHBOURS, "edge"), 2 * NEIGHBOURS + 1)
    return np.asarray(around.max(axis=1))


def _filled(errors: Floats, column: int) -> Floats:
    """Return a column of the running errors, (cells,), empty cells from their neighbours; 1 where nothing was seen."""
    seen = np.flatnonzero(errors[:, COUNT] > 1.0)
    if not seen.size:
        return np.ones(errors.shape[0])
    return np.asarray(np.interp(np.arange(errors.shape[0]), seen, errors[seen, column]))


def beyond_variance(beyond: Floats) -> Floats:
    """Return the variance of extrapolation, normalised, at relative distances `beyond` outside the range."""
    return np.asarray(np.square(EXTRAPOLATION * beyond))


def median_conditions(model: Model, samples: Samples | None) -> tuple[float, float]:
    """Return the median gauge pressure (Pa) and temperature (degC) of samples; defaults where there are none."""
    settings = model.config.theory
    pressure, temperature = settings.default_pressure, settings.default_temperature
    if samples is not None and samples.pressure_Pa is not None and np.isfinite(samples.pressure_Pa).any():
        pressure = float(np.nanmedian(samples.pressure_Pa)) - settings.ambient_pressure
    if samples is not None and samples.temperature_degC is not None and np.isfinite(samples.temperature_degC).any():
        temperature = float(np.nanmedian(samples.temperature_degC))
    return pressure, temperature


def static_curve(
    model: Model,
    theta: Floats,
    errors: Floats,
    spread: Callable[[Floats], Floats] | None,
    prior: Prior,
    conditions: tuple[float, float],
    velocity_m_s: Floats | None = None,
) -> Curve:
    """Return the friction at constant velocity with its 95 % band.

    Parameters
    ----------
    theta : (n,), parameters. errors : (cells, 3), table of running errors.
    spread : takes gradients J (m, n), returns J C J' of each row with C the covariance of theta, (m,), normalised; None
        for laws that have none: then the running errors alone count.
    conditions : gauge pressure (Pa) and temperature (degC).
    velocity_m_s : (m,), where; `POINTS` evenly over the learned velocities unless given.
    """
    low, high = model.basis.reach
    velocity = np.linspace(low, high, POINTS) if velocity_m_s is None else np.asarray(velocity_m_s, np.float64)
    theory = model.theory_at(velocity, *conditions)
    friction, gradient = model.steady_state(theta, velocity, theory)
    cell = model.basis.cells(velocity)
    variance = misfit_variance(errors)[cell] + beyond_variance(model.beyond(velocity))
    share = None
    if spread is None:
        power = np.where(errors[:, COUNT] > 0.0, errors[:, POWER], np.max(errors[:, POWER], initial=0.0))
        variance = variance + power[cell]
    else:
        after = np.maximum(spread(gradient), 0.0)
        before = np.sum((gradient @ prior.covariance) * gradient, axis=1)
        left = np.clip(after / np.maximum(before, np.finfo(float).tiny), 0.0, 1.0)
        share = np.where(before > 0.0, 1.0 - left, 0.0)
        # Where the errors are smaller than the prior took them to be, what was learned is known better than P says;
        # what was not learned is not.
        measured = np.minimum(COLOUR * _filled(errors, POWER) / prior.residual_variance, 1.0)
        measured = np.where(errors[:, COUNT] > 1.0, measured, 1.0)[cell]
        variance = variance + after * np.maximum(measured, left)
    half = NORMAL_95 * model.unit_N * np.sqrt(variance)
    return Curve(velocity, friction, friction - half, friction + half, share, *conditions)
