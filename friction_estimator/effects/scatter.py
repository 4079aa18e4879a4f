"""What detectors measure of channels: lattices, noise under a smooth signal, the local scale of a residual."""

from itertools import pairwise

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.effects.detection import DataView
from friction_estimator.effects.features import Features

MAD = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""

CELLS = 24
"""Equally likely cells of a variable in which a local deviation is measured."""

FEWEST_LEVELS = 5
"""Distinct values; with fewer any two spacings look alike."""

POLYNOMIALS = (5, 9, 17, 33, 65, 129)
"""Samples of the local cubics that smooth a noisy channel."""

AGREE = 2.0
"""Standard deviations of a local cubic by which it may lie from what the shorter ones tell."""

FEWEST_DIFFERENCES = 100

WEIGHINGS, LOWEST_SPECTRUM = 4, 0.1
"""Fits of a noise's spectrum, and the share of its mean below which what was fitted weighs no more."""

WINDOWS = (5, 11, 25, 51, 101, 201)
"""Samples of running medians."""

LOCAL, FAR_OFF = 11, 4.5
"""Samples over which the mean of what was taken off is judged, and deviations that it may have."""

SHORTENED = 0.02
"""Relative: what shortening the largest differences takes off the deviation of coloured noise."""

AT_REST = 2e-3
"""Share of the top speed below which the shaft may be standing."""


def lattice_step(values: Floats) -> float:
    """Return the spacing of the lattice that the values lie on, or 0 where they do not repeat.

    >>> round(lattice_step(np.round(np.random.default_rng(0).normal(size=4000), 1)), 6)
    0.1
    """
    distinct = np.unique(values)
    if distinct.size < FEWEST_LEVELS or values.size < 4 * distinct.size:
        return 0.0
    gaps = np.diff(distinct)
    step = float(np.quantile(gaps, 0.05))
    near = gaps[gaps < 1.5 * step]
    step = float(near.mean())
    if step <= 0.0:
        return 0.0
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if np.quantile(off, 0.98) < 0.02 else 0.0


def lattice_interval(values: Floats, step: float) -> tuple[float, float, float]:
    """Return the spacing fitted to all levels, and the ends of its 95 % interval."""
    distinct = np.unique(values)
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(distinct) / step))])
    centred = number - number.mean()
    energy = float(centred @ centred)
    fitted = float(centred @ distinct) / energy
    rest = distinct - distinct.mean() - fitted * centred
    spread = float(np.sqrt(rest @ rest / max(rest.size - 2, 1) / energy))
    reach = float(scipy.special.stdtrit(max(rest.size - 2, 1), 0.975)) * spread + 1e-9 * fitted
    return fitted, fitted - reach, fitted + reach


def moving_share(view: DataView, start: Ints, stop: Ints) -> Floats:
    """Return for each run of samples the share in which the shaft moves on, (runs,)."""
    total = np.concatenate([[0.0], np.cumsum(moving(view))])
    return np.asarray((total[stop] - total[start]) / np.maximum(stop - start, 1))


def moving(view: DataView) -> Bools:
    """Return where the shaft moves on: a shaft at rest repeats its force, and so does a steady one without noise."""
    v = view.features.velocity_m_s
    fast = np.abs(v) > AT_REST * view.context.top_speed_m_s
    steady = np.zeros(v.size, np.bool_)
    steady[1:] = v[1:] == v[:-1]
    same = np.zeros(v.size, np.bool_)
    same[1:] = view.force_N[1:] == view.force_N[:-1]
    natural = steady & fast
    if natural.any() and float(same[natural].mean()) > 0.5:
        fast &= ~steady
    return np.asarray(fast)


def since_reversal_s(features: Features) -> Floats:
    """Return the time since the last reversal, (n,), s, finite: before the first one it is long ago."""
    return np.where(np.isfinite(features.since_reversal_s), features.since_reversal_s, 1e9)


def local_scale(features: Features, used: Bools, residual: Floats) -> Floats:
    """Return the robust local standard deviation of a residual, (n,): by time since the reversal, speed and time.

    Cells of the time overlap by half: where noise rises within one, it is there in most of the next.
    """
    since = since_reversal_s(features)
    whole = np.linspace(0.0, 1.0, CELLS + 1)[1:-1]
    between = (np.arange(CELLS) + 0.5) / CELLS
    speed, time_s = np.abs(features.velocity_m_s), features.time_s
    scale = np.zeros(residual.size)
    for values, shares in ((since, whole), (speed, whole), (time_s, whole), (time_s, between)):
        cell = np.searchsorted(np.quantile(values, shares), values)
        for number in range(cell.max() + 1):
            inside = cell == number
            good = residual[inside & used]
            if good.size > 20:
                scale[inside] = np.maximum(scale[inside], MAD * np.median(np.abs(good - np.median(good))))
    return np.maximum(scale, 1e-300)


def noise_under(values: Floats, restart: Bools, blocks: int = 12) -> tuple[float, float, float] | None:
    """Return the deviation of the noise on a smooth channel and its 95 % interval, or None where there is none.

    By third differences, of which a smooth channel has few: for white noise of variance s^2 they have variance 20 s^2
    and correlation -3/4 from one to the next. The interval is that of the mean over parts of the record.
    """
    third = values[3:] - 3.0 * values[2:-1] + 3.0 * values[1:-2] - values[:-3]
    third = third[~(restart[3:] | restart[2:-1] | restart[1:-2])]
    third = third[np.isfinite(third)]
    if third.size < FEWEST_DIFFERENCES:
        return None
    spread = MAD * float(np.median(np.abs(third - np.median(third))))
    # A channel that changes its profile jumps now and then: such differences are shortened.
    third = np.clip(third, -4.0 * spread, 4.0 * spread)
    if float(np.mean(third[1:] * third[:-1])) >= -0.2 * float(np.mean(np.square(third))):
        return None
    power = noise_power(third)
    parts = np.array([noise_power(part) for part in np.array_split(third, blocks)])
    error = float(parts.std(ddof=1)) / np.sqrt(blocks)
    if power <= 0.0:
        return None
    deviation = float(np.sqrt(power))
    reach = float(np.hypot(scipy.special.stdtrit(blocks - 1, 0.975) * error / (2.0 * deviation), SHORTENED * deviation))
    return deviation, deviation - reach, deviation + reach


