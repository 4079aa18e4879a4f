"""The order of configurations, with the noise of each figure, and which cannot be told from the best.

The figure of a configuration is its error where it did not learn, rms over the standard deviation of what was measured,
and over several recordings the geometric mean: a tenth less counts as much on a quiet rig as on a loud one.

Configurations are compared in pairs, on the same samples, so that what makes a stretch hard for all of them drops out.
With e_b the sum of squared errors of block b and n_b its samples, the logarithm of the rms error over blocks is

    L = 1/2 log(sum e_b / sum n_b),    influence of block b:  psi_b = B/2 (e_b / sum e - n_b / sum n)

(delta method), and the difference of two configurations has the influences psi_b - psi'_b, whose standard error is that
of a mean. Neighbouring blocks are no independent ones where friction drifts: blocks are joined in twos, fours, ... and
the largest of the standard errors counts (Flyvbjerg and Petersen, J. Chem. Phys. 91 (1989) 461). Where there are
recordings enough, the standard error is that over recordings, which holds for others like them.

The best of many looks better than it is. Each of the m - 1 comparisons with it is made at 1 - 0.05 / (m - 1)
(Bonferroni), so that the configuration that is truly best is told from the apparent one in at most 5 % of sweeps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded where they are first used: 0.1 s of a start

from friction_estimator.core.sample import Floats
from friction_estimator.sweep.grid import Settings
from friction_estimator.sweep.job import FEWEST_BLOCKS

BLOCKS, RECORDINGS = "blocks", "recordings"

FEWEST_RECORDINGS = 6
"""From so many recordings on the noise is that over recordings. Of fewer, Student's quantile for 63 comparisons is 9 or
more (14 at four recordings, 35 at three): nothing would ever be told apart."""

ERROR_RATE = 0.05

LEAST_NRMSE = 1e-12
"""A model that leaves less is a copy of the plant: its logarithm must stay a number."""

Row = Mapping[str, Any]
"""What `judged.row_of` returns."""


@dataclass(frozen=True)
class Comparison:
    """Error of a configuration over that of the best, with the interval that holds for all comparisons at once."""

    ratio: float
    low: float
    high: float

    @property
    def told(self) -> bool:
        """Whether it is told from the best: worse beyond noise."""
        return self.low > 1.0


@dataclass(frozen=True)
class Ranked:
    """One configuration in the order.

    Attributes
    ----------
    settings : that were varied. number : its place in the grid, from 0.
    nrmse : geometric mean over the recordings that could be judged. standard_error : of it, by noise; None where there
        is nothing to tell it from.
    recordings : how many could be judged. failed : how many could not, though another configuration could.
    comparison : with the best one, over the recordings that both could be judged on; None where there is no noise.
    """

    settings: Settings
    number: int
    nrmse: float
    standard_error: float | None
    recordings: int
    failed: int
    comparison: Comparison | None

    @property
    def told(self) -> bool:
        """Whether it is told from the best."""
        return self.comparison is not None and self.comparison.told


@dataclass(frozen=True)
class Ranking:
    """Configurations, best first, and what their noise is over: `BLOCKS` or `RECORDINGS`."""

    ranked: tuple[Ranked, ...]
    noise_over: str


@dataclass(frozen=True)
class _Estimate:
    """A mean with its standard error and the degrees of freedom of that."""

    value: float
    error: float
    freedom: float


def rank(settings: Sequence[Settings], rows: Sequence[Sequence[Row | None]]) -> Ranking:
    """Put configurations in order: those that failed on fewer recordings first, then by their figure.

    Parameters
    ----------
    settings : of each configuration. rows : for each configuration, one for each recording; None where it failed.

    At least one row is not None; configurations without any are left out.
    """
    answered = [r for r in range(len(rows[0])) if any(own[r] is not None for own in rows)]
    over = RECORDINGS if _units(rows, answered) >= FEWEST_RECORDINGS else BLOCKS
    figures = {}
    for number, own in enumerate(rows):
        units = [unit for r in answered if (row := own[r]) is not None for unit in _unit_rows(row, len(answered))]
        if units:
            figures[number] = _mean(units, None, over)
    missing = {c: sum(rows[c][r] is None for r in answered) for c in figures}
    order = sorted(figures, key=lambda c: (missing[c], figures[c].value, c))
    best = order[0]
    ranked = []
    for c in order:
        both = [(rows[c][r], rows[best][r]) for r in answered]
        pairs = [
            pair
            for one, other in both
            if one is not None and other is not None
            for pair in zip(_unit_rows(one, len(answered)), _unit_rows(other, len(answered)), strict=True)
        ]
        difference = _mean([one for one, _ in pairs], [other for _, other in pairs], over) if pairs else None
        nrmse = math.exp(figures[c].value)
        known = math.isfinite(figures[c].error)
        ranked.append(
            Ranked(
                settings=settings[c],
                number=c,
                nrmse=nrmse,
                standard_error=nrmse * figures[c].error if known else None,
                recordings=len(answered) - missing[c],
                failed=missing[c],
                comparison=_compared(difference, len(order) - 1),
            )
        )
    return Ranking(tuple(ranked), over)


def log_nrmse_of(row: Row) -> float:
    """Return the logarithm of a row's figure: the mean over what it was judged on."""
    return float(np.mean([_log_nrmse(one) for one in row["judged"]]))


