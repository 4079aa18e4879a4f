"""Basis of the static nonlinearity g(v): Daubechies wavelets, evaluated sparsely from a dyadic table.

g(v) = sum_mn w_mn psi_mn(v), psi_mn(v) = 2^(-m/2) psi(2^-m v - n) (Kwak, Yagle, Levitt 1998, section 2), with the
scaling functions phi_Mn of the coarsest level M added so that constants and slopes are in the span.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
import pywt
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import BasisConfig

UNITS_PER_RANGE = 16.0
"""Basis units in the velocity range where basis.velocity_unit is not set."""

TABLE_LEVEL = 10
"""The table has 2^TABLE_LEVEL rows a unit; between rows it is interpolated linearly."""

LARGEST_BASIS = 4096
"""More functions than this is a wrong velocity unit, not a model."""

CELLS_PER_UNIT = 4
"""Cells of velocity a basis unit, in which running errors are kept (see `fit.band`): 64 over a new range."""

WIDEST = 128.0
"""Basis units by which `widened` goes beyond an edge at the most."""

LEAST_SCALE = 2.0**-32
"""Least prior deviation of a weight against those of the coarsest level: the default slope over 21 levels."""


class Basis(Protocol):
    """A basis of functions of velocity with a bounded number of non-zeros at every point."""

    unit: float
    """Velocity of one basis unit, m/s, at standstill where velocity is companded."""

    reach: tuple[float, float]
    """Velocities that are covered, m/s."""

    def __init__(
        self, config: BasisConfig, reach: tuple[float, float] | None = None, scale: float | None = None
    ) -> None: ...

    @property
    def size(self) -> int:
        """Number of functions."""

    @property
    def width(self) -> int:
        """Number of stored entries a point."""

    @property
    def row_power(self) -> float:
        """Bound of the sum of squares of a row."""

    def rows(self, velocity_m_s: Floats) -> tuple[NDArray[np.int32], Floats]:
        """Return (index, value), each (n, width): the functions that may differ from zero, and their values."""

    def inside(self, velocity_m_s: Floats) -> NDArray[np.bool_]:
        """Return where the velocities lie in the covered range, (n,)."""

    def prior_scale(self, slope: float) -> Floats:
        """Return the relative prior standard deviation of each weight, (size,)."""

    def places_of(self, other: "Basis") -> NDArray[np.int64]:
        """Return where each function of `other`, which covers less with the same unit, stands here, (other.size,)."""

    def cells(self, velocity_m_s: Floats) -> NDArray[np.int64]:
        """Return the cell of each velocity, held inside the range, (n,)."""

    def located(self, velocity_m_s: Floats) -> tuple[NDArray[np.int32], Floats, NDArray[np.int64]]:
        """Return (index, value, cell): `rows` and `cells` in one pass."""

    def widened(self) -> "Basis":
        """Return a basis of the same functions and those beside them, over all that these reach."""

    def cell_velocities(self, points: int = 1) -> Floats:
        """Return velocities evenly in basis units, `points` a cell, (points * cell_count,), m/s."""

    @property
    def cell_count(self) -> int:
        """Number of cells over the range."""

    @property
    def first_cell(self) -> int:
        """Number of the lowest cell, counted from standstill: it tells cells apart when the range grows."""


BASES: Registry[type[Basis]] = Registry("basis")


@dataclass(frozen=True)
class DyadicTable:
    """Scaling function and wavelet of one Daubechies order at dyadic points.

    Attributes
    ----------
    values : (2, 2^level + 1, 2 N - 1) float64; values[0] is phi and values[1] psi, and entry [r, k] stands for the
        argument k + r 2^-level.
    """

    values: Floats

    @property
    def support(self) -> int:
        """Length 2 N - 1 of the support."""
        return int(self.values.shape[2])


@cache
def dyadic_table(wavelet: str, level: int = TABLE_LEVEL) -> DyadicTable:
    """Tabulate phi and psi of `wavelet` exactly on the dyadic grid of spacing 2^-level.

    phi at the integers is the eigenvector for eigenvalue 1 of the refinement matrix sqrt(2) h[2 i - j], scaled to
    sum to one; the dilation equation phi(x) = sqrt(2) sum_k h_k phi(2 x - k) then halves the spacing step by step, and
    psi(x) = sqrt(2) sum_k g_k phi(2 x - k) (Daubechies 1992, chapters 5 and 6). The filters are PyWavelets'.
    """
    filters = pywt.Wavelet(wavelet)
    low, high = np.sqrt(2.0) * np.array(filters.rec_lo), np.sqrt(2.0) * np.array(filters.rec_hi)
    support = low.size - 1
    refinement = np.zeros((support, support))
    for i in range(support):
        for j in range(support):
            if 0 <= 2 * i - j < low.size:
                refinement[i, j] = low[2 * i - j]
    # phi(0 .. support-1); phi(support) = 0.
    eigenvalues, vectors = np.linalg.eig(refinement)
    start = np.real(vectors[:, np.argmin(abs(eigenvalues - 1.0))])
    scaling = np.append(start / start.sum(), 0.0)
    spacing = 1
    wavelet_values = scaling
    for _ in range(level):
        refined = _dilate(scaling, low, spacing, support)
        wavelet_values = _dilate(scaling, high, spacing, support)
        scaling, spacing = refined, 2 * spacing
    rows = np.arange(spacing + 1)[:, None] + spacing * np.arange(support)[None, :]
    values = np.stack([scaling[rows], wavelet_values[rows]])
    return DyadicTable(np.ascontiguousarray(values))


def _dilate(scaling: Floats, taps: Floats, spacing: int, support: int) -> Floats:
    """Return sum_k taps_k phi(2 x - k) on the grid of half the spacing, from phi on the present grid."""
    points = 2 * spacing * support + 1
    position = np.arange(points)  # x = position / (2 spacing); 2 x - k = (position - k spacing) / spacing
    total = np.zeros(points)
    for k, tap in enumerate(taps):
        index = position - k * spacing
        fits = (index >= 0) & (index < scaling.size)
        total[fits] += tap * scaling[index[fits]]
    return total


@njit(cache=True)
def _position(velocity, unit, bend):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the velocity in basis units; `bend` is the velocity at which companding sets in, 0 for none."""
    if bend > 0.0:
        return bend * np.arcsinh(velocity / bend) / unit
    return velocity / unit


