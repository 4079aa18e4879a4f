"""Scatter after reversals that does not repeat: is it there, and how does it decay?

The residual of one cycle is compared with that of another where a deterministic system would be the same. Two cycles
are sampled at other phases against the reversal, though, and a model error that is sharp there differs by its slope
times the shift: the first samples are left out, and the second cycle is taken at the phase of the first.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.effects.detection import DataView
from friction_estimator.effects.scatter import MAD

LEFT_OUT = 2.5
"""Sample periods after a reversal that are left out."""

LARGEST_SHIFT = 1.0
"""Sample periods by which two cycles may be shifted: farther, they are not the same phase."""

DECAYS_S = (0.01, 0.02, 0.04, 0.06, 0.09, 0.13, 0.2, 0.3, 0.45)
FEWEST_PAIRS, FEWEST_BLOCKS = 500, 6

WILD = 30.0
"""Times the median power: a difference beyond is an outlier's and shortened."""

MEDIAN_POWER = 0.4549
"""Median over mean of the square of a Gaussian."""

STAMPS_NOISE = 0.5
"""Of the noise: what the scatter of the stamps may make of the force's change for a pair to be compared."""

REPEATS = 1e-6
"""Of the force's rms: what differs by less repeats exactly."""

COHERENT = 0.5
"""Share of what is left after reversals, above the noise, that must not repeat. A sharp error of the model that repeats
makes differences, too, since cycles are sampled at other phases."""

LATE = 4.0
"""The scatter must be raised beyond this many times the stretch that is left out as well, or at this share of a decay:
what is in the first samples only is the sampling."""


@dataclass(frozen=True)
class Burst:
    """Variance after reversals that does not repeat.

    Attributes
    ----------
    decay_s : time over which it decays. power_N2 : of the bursts, over the record. amplitude_N : at the reversal.
    p_value : of the t test of the variance's dependence, over blocks, for all decays that were tried.
    likelihood_ratio : 2 log of it against even variance, halved since neighbouring pairs share samples.
    """

    decay_s: float
    power_N2: float
    amplitude_N: float
    amplitude_reach_N: float
    decay_reach_s: float
    p_value: float
    likelihood_ratio: float


def differences(view: DataView) -> tuple[Floats, Ints] | None:
    """Return differences of paired residuals over sqrt 2, (m,), N, and the samples that they belong to, (m,).

    The second of a pair is taken at the first one's time since the reversal, on the straight line between samples.
    """
    if view.pairs is None or view.residual_N is None:
        return None
    residual, since, step = view.residual_N, view.features.since_reversal_s, view.context.step_s
    first, second = view.pairs
    inside = (second > 0) & (second < residual.size - 1) & np.isfinite(since[first]) & np.isfinite(since[second])
    first, second = first[inside], second[inside]
    shift = (since[first] - since[second]) / step
    early = LEFT_OUT * step
    keep = view.used[first] & _whole(view.used, second) & ~view.restart[second] & ~view.restart[second + 1]
    keep &= (since[first] > early) & (since[second] > early) & (np.abs(shift) <= LARGEST_SHIFT)
    first, second, shift = first[keep], second[keep], shift[keep]
    if not first.size:
        return None
    told = _told_apart(view, residual[first] - residual[second], first, second)
    first, second, shift = first[told], second[told], shift[told]
    if first.size < FEWEST_PAIRS:
        return None
    there = np.where(shift >= 0.0, residual[second + 1], residual[second - 1])
    moved = residual[second] + np.abs(shift) * (there - residual[second])
    # A point between two samples has less noise than one on a sample, by (1 - s)^2 + s^2: even it out.
    share = np.abs(shift)
    evened = np.sqrt(1.0 + np.square(1.0 - share) + np.square(share))
    return (residual[first] - moved) / evened, first


def _told_apart(view: DataView, difference: Floats, first: Ints, second: Ints) -> Bools:
    """Return in which pairs the force changes by less than noise while the stamps scatter, (m,).

    A cycle is compared with another at another time by that scatter, which makes (dF/dt)^2 var(t) of difference.
    """
    force, step, last = view.force_N, view.context.step_s, view.force_N.size - 1
    off = np.abs(np.diff(view.features.time_s) - step)
    scatter_s = MAD * float(np.median(off)) / np.sqrt(2.0)
    noise = float(np.sqrt(np.median(np.square(difference)) / (2.0 * MEDIAN_POWER)))
    rise = sum(force[np.minimum(k + 1, last)] - force[np.maximum(k - 1, 0)] for k in (first, second)) / (4.0 * step)
    return np.asarray(np.abs(rise) * scatter_s <= STAMPS_NOISE * noise)


def _whole(used: Bools, index: Ints) -> Bools:
    return np.asarray(used[index - 1] & used[index] & used[index + 1])