def unrepeated_N2(view: DataView) -> float:
    """Return the power of what does not repeat from cycle to cycle in the residual of a view, N^2.

    Where no pairs of samples were sought, or too few found, that of the whole residual.
    """
    assert view.residual_N is not None
    if view.pairs is not None:
        first, second = view.pairs
        both = view.used[first] & view.used[second]
        if np.count_nonzero(both) >= FEWEST_DIFFERENCES:
            return 0.5 * float(np.mean(np.square(view.residual_N[first[both]] - view.residual_N[second[both]])))
    return float(np.mean(np.square(view.residual_N[view.used])))


def noise_power(third: Floats) -> float:
    """Return the variance of the noise under third differences.

    Noise of variance s^2 and correlation r from one sample to the next has the spectrum s^2 (1 + 2 r cos w), of which
    third differences make (2 sin(w / 2))^6 times that. s^2 and 2 r s^2 are fitted to their periodogram by least
    squares, from half of the highest frequency on: below lies what a moving channel leaves. The periodogram scatters as
    much as it is high, so what was fitted weighs the next fit (Whittle's likelihood, by its scores).
    """
    periodogram = np.square(np.abs(np.fft.rfft(third))) / third.size
    w = 2.0 * np.pi * np.arange(periodogram.size) / third.size
    high = w >= 0.5 * np.pi
    spectrum = periodogram[high] / np.power(2.0 * np.sin(0.5 * w[high]), 6.0)
    if not np.isfinite(spectrum).all():
        return 0.0
    shapes, weight = np.column_stack([np.ones(spectrum.size), np.cos(w[high])]), np.ones(spectrum.size)
    for _ in range(WEIGHINGS):
        fitted = np.linalg.lstsq(shapes * weight[:, None], spectrum * weight, rcond=None)[0]
        lowest = max(LOWEST_SPECTRUM * abs(float(fitted[0])), float(np.finfo(np.float64).tiny))
        weight = 1.0 / np.maximum(shapes @ fitted, lowest)
    return float(max(fitted[0], 0.0))


def held_levels(values: Floats, restart: Bools, deviation: float) -> Floats:
    """Return the channel without noise of this deviation, (n,): running medians, which keep steps.

    The window grows at each sample as long as what it takes off has no mean of its own there.
    """
    from scipy.ndimage import median_filter, uniform_filter1d  # noqa: PLC0415 - slow to import

    best = values.copy()
    edges = np.append(np.flatnonzero(restart), values.size)
    for a, b in pairwise(edges):
        growing = np.ones(b - a, np.bool_)
        for window in WINDOWS:
            out = median_filter(values[a:b], window, mode="mirror")
            off = np.abs(uniform_filter1d(values[a:b] - out, LOCAL, mode="mirror"))
            # Noise of a moving average of two has twice the mean power of white noise.
            growing &= off < FAR_OFF * deviation * np.sqrt(2.0 / LOCAL)
            best[a:b] = np.where(growing, out, best[a:b])
    return best


def smoothed(values: Floats, restart: Bools, deviation: float) -> Floats:
    """Return the channel without white noise of this deviation, (n,): local cubics, gap-free piece by piece.

    At each sample the longest window counts whose interval has a point in common with those of all shorter ones and of
    the sample alone: intersection of confidence intervals (Katkovnik, IEEE Trans. Signal Processing 47(9), 1999). So
    the window is long where the channel is smooth, and short beside a corner. From one window to a longer one the share
    grows over a quarter of the latter's length: a step in a velocity would be an acceleration.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - slow to import

    out = values.copy()
    begins = np.flatnonzero(np.append(True, restart[1:]))
    ends = np.append(begins[1:], values.size)
    whole = np.logical_and.reduceat(np.isfinite(values), begins)
    low, high = values - AGREE * deviation, values + AGREE * deviation
    for window in POLYNOMIALS:
        long = whole & (ends - begins > window)
        if not long.any():
            break
        half, cubic = window // 2, _projection(window)
        reach = AGREE * deviation * np.linalg.norm(cubic, axis=1)
        first, last = (at[long, None] + np.arange(window) for at in (begins, ends - window))
        smooth, width = np.convolve(values, cubic[half], "same"), np.full(values.size, reach[half])
        for place, rows in ((first[:, :half], slice(half)), (last[:, half + 1 :], slice(half + 1, None))):
            smooth[place], width[place] = values[first if rows.start is None else last] @ cubic[rows].T, reach[rows]
        low, high = np.maximum(low, smooth - width), np.minimum(high, smooth + width)
        agrees = np.repeat(long, ends - begins) & (low <= high)
        share = agrees * uniform_filter1d(agrees.astype(np.float64), max(3, window // 4))
        out[agrees] += (share * (smooth - out))[agrees]
    return out


def _projection(window: int) -> Floats:
    """Return what makes of the values in a window those of the cubic that fits them best, (window, window)."""
    powers = np.vander(np.linspace(-1.0, 1.0, window), 4)
    return np.asarray(powers @ np.linalg.pinv(powers))
