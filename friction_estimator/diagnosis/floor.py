"""The noise floor, measured: what does not repeat from cycle to cycle, and how it is distributed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.record import Record

FEWEST_IN_STEP, IN_STEP = 500, 0.8
"""Pairs, and the share of them that the next sample's follows, from which they tell the memory of the noise."""

LONGEST_MEMORY, MOST_MEMORY = 40, 20.0
"""Samples over which noise may be correlated, and by how much that may raise the power of slow averages."""

FEWEST_PAIRS = 50
"""Pairs of samples that should be equal, from which their differences are a measure of the noise."""

DITHERED = 1.6
"""Times the deviation of rounding, step / sqrt(12): where what does not repeat is more, as with steps of up to 2.8
deviations of the noise, the errors of rounding are independent of the force."""


def incoherent(record: Record, residual_N: Floats) -> tuple[Floats, Ints]:
    """Return differences of paired residuals over sqrt 2, (m,), N, and the samples that they belong to."""
    first, second = record.pairs
    keep = record.used[first] & record.used[second]
    first, second = first[keep], second[keep]
    return (residual_N[first] - residual_N[second]) / np.sqrt(2.0), first


def noise_floor(record: Record, residual_N: Floats, lattice_N: float = 0.0) -> float:
    """Return the rms of the noise, N: of what does not repeat, but no less than rounding to a lattice makes.

    Where there is less noise than a step, rounding repeats with the drive.
    """
    difference, _ = incoherent(record, residual_N)
    if difference.size < FEWEST_PAIRS:
        return float(np.sqrt(np.mean(np.square(residual_N[record.used]))))
    return max(float(np.sqrt(np.mean(np.square(difference)))), lattice_N / float(np.sqrt(12.0)))


def coarse_step(record: Record, residual_N: Floats, lattice_N: float) -> float:
    """Return the step of the force's lattice where rounding to it repeats with the drive, N; 0 where it is noise.

    What does not repeat is noise and rounding together: with steps of sigma it has 13 times the power of rounding.
    """
    if lattice_N == 0.0:
        return 0.0  # without a look at what repeats
    difference, _ = incoherent(record, residual_N)
    known = difference.size >= FEWEST_PAIRS
    noisy = known and np.mean(np.square(difference)) > DITHERED**2 * lattice_N**2 / 12.0
    return 0.0 if noisy else lattice_N


def noise_memory(record: Record, residual_N: Floats, paired: tuple[Ints, Ints]) -> float:
    """Return by how much coloured noise raises the power of slow averages: 1 + 2 sum_l r_l of its autocorrelation.

    Asked of the differences d of paired samples, since a slow error that is left would hide itself. Both samples of a
    pair have noise: corr_l(d) = r_l (1 + c_l) / 2, with c_l the share of pairs l samples apart whose partners are, too.
    """
    first, second = paired
    keep = record.used[first] & record.used[second]
    first, second = first[keep], second[keep]
    if first.size <= FEWEST_IN_STEP or np.mean(np.diff(first) == 1) < IN_STEP:
        first = second = np.flatnonzero(record.used)
        noise = residual_N[first]
    else:
        noise = residual_N[first] - residual_N[second]
    centred = noise - noise.mean()
    power = float(np.square(centred).mean()) or 1.0
    total = 0.0
    for lag in range(1, LONGEST_MEMORY + 1):
        together = float(np.mean(second[lag:] - second[:-lag] == lag))
        total += max(0.0, float(np.mean(centred[lag:] * centred[:-lag])) / power * 2.0 / (1.0 + together))
    return float(np.clip(1.0 + 2.0 * total, 1.0, MOST_MEMORY))


VARIABLES = (
    "velocity_m_s",
    "acceleration_m_s2",
    "position_m",
    "since_reversal_m",
    "since_reversal_s",
    "time_s",
    "distance_m",
    "pressure_Pa",
    "force_N",
)
BINS = 20

