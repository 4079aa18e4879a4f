"""Lines in spectra of a residual: in time, on gap-free pieces, so that a pause is no time; and over the position."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.sample import Floats, Ints
from friction_estimator.effects.features import stroke_ends

LINES = 4
"""Lines that are returned at most."""

LINE_LEVEL = 0.002
"""Probability that noise has a line anywhere in the spectrum."""

TRIALS = 8.0
"""Independent looks for each sample of a piece: two for the padding, and as much again for the scatter of the floor
(4 of 200 records of AR(1) noise had a line at `LINE_LEVEL` with two)."""

PIECE_GAP = 20.0
"""Sample periods without a sample that end a piece. Shorter gaps are filled with zeros, which move no line."""

SHORTEST_PIECE = 32
"""Samples: shorter pieces resolve nothing."""

NEIGHBOURS = 101
"""Independent frequencies about one whose median is the floor there: a coloured floor has no peaks then."""

WINDOWS = 4096
"""Medians that are taken at once."""

SLOWEST = 3.0
"""Cycles within a piece: fewer are a drift."""

FIRST_HARMONICS = 3
"""Lines at the first harmonics of the drive are the drive's, whatever their neighbours are."""

COMB = 0.1
"""A line at a higher harmonic is the drive's where a neighbouring harmonic has this share of its power: model errors
repeat with the drive and make a comb, a disturbance that happens to lie on a tooth stands alone."""

FINER = 4.0
"""Points per independent frequency in the last search on the whole record."""

WIDEST_SEARCH = 4000
"""Points of that search at most."""

AT_ONCE = 256
"""Of them formed at once."""

MOST_WAVES, FEWEST_WAVES = 400, 6
"""Waves on a stroke between which ripples over the position are sought."""

CELLS_A_WAVE = 4
"""Cells of the position on the shortest wave."""

BESIDE = 12
"""Wave numbers on either side whose median is the floor; the higher side counts, since what is left of the static
curve falls with the wave number."""

FEWEST_SAMPLES = 200
"""In one direction of one recording: fewer show no ripple."""