@njit(cache=True, nogil=True)
def wavelet_rows(  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    velocity, unit, low, high, bend, scale, amplitude, first, kind, table, first_cell, index, value, cell
):
    """Fill (index, value) for each velocity, one block of `support` entries a level, and its cell."""
    steps = table.shape[1] - 1
    support = table.shape[2]
    for r in range(velocity.size):
        held = _position(min(max(velocity[r], low), high), unit, bend)
        cell[r] = int(np.floor(held * CELLS_PER_UNIT)) - first_cell
        for block in range(scale.size):
            scaled = held * scale[block]
            whole = np.floor(scaled)
            fine = (scaled - whole) * steps
            row = min(int(fine), steps - 1)  # just below an integer the fraction rounds to 1
            # Haar is a step function: its table is read without interpolation.
            part = fine - row if support > 1 else 0.0
            place = first[block] + int(whole)
            for k in range(support):
                index[r, block * support + k] = place - k
                value[r, block * support + k] = amplitude[block] * (
                    table[kind[block], row, k] * (1.0 - part) + table[kind[block], row + 1, k] * part
                )


class WaveletBasis:
    """Daubechies wavelets of levels m = finest..coarsest and the scaling functions of the coarsest level.

    A velocity v is u = v / velocity_unit basis units, or u = (b / velocity_unit) asinh(v / b), b = v_max / companding,
    where companding is set: friction bends most near standstill, and this puts the resolution there. At any u at most
    2 N - 1 functions of a level differ from zero. Velocities outside the range are held at its edge.

    Parameters
    ----------
    config : wavelet, levels, companding and velocity_unit (m/s; 0: from `scale`).
    reach : velocities to cover, (lowest, highest) m/s; `velocity_range` unless given.
    scale : speed that unit and companding derive from, m/s; the largest of `reach` unless given. The range may grow
        while the scale stays: then the functions stay what they are, and others come to stand beside them.

    Raises
    ------
    ConfigError : empty range, or more than `LARGEST_BASIS` functions.

    Examples
    --------
    >>> basis = WaveletBasis(BasisConfig(), (-0.1, 0.1))
    >>> basis.size, basis.width
    (94, 30)
    >>> index, value = basis.rows(np.array([0.05]))
    >>> index.shape, value.shape
    ((1, 30), (1, 30))
    """

    def __init__(
        self, config: BasisConfig, reach: tuple[float, float] | None = None, scale: float | None = None
    ) -> None:
        self._config, self._scale_m_s = config, scale
        covered = reach or config.velocity_range
        if not covered:
            raise ConfigError("basis.velocity_range is empty: give [lowest, highest]")
        self.reach = self.low, self.high = float(covered[0]), float(covered[1])
        if not self.low < self.high:
            raise ConfigError(f"velocities [{self.low:g}, {self.high:g}] are no range to cover")
        given = config.velocity_range
        low, high = (given[0], given[1]) if given else (-(scale or 0.0), scale or 0.0)
        low, high = (low, high) if low < high else self.reach
        self.bend = max(abs(low), abs(high)) / config.companding if config.companding > 0.0 else 0.0
        span = _position(high, 1.0, self.bend) - _position(low, 1.0, self.bend)
        self.unit = config.velocity_unit or span / UNITS_PER_RANGE
        self.levels = tuple(range(config.finest_level, config.coarsest_level + 1))
        self._table = dyadic_table(config.wavelet).values
        support = self._table.shape[2]
        exponents = np.array([*self.levels, self.levels[-1]])
        self._scale = 2.0 ** -exponents.astype(np.float64)
        self._amplitude = np.sqrt(self._scale)
        self._kind = np.array([1] * len(self.levels) + [0], np.int64)
        # The kernel's own function, so that the ends fall into the same cell.
        lowest = np.floor(_position(self.low, self.unit, self.bend) * self._scale) - (support - 1)
        highest = np.floor(_position(self.high, self.unit, self.bend) * self._scale)
        counts = highest - lowest + 1
        if not counts.sum() <= LARGEST_BASIS:  # before they are integers, which hold no more than 64 bits
            raise ConfigError(
                f"the velocities {list(self.reach)} hold {counts.sum():g} functions of "
                f"units of {self.unit:g}, more than {LARGEST_BASIS}: set a larger basis.velocity_unit or finest_level"
            )
        lowest, highest, counts = (bound.astype(np.int64) for bound in (lowest, highest, counts))
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        self._first = starts - lowest
        self._size = int(counts.sum())
        self._block = np.repeat(np.arange(counts.size), counts)
        self.level_of = exponents[self._block]
        self.is_scaling = self._kind[self._block] == 0
        self.translation = np.concatenate([np.arange(a, b + 1) for a, b in zip(lowest, highest, strict=True)])
        self.first_cell, last = (int(np.floor(_position(v, self.unit, self.bend) * CELLS_PER_UNIT)) for v in self.reach)
        self.cell_count = last - self.first_cell + 1

    @property
    def size(self) -> int:
        """Number of functions."""
        return self._size

    @property
    def width(self) -> int:
        """Number of stored entries a point: 2 N - 1 for each level and for the scaling functions."""
        return int(self._scale.size * self._table.shape[2])

    @property
    def row_power(self) -> float:
        """Bound of the sum of squares of a row: values are linear between the rows of the table."""
        powers = np.sum(np.square(self._table), axis=2).max(axis=1)
        return float(np.sum(self._scale * powers[self._kind]))

    def rows(self, velocity_m_s: Floats) -> tuple[NDArray[np.int32], Floats]:
        """Return (index, value), each (n, width); velocities must be finite."""
        index, value, _ = self.located(velocity_m_s)
        return index, value

    def located(self, velocity_m_s: Floats) -> tuple[NDArray[np.int32], Floats, NDArray[np.int64]]:
        """Return (index, value, cell): `rows` and `cells` in one pass."""
        index = np.empty((velocity_m_s.size, self.width), np.int32)
        value, cell = np.empty((velocity_m_s.size, self.width)), np.empty(velocity_m_s.size, np.int64)
        wavelet_rows(*self.row_arguments(velocity_m_s, index, value, cell))
        return index, value, cell

    def row_arguments(
        self, velocity_m_s: Floats, index: NDArray[np.int32], value: Floats, cell: NDArray[np.int64]
    ) -> tuple[Any, ...]:
        """Return what `wavelet_rows` takes to fill `index`, `value` and `cell` from `velocity_m_s`."""
        return (
            velocity_m_s,
            self.unit,
            self.low,
            self.high,
            self.bend,
            self._scale,
            self._amplitude,
            self._first,
            self._kind,
            self._table,
            self.first_cell,
            index,
            value,
            cell,
        )

    def cells(self, velocity_m_s: Floats) -> NDArray[np.int64]:
        """Return the cell of each velocity, held inside the range, (n,)."""
        return self.located(velocity_m_s)[2]

    def widened(self) -> "WaveletBasis":
        """Return a basis of the same functions and those beside them, over all that the coarsest of these reach.

        At most `WIDEST` units more on either side, and the basis itself where even that would be too large.
        """
        span = min(self._table.shape[2] * 2.0 ** self.levels[-1], WIDEST)
        ends = [
            _position(v, self.unit, self.bend) + sign * span for v, sign in zip(self.reach, (-1.0, 1.0), strict=True)
        ]
        low, high = (float(end) for end in self._velocity_at(np.array(ends)))
        try:
            return WaveletBasis(self._config, (low, high), self._scale_m_s)
        except ConfigError:
            return self

    def _velocity_at(self, position: Floats) -> Floats:
        """Return the velocities at numbers of basis units, (n,); infinite where no float is as large."""
        along = position * self.unit
        with np.errstate(over="ignore"):
            return np.asarray(self.bend * np.sinh(along / self.bend) if self.bend > 0.0 else along)

    def cell_velocities(self, points: int = 1) -> Floats:
        """Return velocities evenly in basis units, `points` a cell, (points * cell_count,), m/s.

        One point a cell is its middle; at the ends they are held inside the range.
        """
        along = (np.arange(points * self.cell_count) + 0.5) / points
        return np.clip(self._velocity_at((self.first_cell + along) / CELLS_PER_UNIT), self.low, self.high)

    def places_of(self, other: Basis) -> NDArray[np.int64]:
        """Return where each function of `other`, which covers less with the same unit, stands here, (other.size,)."""
        assert isinstance(other, WaveletBasis)
        return np.asarray(self._first[other._block] + other.translation)

    def dense(self, velocity_m_s: Floats) -> Floats:
        """Return Psi as a matrix (n, size)."""
        index, value = self.rows(velocity_m_s)
        psi = np.zeros((velocity_m_s.size, self.size))
        np.put_along_axis(psi, index.astype(np.int64), value, axis=1)
        return psi

    def inside(self, velocity_m_s: Floats) -> NDArray[np.bool_]:
        """Return where the velocities lie in the covered range, (n,)."""
        return (velocity_m_s >= self.low) & (velocity_m_s <= self.high)

    def prior_scale(self, slope: float) -> Floats:
        """Return the relative prior standard deviation of each weight, (size,): 2^(slope (m - M)), a smooth g.

        None is less than `LEAST_SCALE`: such a weight stays at 0 anyhow, and squares of less than rounding are no
        covariance.
        """
        return np.asarray(np.maximum(2.0 ** (slope * (self.level_of - self.levels[-1])), LEAST_SCALE))


for _order in range(1, 9):
    BASES.register(f"db{_order}", WaveletBasis)


def basis_from_config(config: Config) -> Basis:
    """Return the basis that `basis.wavelet` names, over the velocities that are given or were learned.

    Raises ConfigError where neither is there.
    """
    if config.reach is None:
        raise ConfigError("basis.velocity_range is empty and no first contact was made: give [lowest, highest]")
    return BASES[config.basis.wavelet](config.basis, config.reach, config.velocity_scale)