FEWEST_IN_BIN, FEWEST_IN_BLOCK = 30, 5
"""More samples than these make a bin of the record, and its mean within a block."""


@dataclass(frozen=True)
class Bins:
    """Indicators of the bins of a variable, (n, bins), made piece by piece.

    Attributes
    ----------
    cell : (n,), number of the bin, -1 where it has too few samples. count : number of bins.
    """

    cell: NDArray[np.int16]
    count: int

    @property
    def shape(self) -> tuple[int, int]:
        """(n, bins)."""
        return self.cell.size, self.count

    def __getitem__(self, part: slice, /) -> Floats:
        return np.asarray(self.cell[part][:, None] == np.arange(self.count), np.float64)


def binned(record: Record, values: Floats, signed: bool) -> Bins:
    """Return indicators of quantile bins; `signed` gives each direction of motion its own."""
    finite = np.isfinite(values)
    known = values[finite]
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
    cell = np.searchsorted(edges, np.where(finite, values, known.max()), side="right")
    if signed:
        cell = cell + (int(cell.max()) + 1) * (record.features.velocity_m_s > 0.0)
    shown = np.bincount(cell) > FEWEST_IN_BIN
    number = np.where(shown, np.cumsum(shown) - 1, -1).astype(np.int16)
    return Bins(number[cell], int(shown.sum()))


def remainder_columns(record: Record, force_N: Floats) -> dict[str, Bins]:
    """Return for each revealing variable the columns of an arbitrary dependence on it, in each direction of motion."""
    f = record.features
    out = {}
    for name in VARIABLES:
        values = force_N if name == "force_N" else getattr(f, name)
        if np.ptp(values[np.isfinite(values)]) <= 1e-9 * float(np.abs(values[np.isfinite(values)]).max() or 1.0):
            continue
        signed = name not in ("velocity_m_s", "force_N")
        out[name] = binned(record, values, signed)
    return out


@dataclass(frozen=True)
class Scatter:
    """A bin of a variable in which errors scatter more than elsewhere.

    Attributes
    ----------
    variable : field of `Features`. share : of the errors' power that is there and would not be elsewhere.
    inside : (m,) bool, the errors in the bin.
    """

    variable: str
    share: float
    inside: Bools


def variance_dependence(record: Record, errors_N: Floats, at: Ints, names: Sequence[str] = VARIABLES) -> Scatter | None:
    """Return where the size of errors (m,) at the samples `at` (m,) depends most on a variable, or None.

    Their power, averaged in bins, is compared with its scatter over blocks; a family-wise 1 % holds over all bins of
    all variables.
    """
    f = record.features
    power = np.square(errors_N)
    power = np.minimum(power, 40.0 * float(np.median(power)) / 0.4549)
    total, block = float(power.mean()), record.block[at]
    if not total > 0.0:  # most errors are exactly nothing: of a lattice's values
        return None
    best: Scatter | None = None
    best_t = 6.5
    for name in names:
        values = getattr(f, name) if name != "force_N" else None
        if values is None or np.ptp(values[np.isfinite(values)]) == 0.0:
            continue
        bins = binned(record, np.abs(values), False)
        cell = bins.cell[at]
        inside = cell >= 0
        place = block[inside] * bins.count + cell[inside]
        size = record.blocks * bins.count
        number = np.bincount(place, minlength=size).reshape(-1, bins.count)
        sums = np.bincount(place, weights=power[inside], minlength=size).reshape(-1, bins.count)
        for k in range(bins.count):
            some = number[:, k] > FEWEST_IN_BLOCK
            per = sums[some, k] / number[some, k]
            if per.size < 6:
                continue
            t_value = (per.mean() - total) / max(per.std(ddof=1) / np.sqrt(per.size), 1e-300)
            share = float((per.mean() - total) * number[:, k].sum() / at.size / total)
            if t_value > best_t and share > 0.01:
                best_t, best = t_value, Scatter(name, share, cell == k)
    return best
