"""Samples at another rate: low-passed without delay, then read on an even grid by a spline; never across a gap."""

import math
from itertools import pairwise

import numpy as np

from friction_estimator.core.errors import InputError
from friction_estimator.core.intake.tracking import GAP_PERIODS
from friction_estimator.core.sample import NS_PER_S, Floats, Samples

PASS, STOP, ATTENUATION_DB = 0.4, 0.6, 60.0
"""The filter: a linear-phase FIR by a Kaiser window; it passes the one share of the new rate and stops the other, by so
much. What lies between folds back above the pass band only. None where the new rate is not the lower one."""

FEWEST = 4
"""Samples of a stretch that a cubic needs."""

MOST_GROWTH = 100.0
"""Times the table's own rate that may be asked for: more says nothing new and fills the disk."""


def resampled(samples: Samples, rate_hz: float) -> Samples:
    """Return samples at `rate_hz`: stamps on one even grid, so that a gap stays a gap.

    Velocity, friction and position pass the same filter; pressure and temperature change slowly and are interpolated.
    Within a stretch without gap (at most `GAP_PERIODS` sample periods) missing rows are interpolated.

    Raises InputError where the rate cannot be made of these samples.
    """
    own = samples.sample_rate_hz
    if not math.isfinite(own) or not math.isfinite(rate_hz) or not 0.0 < rate_hz <= MOST_GROWTH * own:
        most = f"at most {MOST_GROWTH:g} times their own {own:.4g} Hz" if math.isfinite(own) else "they have no rate"
        raise InputError(f"--rate {rate_hz:g}: the samples can be given at {most}")
    step = np.diff(samples.stamp_ns) > GAP_PERIODS * NS_PER_S / own
    edges = np.concatenate([[0], np.flatnonzero(step | samples.restart[1:]) + 1, [len(samples)]]).tolist()
    time_s, taps = samples.time_s, _low_pass(rate_hz / own)
    grids: list[Floats] = []
    parts: dict[str, list[Floats]] = {}
    restart = []
    for begin, end in pairwise(edges):
        t = time_s[begin:end]
        first, last = math.ceil(t[0] * rate_hz - 1e-6), math.floor(t[-1] * rate_hz + 1e-6)
        if last < first:
            continue
        grids.append(np.arange(first, last + 1) / rate_hz)
        restart.append(np.arange(last - first + 1) == 0)
        for name, value in _channels(samples).items():
            known = np.isfinite(value[begin:end])
            smooth = not name.startswith(("pressure", "temperature"))
            made = _at(grids[-1], t[known], value[begin:end][known], own, taps if smooth else None)
            parts.setdefault(name, []).append(made)
    if not grids:
        raise InputError(f"--rate {rate_hz:g}: no stretch without gap is as long as one period")
    stamps = samples.stamp_ns[0] + np.rint(np.concatenate(grids) * NS_PER_S).astype(np.int64)
    return Samples(
        stamps, restart=np.concatenate(restart), **{name: np.concatenate(each) for name, each in parts.items()}
    )


def _at(grid: Floats, time_s: Floats, x: Floats, own_hz: float, taps: Floats | None) -> Floats:
    """Return a channel of one stretch on a grid: straight lines where `taps` is None, else filtered and by a spline."""
    if not x.size:
        return np.full(grid.size, np.nan)
    if taps is None or x.size < FEWEST:
        return np.asarray(np.interp(grid, time_s, x))
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow to import

    if taps.size > 1:  # on an even grid at their own rate
        even = time_s[0] + np.arange(round((time_s[-1] - time_s[0]) * own_hz) + 1) / own_hz
        if even.size > MOST_GROWTH * x.size:
            raise InputError(f"--rate: the table's rows come in bursts, {own_hz:.4g} Hz within them")
        time_s, x = even, _filtered(np.interp(even, time_s, x), taps)
    inside = np.clip(grid, time_s[0], time_s[-1])
    return np.asarray(make_interp_spline(time_s, x, k=3)(inside) if x.size >= FEWEST else np.interp(inside, time_s, x))


def _channels(samples: Samples) -> dict[str, Floats]:
    names = ("velocity_m_s", "friction_N", "pressure_Pa", "temperature_degC", "position_m")
    return {name: value for name in names if (value := getattr(samples, name)) is not None}


def _low_pass(rate: float) -> Floats:
    """Return the taps for a new rate that is this share of the old one; one tap where that is no lower one."""
    if rate >= 1.0:
        return np.ones(1)
    from scipy.signal import firwin, kaiserord  # noqa: PLC0415 - slow to import

    stop = min(STOP * rate, 0.5)
    count, beta = kaiserord(ATTENUATION_DB, 2.0 * (stop - PASS * rate))
    return np.asarray(firwin(count | 1, 0.5 * (PASS * rate + stop), window=("kaiser", beta), fs=1.0))


def _filtered(x: Floats, taps: Floats) -> Floats:
    """Return a stretch, filtered; it goes on beyond its ends turned by half a turn about them."""
    from scipy.signal import oaconvolve  # noqa: PLC0415 - slow to import

    half = taps.size // 2
    if not half or x.size < 2:
        return x
    ends = np.pad(x, half, mode="reflect", reflect_type="odd")
    return np.asarray(oaconvolve(ends, taps, "valid"))