def best_baseline(rows: Sequence[Row]) -> float | None:
    """Return the geometric mean of the nrmse of that textbook curve which does best over rows; None where none has."""
    judged = [one for row in rows for one in row["judged"]]
    common = set.intersection(*(set(one["baselines_N"]) for one in judged))
    means = [
        float(np.mean([math.log(max(one["baselines_N"][name] / one["spread_N"], LEAST_NRMSE)) for one in judged]))
        for name in sorted(common)
    ]
    return math.exp(min(means)) if means else None


def _units(rows: Sequence[Sequence[Row | None]], answered: Sequence[int]) -> int:
    """Return how many recordings the noise can be taken over: those learned from, or of one the ones judged on."""
    if len(answered) > 1:
        return len(answered)
    return max(len(row["judged"]) for own in rows if (row := own[answered[0]]) is not None)


def _unit_rows(row: Row, recordings: int) -> list[list[Mapping[str, Any]]]:
    """Return what is averaged over: a row as one, or where there is one row only each recording it was judged on."""
    judged = list(row["judged"])
    return [judged] if recordings > 1 else [[one] for one in judged]


def _mean(
    ones: Sequence[Sequence[Mapping[str, Any]]], others: Sequence[Sequence[Mapping[str, Any]]] | None, over: str
) -> _Estimate:
    """Return the mean logarithm of the error over units, or of its ratio to that of `others`, unit by unit."""
    values, variances, freedoms = [], [], []
    for k, unit in enumerate(ones):
        beside = None if others is None else others[k]
        parts = [_case(one, None if beside is None else beside[j]) for j, one in enumerate(unit)]
        values.append(float(np.mean([part.value for part in parts])))
        variances.append(sum(part.error**2 for part in parts) / len(parts) ** 2)
        freedoms.append(sum(part.freedom for part in parts))
    mean = float(np.mean(values))
    if over == RECORDINGS:
        error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
        return _Estimate(mean, error, len(values) - 1)
    return _Estimate(mean, math.sqrt(sum(variances)) / len(values), sum(freedoms))


def _case(one: Mapping[str, Any], other: Mapping[str, Any] | None) -> _Estimate:
    """Return the logarithm of the nrmse of one recording, or of its ratio to another's on the same recording."""
    value, psi = _log_nrmse(one), _influence(one)
    if other is None:
        error, freedom = _standard_error(psi)
        return _Estimate(value, error, freedom)
    value -= _log_nrmse(other)
    if one["begin_ns"] == other["begin_ns"]:
        error, freedom = _standard_error(psi - _influence(other))
        return _Estimate(value, error, freedom)
    # Other samples were admitted (another `sync.slop`): blocks do not pair.
    (error, freedom), (more, _) = _standard_error(psi), _standard_error(_influence(other))
    return _Estimate(value, math.hypot(error, more), freedom)


def _log_nrmse(one: Mapping[str, Any]) -> float:
    return math.log(max(one["error_N"] / one["spread_N"], LEAST_NRMSE))


def _influence(one: Mapping[str, Any]) -> Floats:
    squares, samples = np.array(one["block_error_N2"]), np.array(one["block_samples"], np.float64)
    total = float(squares.sum())
    if not total > 0.0:
        return np.zeros(squares.size)
    return np.asarray(0.5 * squares.size * (squares / total - samples / samples.sum()))


def _standard_error(psi: Floats) -> tuple[float, float]:
    """Return the standard error of the mean of influences, and its degrees of freedom: the largest of all lengths."""
    worst, freedom = -1.0, 1.0
    while True:
        error = float(np.std(psi, ddof=1)) / math.sqrt(psi.size)
        if error > worst:
            worst, freedom = error, psi.size - 1.0
        if psi.size < 2 * FEWEST_BLOCKS:
            return worst, freedom
        psi = psi[: psi.size // 2 * 2].reshape(-1, 2).mean(axis=1)


def _compared(difference: _Estimate | None, comparisons: int) -> Comparison | None:
    if difference is None or not math.isfinite(difference.error) or difference.freedom < 1:
        return None
    quantile = float(scipy.special.stdtrit(difference.freedom, 1.0 - 0.5 * ERROR_RATE / max(1, comparisons)))
    reach = quantile * difference.error
    ends = (math.exp(min(max(difference.value + sign * reach, -700.0), 700.0)) for sign in (-1.0, 1.0))
    return Comparison(math.exp(difference.value), *ends)
