"""Faults of the data, looked for before a cause is: repaired or masked, then the base is fitted again.

The tests here measure against what noise of any colour and of uneven strength would do, since a test that assumes
white noise calls coloured noise outliers.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import binom

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.features import Context

LEAST_SHARE = 0.002
"""Of the error power: less is not worth a name."""

SPIKE = 4.8
"""Robust standard deviations of an innovation that count as a spike; white Gaussian noise has one in 600,000."""
FEWEST_SPIKES = 4

FEWEST_TIES = 8
SMOOTHING = 9
"""Samples of the Savitzky-Golay window that repairs a noisy velocity."""

FAST = 0.05
"""Share of the top speed: slower, a gap in the data looks like a jump of the clock."""

MOST_JUMPS = 3
"""A clock is set once or twice. More are pieces put together with a gap at each joint (`import --segment`)."""

MISMATCH = 0.02
"""Relative difference of velocity and position's derivative that counts."""


@dataclass(frozen=True)
class Finding:
    """A fault of the data.

    Attributes
    ----------
    name : effect id. p_value : of the test. values : name -> (value, unit, low, high).
    used : (n,) bool, samples that remain after masking, or None. velocity_m_s : (n,) repaired, or None.
    power_N2 : power of the error that it makes, N^2; 0 where it makes none in the force.
    """

    name: str
    p_value: float
    values: dict[str, tuple[float, str, float, float]]
    used: Bools | None = None
    velocity_m_s: Floats | None = None
    power_N2: float = 0.0
    words: str = ""
    extra: dict[str, float] = field(default_factory=dict)


def lattice_step(values: Floats) -> float:
    """Return the spacing of the lattice that the values lie on, or 0 where they do not repeat.

    >>> round(lattice_step(np.round(np.random.default_rng(0).normal(size=4000), 1)), 6)
    0.1
    """
    distinct = np.unique(values)
    if distinct.size < 2 or values.size < 4 * distinct.size:
        return 0.0
    gaps = np.diff(distinct)
    step = float(np.quantile(gaps, 0.05))
    near = gaps[gaps < 1.5 * step]
    step = float(near.mean())
    if step <= 0.0:
        return 0.0
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if np.quantile(off, 0.98) < 0.02 else 0.0


def quantization(record: Record, error_power: float) -> Finding | None:
    """Find a lattice whose rounding error, step^2 / 12, is a share of the error power worth a name."""
    force = record.friction_N[record.used]
    step = lattice_step(force)
    power = step * step / 12.0
    if step == 0.0 or power < LEAST_SHARE * error_power:
        return None
    reach = step * 1e-3
    return Finding(
        "quantization",
        1e-12,
        {"step": (step, "N", step - reach, step + reach)},
        power_N2=power,
        extra={"coarse": float(power > 0.5 * error_power)},
        words=f"the force takes {np.unique(force).size} distinct values, {step:.4g} N apart",
    )