def find_burst(view: DataView) -> Burst | None:
    """Regress the incoherent variance on exp(-2 t_rev / decay), block by block, and test its mean slope."""
    found = differences(view)
    if found is None or view.residual_N is None:
        return None
    difference, first = found
    since, block, residual = view.features.since_reversal_s[first], view.block[first], view.residual_N[first]
    power = np.square(difference)
    if float(np.median(power)) < (REPEATS * view.context.force_rms_N) ** 2:
        return None
    capped = np.minimum(power, WILD * float(np.median(power)) / MEDIAN_POWER)
    best, best_gain = None, 0.0
    for decay in DECAYS_S:
        shape = np.exp(-2.0 * since / decay)
        slope, error, count = _mean_slope(shape, capped, block)
        gain = slope * slope * float(np.square(shape - shape.mean()).sum())
        if slope > 0.0 and gain > best_gain:
            best, best_gain = (decay, slope / max(error, 1e-300), count), gain
    if best is None:
        return None
    decay, t_value, count = best
    if incoherent_share(difference, residual, np.exp(-2.0 * since / decay)) < COHERENT:
        return None
    late = since > min(LATE * LEFT_OUT * view.context.step_s, 0.5 * decay)
    slope, error, several = _mean_slope(np.exp(-2.0 * since[late] / decay), capped[late], block[late])
    later = slope / max(error, 1e-300) if several >= FEWEST_BLOCKS else 0.0
    p_values = [
        float(scipy.special.stdtr(count - 1, -t_value)),
        float(scipy.special.stdtr(max(several, 2) - 1, -later)),
    ]
    return _burst_of(since, power, min(1.0, len(DECAYS_S) * max(p_values)))


def incoherent_share(difference: Floats, residual: Floats, weight: Floats) -> float:
    """Return the power of the differences over that of the residuals, both above the usual one, by these weights."""
    usual = float(np.median(np.square(difference))) / MEDIAN_POWER
    differs, left = (float(weight @ (np.square(values) - usual)) for values in (difference, residual))
    return differs / left if left > 0.0 else 1.0


def _mean_slope(shape: Floats, power: Floats, block: Ints) -> tuple[float, float, int]:
    """Return the slope of power over shape, its standard error from the scatter over blocks, and their number."""
    spread = float(np.square(shape - shape.mean()).sum()) if shape.size else 0.0
    numbers = np.unique(block)
    slopes = []
    for number in numbers:
        inside = block == number
        mine = shape[inside] - shape[inside].mean()
        energy = float(mine @ mine)
        if energy > 1e-3 * spread / numbers.size:
            slopes.append((float(mine @ power[inside]) / energy, energy))
    if len(slopes) < FEWEST_BLOCKS:
        return 0.0, 1.0, len(slopes)
    values, energies = np.array(slopes).T
    weight = energies / energies.sum()
    mean = float(weight @ values)
    error = float(np.sqrt(np.square(weight) @ np.square(values - mean)) * np.sqrt(len(values) / (len(values) - 1)))
    return mean, error, len(slopes)


def _burst_of(since: Floats, power: Floats, p_value: float) -> Burst:
    """Fit var(t_rev) = s^2 + A^2 / 2 exp(-2 t_rev / decay) to the mean power in bins, by the Gaussian likelihood.

    -2 log L = sum_bins n_bin (log m + p / m) for mean power p and model m; intervals where it rises by 8, twice what
    independent samples would need.
    """
    edges = np.unique(np.quantile(since, np.linspace(0.0, 1.0, 161)))
    cell = np.clip(np.searchsorted(edges, since, side="right") - 1, 0, edges.size - 2)
    count = np.bincount(cell, minlength=edges.size - 1).astype(np.float64)
    keep = count > 0
    mean = np.bincount(cell, weights=power, minlength=edges.size - 1)[keep] / count[keep]
    when = np.bincount(cell, weights=since, minlength=edges.size - 1)[keep] / count[keep]
    count = count[keep]
    usual = float(np.quantile(mean, 0.4))
    decays = np.geomspace(0.005, 1.0, 60)
    heights = usual * np.geomspace(0.02, 5e3, 120)
    losses = np.full((decays.size, heights.size), np.inf)
    for floor in usual * np.linspace(0.85, 1.1, 6):
        for i, decay in enumerate(decays):
            model = floor + heights[:, None] * np.exp(-2.0 * when / decay)
            losses[i] = np.minimum(losses[i], (np.log(model) + mean / model) @ count)
    flat = float(mean @ count / count.sum())
    ratio = float(count.sum() * (np.log(flat) + 1.0) - losses.min())
    best = np.unravel_index(int(np.argmin(losses)), losses.shape)
    inside = losses <= losses.min() + 8.0
    decay, height = float(decays[best[0]]), float(heights[best[1]])
    likely = decays[inside.any(axis=1)]
    high = np.sqrt(2.0 * heights[inside.any(axis=0)])
    amplitude = float(np.sqrt(2.0 * height))
    return Burst(
        decay_s=decay,
        power_N2=height * float(np.mean(np.exp(-2.0 * since / decay))),
        amplitude_N=amplitude,
        amplitude_reach_N=float(max(high.max() - amplitude, amplitude - high.min(), 0.1 * amplitude)),
        decay_reach_s=float(max(likely.max() - decay, decay - likely.min(), 0.1 * decay)),
        p_value=p_value,
        likelihood_ratio=0.5 * ratio,
    )
