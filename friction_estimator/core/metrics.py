"""Figures of merit, the same everywhere; none takes an array of the record's length beside those that it is given."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from friction_estimator.core import sums
from friction_estimator.core.sample import Bools, Floats

Prediction = Callable[[slice], Floats]
"""Returns the values of a part of a record."""

LEAST_CYCLES = 3
"""Fewer drive cycles than this are not reported as cycles."""

ONE_WAY = 0.98
"""Share of the samples in motion that go one way, from which the other direction counts as never met."""

ROUNDING = 1e-13
"""A standard deviation below this share of the largest value is what rounding leaves of a constant."""


def spread(values: Floats, where: Bools | None = None) -> float:
    """Return the standard deviation, exactly 0 for a constant and for fewer than two values.

    `where` : (n,), the values that count; all of them unless given.

    >>> spread(np.full(1000, 3.3)), float(np.std(np.full(1000, 3.3))) > 0.0
    (0.0, True)
    """

    def pieces() -> Iterator[Floats]:
        return (values[part] for part in sums.parts(values.size)) if where is None else sums.chosen(values, where)

    n = values.size if where is None else int(np.count_nonzero(where))
    if n < 2:
        return 0.0
    mean = sums.total(pieces(), n) / n
    deviation = float(np.sqrt(sums.total((np.square(piece - mean) for piece in pieces()), n) / n))
    largest = max(float(np.max(np.abs(piece))) for piece in pieces() if piece.size)
    return deviation if deviation > ROUNDING * largest else 0.0


def nrmse(
    measured: Floats, predicted: Floats | Prediction, where: Bools | None = None, scale: float | None = None
) -> float:
    """Return rms(measured - predicted) / std(measured); NaN below two samples or where the signal is constant.

    Parameters
    ----------
    measured : (n,).
    predicted : (n,), or what returns its values in a part.
    where : (n,), the samples that count; all of them unless given.
    scale : `spread` of measured there, where it is known: it takes half of the time.

    >>> nrmse(np.array([0.0, 2.0]), np.array([1.0, 1.0]))
    1.0
    """
    scale = spread(measured, where) if scale is None else scale
    if not scale > 0.0:
        return float("nan")
    values: Prediction = predicted if callable(predicted) else predicted.__getitem__

    def squares() -> Iterator[Floats]:
        for part in sums.parts(measured.size):
            error = np.square((measured[part] - values(part)) / scale)
            yield error if where is None else sums.some(error, where[part])

    n = measured.size if where is None else int(np.count_nonzero(where))
    return float(np.sqrt(sums.total(squares(), n) / n))


class NrmseInTurn:
    """`nrmse` of predictions that come piece by piece and are not kept, to the bit.

    Parameters
    ----------
    measured : (n,). begin : index of the first sample that counts.

    Examples
    --------
    >>> error = NrmseInTurn(np.array([7.0, 0.0, 2.0]), 1)
    >>> error.take(np.array([5.0, 1.0]))
    >>> error.take(np.array([1.0]))
    >>> error.value
    1.0
    """

    def __init__(self, measured: Floats, begin: int = 0) -> None:
        self._measured, self._begin = measured, begin
        self._scale = spread(measured[begin:])
        self._squares = sums.Total(measured.size - begin)
        self._done = 0

    def take(self, predicted: Floats) -> None:
        """Take the next predictions, (m,)."""
        first = max(0, self._begin - self._done)
        measured = self._measured[self._done : self._done + predicted.size]
        self._done += predicted.size
        if self._scale > 0.0:
            self._squares.add(np.square((measured[first:] - predicted[first:]) / self._scale))

    @property
    def value(self) -> float:
        """The nrmse, once all n are taken."""
        if not self._scale > 0.0:
            return float("nan")
        return float(np.sqrt(self._squares.value / (self._measured.size - self._begin)))


def nrmse_persistence(measured: Floats, restart: Bools) -> float:
    """Return the nrmse of the guess f[k-1]; samples after a restart have no predecessor and are left out."""
    follows = ~restart[1:]
    return nrmse(measured[1:], measured[:-1], follows)


def white_noise(force_N: Floats, restart: Bools) -> float:
    """Return the rms of what is white in a measured force, N: no prediction made before the measurement is better.

    Of third differences inside gap-free pieces, e = (f[k] - 3 f[k-1] + 3 f[k-2] - f[k-3]) / sqrt(20): a motion that is
    smooth over four samples vanishes in them (Gasser, Sroka, Jennen-Steinmetz 1986). Their median counts, so that
    reversals, where friction jumps, do not. NaN below 100 of them.
    """

    def thirds() -> Iterator[Floats]:
        for part in sums.parts(max(0, force_N.size - 3)):
            first, last = part.start, part.stop
            whole = ~(restart[first + 1 : last + 1] | restart[first + 2 : last + 2] | restart[first + 3 : last + 3])
            yield sums.some(np.abs(np.diff(force_N[first : last + 3], 3)), whole)

    if sum(piece.size for piece in thirds()) < 100:
        return float("nan")
    return float(sums.median_size(thirds) / (0.6745 * np.sqrt(20.0)))


def one_way(velocities: Iterable[Floats]) -> int:
    """Return the direction, 1 or -1, that a shaft in motion keeps; 0 where it goes both ways, and without a sample.

    `velocities` : those of the samples in motion, in pieces of any length.

    >>> one_way([np.array([0.1]), np.array([0.2])]), one_way([np.array([-0.1])]), one_way([np.array([-0.1, 0.2])])
    (1, -1, 0)
    """
    count = forward = backward = 0
    for piece in velocities:
        count += piece.size
        forward += int(np.count_nonzero(piece > 0.0))
        backward += int(np.count_nonzero(piece < 0.0))
    if not count or min(forward, backward) >= (1.0 - ONE_WAY) * count:
        return 0
    return 1 if forward > backward else -1


def drive_cycles(velocity_m_s: Floats) -> list[slice]:
    """Split a record into drive cycles at the upward zero crossings of velocity.

    A crossing counts once the velocity has left a band of a quarter of its rms on both sides, so that noise at
    standstill makes no cycles. The pieces before the first and after the last crossing are left out.

    Returns an empty list where fewer than `LEAST_CYCLES` cycles are found or their lengths spread by more than 50 %
    (a drive that is not periodic).

    >>> t = np.arange(5000) / 1000
    >>> [c.stop - c.start for c in drive_cycles(np.sin(2 * np.pi * t - 1.0))]
    [1000, 1000, 1000, 1000]
    """
    n = velocity_m_s.size
    band = 0.25 * float(np.sqrt(sums.mean_square(velocity_m_s.__getitem__, n))) if n else 0.0
    if not band > 0.0:
        return []
    starts = []
    for first, last in _rises(velocity_m_s, band):
        starts.append(int(first + 1 + np.argmax(velocity_m_s[first + 1 : last + 1] >= 0.0)))
    lengths = np.diff(starts)
    if lengths.size < LEAST_CYCLES or np.std(lengths) > 0.5 * np.mean(lengths):
        return []
    return [slice(a, b) for a, b in pairwise(starts)]


def _rises(velocity: Floats, band: float) -> Iterator[tuple[int, int]]:
    """Yield the last sample below the band and the first one above it, of each way up through it."""
    before, side_before = -1, 0.0
    for part in sums.parts(velocity.size):
        piece = velocity[part]
        known = np.flatnonzero(np.abs(piece) > band)
        if not known.size:
            continue
        side = np.sign(piece[known])
        place = known + part.start
        if side_before < 0.0 < side[0]:
            yield before, int(place[0])
        for k in np.flatnonzero((side[:-1] < 0.0) & (side[1:] > 0.0)).tolist():
            yield int(place[k]), int(place[k + 1])
        before, side_before = int(place[-1]), float(side[-1])


def cycles_or_tenths(velocity_m_s: Floats, starts: Sequence[int] = (0,)) -> list[slice]:
    """Return the drive cycles of each recording in turn; of one without, its tenths.

    Parameters
    ----------
    velocity_m_s : (n,). starts : where a recording begins; cycles are sought in each on its own, in this order.
    """
    out = []
    for first, end in pairwise([*starts, velocity_m_s.size]):
        parts = drive_cycles(velocity_m_s[first:end])
        if not parts:
            edges = np.linspace(0, end - first, 11).astype(int)
            parts = [slice(a, b) for a, b in pairwise(edges) if b > a]
        out += [slice(first + part.start, first + part.stop) for part in parts]
    return out


def by_cycle(measured: Floats, predicted: Floats, cycles: Sequence[slice], scale: float | None = None) -> list[float]:
    """Return the error rms of each drive cycle over the std of the whole record.

    Parameters
    ----------
    measured, predicted : (n,), N. cycles : of `cycles_or_tenths`. scale : see `nrmse`.
    """
    scale = spread(measured) if scale is None else scale
    if not scale > 0.0:
        return []
    return [float(np.sqrt(np.mean(np.square((measured[part] - predicted[part]) / scale)))) for part in cycles]


def settled(restart: Bools, memory: int) -> Bools:
    """Return where a model's delay lines hold measured samples only, (n,).

    A restart fills them with the row of its own sample: there, and at the samples that follow until `memory` rows have
    come, what the model predicts is right for a motion that did not change before.

    >>> settled(np.array([True, False, False, True, False, False]), 2).tolist()
    [False, False, True, False, False, True]
    """
    out = np.ones(restart.size, np.bool_)
    leave_out_restarts(out, restart, memory)
    return out


def leave_out_restarts(use: Bools, restart: Bools, memory: int) -> None:
    """Take from `use`, (n,), what is not `settled`; in place, since records are long."""
    begins = np.flatnonzero(restart)
    for lag in range(min(memory, use.size)):
        use[begins[begins + lag < use.size] + lag] = False