def dropout(record: Record, step_N: float) -> Finding | None:
    """Find runs of one repeated force value while the shaft moves on.

    On a lattice repeats are natural: there a run must be longer than the lattice's own runs by far.
    """
    force = record.friction_N
    same = np.zeros(force.size, np.bool_)
    same[1:] = (force[1:] == force[:-1]) & ~record.restart[1:]
    if not same.any():
        return None
    start = np.flatnonzero(same & ~np.concatenate([[False], same[:-1]]))
    stop = np.flatnonzero(same & ~np.concatenate([same[1:], [False]])) + 1
    length = stop - start
    # One long run among values that never recur is enough; short ones must come more than once.
    fewest = 1 if int(length.max()) >= 5 else 2
    if step_N > 0.0:
        natural = same.mean()
        longest = np.log(1e-4 / force.size) / np.log(max(min(natural, 0.999), 1e-9))
        keep = length > max(longest, 3.0)
    else:
        top = np.abs(force).max()
        keep = (length >= 1) & ~((np.abs(force[start]) >= top) & (length < 3))
    if step_N == 0.0 and np.unique(force).size < 0.98 * (force.size - int(same.sum())):
        # Values recur elsewhere too: a fine lattice, on which single repeats are natural.
        keep &= length >= 3
        fewest = 8
    start, stop = start[keep], stop[keep]
    lost = int((stop - start).sum())
    # The longest run at the clipping level is no dropout: it is counted by `saturation`.
    if start.size < fewest or lost < max(6, 1e-4 * force.size) or np.unique(force[start]).size < 0.5 * start.size:
        return None
    held = np.zeros(force.size, np.bool_)
    for a, b in zip(start, stop, strict=True):
        held[a:b] = True
    share = float(held.mean())
    reach = 2.0 * np.sqrt(float(np.square(stop - start).sum())) / force.size
    return Finding(
        "dropout",
        1e-12,
        {
            "fraction": (share, "", max(0.0, share - reach), share + reach),
            "length": (lost / start.size, "samples", *_mean_interval(stop - start)),
        },
        used=record.used & ~held,
        words=f"{start.size} runs of exactly equal force values, {lost} samples in all",
    )


def _mean_interval(values: Floats) -> tuple[float, float]:
    mean = float(np.mean(values))
    reach = 2.0 * float(np.std(values)) / np.sqrt(len(values)) + 0.5
    return mean - reach, mean + reach


def saturation(record: Record, step_N: float) -> Finding | None:
    """Find values piled up at the largest force: far more ties there than at the levels below."""
    force = record.friction_N[record.used]
    for sign in (1.0, -1.0):
        side = sign * force
        level = float(side.max())
        if level <= 0.0:
            continue
        at = side >= level - 1e-12 * abs(level)
        runs = int((at & ~np.concatenate([[False], at[:-1]])).sum())
        width = step_N or 0.02 * level
        below = int(((side < level - 0.5 * width) & (side >= level - 1.5 * width)).sum())
        if step_N == 0.0:
            below = 0
        if at.sum() >= FEWEST_TIES and runs >= 4 and at.sum() > 4 * below:
            return Finding(
                "saturation",
                1e-12,
                {"level": (level, "N", level * (1 - 1e-6) - step_N, level * (1 + 1e-6) + step_N)},
                used=record.used & (np.abs(record.friction_N) < level - 1e-12 * level),
                words=f"{int(at.sum())} samples lie exactly at the largest force, {level:.4g} N",
            )
    return None


def local_scale(record: Record, residual: Floats) -> Floats:
    """Return the robust local standard deviation of a residual, (n,): by time since the reversal and by speed."""
    f = record.features
    since = np.where(np.isfinite(f.since_reversal_s), f.since_reversal_s, 1e9)
    scale = np.zeros(residual.size)
    for values in (since, np.abs(f.velocity_m_s)):
        edges = np.quantile(values, np.linspace(0.0, 1.0, 25)[1:-1])
        cell = np.searchsorted(edges, values)
        for number in range(cell.max() + 1):
            inside = cell == number
            good = residual[inside & record.used]
            if good.size > 20:
                scale[inside] = np.maximum(scale[inside], 1.4826 * np.median(np.abs(good - np.median(good))))
    return np.maximum(scale, 1e-300)


