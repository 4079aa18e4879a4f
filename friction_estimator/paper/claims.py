"""What a claim is, and how numbers become a verdict."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Claim:
    """One claim of the paper with its test.

    Attributes
    ----------
    id : short name.
    statement : what the paper says.
    experiment : what was done, with seeds and conditions, and the criterion.
    numbers : what came out; intervals are 95 %.
    verdict : confirmed, refuted or depends, computed from the numbers.
    why : one sentence.
    """

    id: str
    statement: str
    experiment: str
    numbers: dict[str, Any]
    verdict: str
    why: str


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


def geometric_mean(values: Sequence[float]) -> Interval:
    """Return the geometric mean of positive values with Student's interval on their logarithms.

    Raises ValueError below two values.

    >>> str(geometric_mean([1.0, 1.0, 1.0]))
    '1 [1, 1]'
    """
    if len(values) < 2:
        raise ValueError("an interval needs at least two values")
    logs = np.log(np.asarray(values, np.float64))
    reach = stats.t.ppf(0.5 + CONFIDENCE / 2, logs.size - 1) * logs.std(ddof=1) / np.sqrt(logs.size)
    return Interval(*(float(np.exp(logs.mean() + shift)) for shift in (0.0, -reach, reach)))


def share(hits: int, trials: int) -> Interval:
    """Return hits / trials with the Clopper-Pearson interval.

    >>> str(share(10, 10))
    '1 [0.692, 1]'
    """
    interval = stats.binomtest(hits, trials).proportion_ci(CONFIDENCE, method="exact")
    return Interval(hits / trials, float(interval.low), float(interval.high))


def verdict(holds: Iterable[bool | None]) -> str:
    """Return confirmed where every case holds, refuted where every case fails, else depends; None is undecided.

    >>> verdict([True, True]), verdict([False, False]), verdict([True, None]), verdict([True, False])
    ('confirmed', 'refuted', 'depends', 'depends')
    """
    cases = list(holds)
    if cases and all(case is True for case in cases):
        return "confirmed"
    if cases and all(case is False for case in cases):
        return "refuted"
    return "depends"


def below(interval: Interval, level: float) -> bool | None:
    """Return whether the interval lies below (True) or above (False) a level; None where it covers it."""
    if interval.high < level:
        return True
    return False if interval.low > level else None


def listed(cases: dict[str, bool | None], wanted: bool | None) -> str:
    """Return the names of the cases with this outcome, for a sentence.

    >>> listed({"lms a": True, "lms b": False, "rls a": True}, True)
    'lms a, rls a'
    """
    return ", ".join(name for name, outcome in cases.items() if outcome is wanted) or "none"