@dataclass(frozen=True)
class Spectrum:
    """Power of a residual's gap-free pieces, added up.

    Attributes
    ----------
    frequency_hz, height : (m,), height is the power over that of the surroundings.
    freedom : number of pieces of equal length that would scatter as much.
    samples : mean length of a piece, weighted by its length. spacing : bins between independent frequencies.
    """

    frequency_hz: Floats
    height: Floats
    freedom: float
    samples: float
    spacing: int

    def threshold(self, level: float) -> float:
        """Return the height that noise exceeds anywhere with this probability (Gamma distributed powers)."""
        return float(scipy.special.gammainccinv(self.freedom, level / (TRIALS * self.samples)) / self.freedom)

    def at(self, frequency_hz: float) -> float:
        """Return the largest height within half an independent frequency."""
        place = int(np.argmin(np.abs(self.frequency_hz - frequency_hz)))
        half = max(1, self.spacing // 2)
        return float(self.height[max(0, place - half) : place + half + 1].max())


def pieces(time_s: Floats, step_s: float) -> list[tuple[int, int]]:
    """Return first and last index (exclusive) of the pieces without a longer gap.

    >>> pieces(np.array([0.0, 0.1, 0.2, 9.0, 9.1]), 0.1)
    [(0, 3), (3, 5)]
    """
    step = np.diff(time_s)
    cut = np.flatnonzero((step > PIECE_GAP * step_s) | (step < 0.0)) + 1
    return list(pairwise([0, *cut.tolist(), time_s.size]))


def spectrum(residual: Floats, time_s: Floats, step_s: float) -> Spectrum | None:
    """Return the spectrum of the pieces, padded to twice the longest; None where all are too short."""
    parts = []
    for start, stop in pieces(time_s, step_s):
        place = np.round((time_s[start:stop] - time_s[start]) / step_s).astype(np.int64)
        if place.size >= SHORTEST_PIECE:
            even = np.zeros(int(place.max()) + 1)
            even[place] = residual[start:stop]
            parts.append(even)
    if not parts:
        return None
    lengths = np.array([part.size for part in parts], np.float64)
    size = 1 << int(np.ceil(np.log2(2.0 * lengths.max())))
    power = np.zeros(size // 2 + 1)
    for part in parts:
        power += np.square(np.abs(np.fft.rfft(part, size)))
    samples = float(np.square(lengths).sum() / lengths.sum())
    freedom = float(lengths.sum() / samples)
    group = max(1, int(size / (2.0 * samples)))
    coarse = power[: power.size // group * group].reshape(-1, group).mean(axis=1)
    half = min(NEIGHBOURS // 2, coarse.size - 1)
    padded = np.pad(coarse, half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    # The median copies its windows: some of them at a time.
    medians = [np.median(windows[k : k + WINDOWS], axis=1) for k in range(0, len(windows), WINDOWS)]
    middle = np.concatenate(medians)
    floor = np.maximum(np.repeat(middle / (scipy.special.gammaincinv(freedom, 0.5) / freedom), group), 1e-300)
    frequency: Floats = np.asarray(np.fft.rfftfreq(size, step_s)[: floor.size], np.float64)
    height = power[: floor.size] / floor
    height[frequency < SLOWEST / (samples * step_s)] = 0.0
    return Spectrum(frequency, height, freedom, samples, max(1, int(size / samples)))


def spectral_lines(
    residual: Floats,
    time_s: Floats,
    step_s: float,
    count: int = LINES,
    level: float = LINE_LEVEL,
    periods_s: Sequence[float] = (),
    recording: Ints | None = None,
) -> list[float]:
    """Return the frequencies of spectral lines, Hz, the clearest first.

    A line's power is one that noise, Gamma distributed about the median of its surroundings, would exceed anywhere
    with a probability below `level`. Harmonics of the drive's `periods_s` are none. The frequency is then refined on
    all pieces of a recording together, where its phase goes on over the gaps.
    """
    found = spectrum(residual, time_s, step_s)
    if found is None:
        return []
    height = found.height.copy()
    chosen: list[float] = []
    reach = 4 * found.spacing
    for _ in range(count + FIRST_HARMONICS * len(periods_s) + count):
        top = int(np.argmax(height))
        if len(chosen) == count or height[top] < found.threshold(level):
            break
        frequency = float(found.frequency_hz[top])
        height[max(0, top - reach) : top + reach + 1] = 0.0
        if not any(_belongs_to(found, frequency, period, step_s) for period in periods_s):
            chosen.append(_refined(residual, time_s, frequency, found.samples * step_s, recording))
    return chosen


def _belongs_to(found: Spectrum, frequency_hz: float, period_s: float, step_s: float) -> bool:
    """Return whether a line is a harmonic of the drive: on a tooth, and no tooth alone."""
    order = round(frequency_hz * period_s)
    if order < 1 or abs(frequency_hz - order / period_s) > 1.0 / (found.samples * step_s):
        return False
    if order <= FIRST_HARMONICS:
        return True
    beside = [found.at((order + k) / period_s) for k in (-2, -1, 1, 2)]
    return max(beside) > COMB * found.at(frequency_hz)


def _refined(residual: Floats, time_s: Floats, frequency_hz: float, piece_s: float, recording: Ints | None) -> float:
    """Return the frequency of largest power about a first value, coherent over the gaps of each recording.

    Demodulated to the first value the line turns slowly: means over an eighth of a piece hold all of it.
    """
    number = np.zeros(time_s.size, np.int64) if recording is None else recording
    slow = residual * np.exp(-2j * np.pi * frequency_hz * time_s)
    cell = np.floor((time_s - time_s[0]) / (piece_s / 8.0)).astype(np.int64)
    key = number * (int(cell.max()) + 1) + cell
    _, place = np.unique(key, return_inverse=True)
    total = np.bincount(place, weights=slow.real) + 1j * np.bincount(place, weights=slow.imag)
    when = np.bincount(place, weights=time_s) / np.bincount(place)
    owner = np.round(np.bincount(place, weights=number) / np.bincount(place)).astype(np.int64)
    longest = max(float(np.ptp(time_s[number == n])) for n in np.unique(number))
    points = int(min(WIDEST_SEARCH, max(9, 2.0 * FINER * longest / piece_s)))
    offsets = np.linspace(-1.0, 1.0, 2 * (points // 2) + 1) / piece_s
    power = np.zeros(offsets.size)
    for n in np.unique(owner):
        mine = owner == n
        for start in range(0, offsets.size, AT_ONCE):
            part = slice(start, start + AT_ONCE)
            power[part] += np.square(np.abs(np.exp(-2j * np.pi * np.outer(offsets[part], when[mine])) @ total[mine]))
    best = int(np.clip(np.argmax(power), 1, offsets.size - 2))
    # The top of the parabola through three points.
    left, middle, right = power[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(frequency_hz + offsets[best] + np.clip(shift, -1.0, 1.0) * (offsets[1] - offsets[0]))


def ripple_wavelengths(
    residual: Floats,
    position_m: Floats,
    direction: Floats,
    recording: Ints,
    count: int = LINES,
    level: float = LINE_LEVEL,
) -> list[float]:
    """Return the wavelengths of ripples over the position, m, the clearest first.

    The mean residual in cells of the position, tapered, gives a spectrum for each direction of each recording; their
    powers are added, so that each may have its own origin.
    """
    powers: list[Floats] = []
    low, high = stroke_ends(position_m, recording)
    stroke = high - low
    if stroke <= 0.0:
        return []
    cells = CELLS_A_WAVE * MOST_WAVES
    for mine in _ways(direction, recording):
        if mine.size < FEWEST_SAMPLES:
            continue
        x = position_m[mine] - position_m[mine].min()
        cell = np.minimum((x / stroke * cells).astype(np.int64), cells - 1)
        held = np.bincount(cell, minlength=cells)
        mean = np.bincount(cell, weights=residual[mine], minlength=cells) / np.maximum(held, 1)
        shown = held > 0
        mean[shown] -= mean[shown].mean()
        power = np.square(np.abs(np.fft.rfft(mean * np.hanning(cells), 4 * cells)))
        powers.append(power / max(float(power.sum()), 1e-300))
    if not powers:
        return []
    power = np.sum(powers, axis=0)[: 4 * MOST_WAVES]
    waves = np.arange(power.size) / 4.0
    sides = np.lib.stride_tricks.sliding_window_view(np.pad(power, 4 * BESIDE, mode="edge"), 4 * BESIDE)
    median = np.median(sides, axis=1)
    freedom = float(len(powers))
    floor = np.maximum(median[: power.size], median[-power.size :]) / (
        scipy.special.gammaincinv(freedom, 0.5) / freedom
    )
    height = power / np.maximum(floor, 1e-300)
    height[waves < FEWEST_WAVES] = 0.0
    threshold = float(scipy.special.gammainccinv(freedom, level / (TRIALS * MOST_WAVES)) / freedom)
    chosen: list[float] = []
    for _ in range(count):
        top = int(np.argmax(height))
        if height[top] < threshold:
            break
        chosen.append(stroke / float(waves[top]))
        height[max(0, top - 12) : top + 13] = 0.0
    return chosen


def ripple_power(
    residual: Floats, position_m: Floats, direction: Floats, recording: Ints, wavelength_m: float
) -> float:
    """Return the power that a wave over the position takes off a residual, summed.

    Fitted with a constant in each direction of each recording, as `ripple_wavelengths` looks.
    """
    angle = 2.0 * np.pi * position_m / wavelength_m
    power = 0.0
    for mine in _ways(direction, recording):
        wave = np.column_stack([np.cos(angle[mine]), np.sin(angle[mine]), np.ones(mine.size)])
        weights = np.linalg.lstsq(wave, residual[mine], rcond=None)[0]
        power += float(np.square(wave[:, :2] @ weights[:2]).sum())
    return power


def _ways(direction: Floats, recording: Ints) -> Iterator[Ints]:
    """Yield the samples of each direction of each recording."""
    for n in np.unique(recording):
        for way in (-1.0, 1.0):
            yield np.flatnonzero((recording == n) & (direction == way))