def outliers(record: Record, residual: Floats) -> Finding | None:
    """Find isolated spikes among the innovations of an autoregression of order two, against the local scale."""
    usual = 1.4826 * float(np.median(np.abs(residual[record.used]))) + 1e-300
    calm = np.clip(residual, -2.5 * usual, 2.5 * usual)
    past = np.column_stack([calm[1:-1], calm[:-2]])
    weights = np.linalg.lstsq(past, calm[2:], rcond=None)[0]
    # Clipped neighbours: a spike must not make the sample after it look like one.
    innovation = np.concatenate([residual[:2], residual[2:] - past @ weights])
    size = np.abs(innovation) / local_scale(record, innovation)
    hit = (size > SPIKE) & record.used
    neighbours = np.zeros(hit.size)
    for shift in (1, 2, 3):
        neighbours[shift:] += size[:-shift] > np.maximum(3.5, 0.5 * size[shift:])
        neighbours[:-shift] += size[shift:] > np.maximum(3.5, 0.5 * size[:-shift])
    hit &= neighbours == 0
    count = int(hit.sum())
    if count >= FEWEST_SPIKES and _gathered(record, hit):
        return None
    power = float(np.square(innovation[hit]).sum()) / max(int(record.used.sum()), 1)
    total = float(np.mean(np.square(residual[record.used])))
    p_value = float(binom.sf(count - 1, residual.size, 1.7e-6))
    if count < FEWEST_SPIKES or p_value > 1e-4 or power < LEAST_SHARE * total:
        return None
    height = float(np.sqrt(np.mean(np.square(innovation[hit]))))
    reach = height * (0.02 + 2.0 * usual / height / np.sqrt(count)) + 0.5 * float(np.std(np.abs(innovation[hit])))
    share = count / residual.size
    spread = 2.0 * np.sqrt(count) / residual.size
    return Finding(
        "outliers",
        p_value,
        {
            "amplitude": (height, "N", height - reach, height + reach),
            "fraction": (share, "", max(0.0, share - spread), share + spread),
        },
        used=record.used & ~hit,
        power_N2=power,
        words=f"{count} isolated spikes of about {height:.3g} N",
    )


def _gathered(record: Record, hit: Bools) -> bool:
    """Return whether hits gather at one place of the cycle: then they are a cause, not interference."""
    f = record.features
    since = np.where(np.isfinite(f.since_reversal_s), f.since_reversal_s, 1e9)
    for values in (since, f.velocity_m_s, f.position_m):
        edges = np.quantile(values, np.linspace(0.0, 1.0, 26)[1:-1])
        cell = np.searchsorted(edges, values[hit])
        if np.bincount(cell).max() > max(3.0, 0.3 * cell.size):
            return True
    return False


def velocity_noise(record: Record, force_slope: Floats, error_power: float) -> Finding | None:
    """Find noise on the velocity channel by its third difference, which a smooth drive does not have.

    For white noise of variance s^2 the third difference has variance 20 s^2 and correlation -3/4 from one to the next.
    """
    v = record.features.velocity_m_s
    third = v[3:] - 3.0 * v[2:-1] + 3.0 * v[1:-2] - v[:-3]
    whole = ~(record.restart[3:] | record.restart[2:-1] | record.restart[1:-2])
    third = third[whole]
    if third.size < 100:
        return None
    spread = 1.4826 * float(np.median(np.abs(third - np.median(third))))
    # A drive that changes its profile jumps now and then: such differences are shortened.
    third = np.clip(third, -4.0 * spread, 4.0 * spread)
    deviation = float(np.sqrt(_noise_power(third)))
    rough = float(np.mean(third[1:] * third[:-1])) < -0.2 * float(np.mean(np.square(third)))
    power = deviation * deviation * float(np.mean(np.square(force_slope[record.used])))
    if not rough or power < 2.0 * LEAST_SHARE * error_power:
        return None
    smooth = v.copy()
    edges = np.append(np.flatnonzero(record.restart), v.size)
    for a, b in pairwise(edges):
        if b - a > SMOOTHING:
            smooth[a:b] = savgol_filter(v[a:b], SMOOTHING, 3)
    reach = deviation * 0.1
    return Finding(
        "velocity_noise",
        1e-12,
        {"deviation": (deviation, "m/s", deviation - reach, deviation + reach)},
        velocity_m_s=smooth,
        power_N2=power,
        words=f"the velocity scatters by {deviation:.3g} m/s from sample to sample",
    )


def _noise_power(third: Floats) -> float:
    """Return the variance of the noise under third differences.

    White noise gives autocovariances 20, -15, 6, -1 times its variance; noise correlated at lag one with r adds
    r times those shifted to both sides. Both are fitted to lags 0 to 4 by least squares.
    """
    lags = np.array([float(np.mean(third[k:] * third[: third.size - k])) for k in range(5)])
    white = np.array([20.0, -15.0, 6.0, -1.0, 0.0])
    both = np.array([-30.0, 26.0, -16.0, 6.0, -1.0])
    fitted = np.linalg.lstsq(np.column_stack([white, both]), lags, rcond=None)[0]
    return float(max(fitted[0], 0.0))


def velocity_mismatch(record: Record, context: Context) -> Finding | None:
    """Compare the velocity with the recorded position: the slope of displacement over integrated velocity."""
    position = record.samples.position_m
    if "position" not in context.channels or position is None:
        return None
    f = record.features
    span = max(4, round(0.1 / context.step_s))
    travelled = np.cumsum(0.5 * (f.previous_m_s + f.velocity_m_s) * f.step_s)
    gap = np.cumsum(record.restart)
    a = np.arange(0, len(travelled) - span, span)
    whole = (gap[a] == gap[a + span]) & np.isfinite(position[a]) & np.isfinite(position[a + span])
    moved = (position[a + span] - position[a])[whole]
    integrated = (travelled[a + span] - travelled[a])[whole]
    if moved.size < 20 or float(np.abs(moved).max()) == 0.0:
        return None
    slope = float(moved @ integrated / (moved @ moved))
    rest = integrated - slope * moved
    deviation = float(np.sqrt(rest @ rest / (moved.size - 1) / (moved @ moved)))
    if abs(slope - 1.0) < max(MISMATCH, 5.0 * deviation):
        return None
    reach = 2.0 * deviation + 2e-4
    gain = slope - 1.0
    return Finding(
        "velocity_mismatch",
        1e-12,
        {"gain": (gain, "", gain - reach, gain + reach)},
        velocity_m_s=f.velocity_m_s / slope,
        words=f"the reported velocity is {slope:.4f} times the derivative of the reported position",
    )


def clock_jump(record: Record, context: Context) -> Finding | None:
    """Find a gap in the stamps over which the position moved on by one sample only."""
    position = record.samples.position_m
    if "position" not in context.channels or position is None:
        return None
    stamps = record.samples.stamp_ns
    step = np.diff(stamps) * 1e-9
    same = record.recording[1:] == record.recording[:-1]
    v = record.features.velocity_m_s
    usual = same & (step > 0.0) & (step < 2.0 * context.step_s)
    off = (np.diff(position) - 0.5 * (v[1:] + v[:-1]) * step)[usual]
    off = off[np.isfinite(off)]
    noise = 1.4826 * float(np.median(np.abs(off))) if off.size else 0.0
    jumps = []
    for k in np.flatnonzero(same & ((step > 4.0 * context.step_s) | (step < 0.0))):
        expected = 0.5 * (v[k] + v[k + 1])
        moved = position[k + 1] - position[k]
        slow = min(v[k] * v[k + 1], expected**2) < (FAST * context.top_speed_m_s) ** 2
        if slow or abs(expected * step[k]) < 0.05 * context.stroke_m or not np.isfinite(moved):
            continue
        # The stamps stood for one sample: the shaft moved on by that much, to the noise of the position channel.
        one = expected * context.step_s
        if abs(moved - one) < min(0.2 * abs(moved - expected * step[k]), abs(one) + 5.0 * noise):
            jumps.append((float(step[k] - context.step_s), float(record.features.time_s[k])))
    if not 0 < len(jumps) <= MOST_JUMPS:
        return None
    jump, at = max(jumps, key=lambda pair: abs(pair[0]))
    reach = context.step_s
    return Finding(
        "clock_jump",
        1e-12,
        {"jump": (jump, "s", jump - reach, jump + reach), "at": (at, "s", at - reach, at + 2 * reach)},
        words=f"the stamps jump by {jump:.4g} s while the position moves on by one sample",
    )
