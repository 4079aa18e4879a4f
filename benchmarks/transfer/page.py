"""Targets and tables in Markdown."""

import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))  # behind: a page.py stands there too
import tables


@dataclass(frozen=True)
class Target:
    """A figure of the issue, what was measured, and where it was worst.

    Attributes
    ----------
    what : the figure. value : measured. limit : the bound. least : whether the bound is a lower one.
    worst : the row that decided. judged : False for figures that the issue sets no bound for.
    """

    what: str
    value: float
    limit: float
    worst: str = ""
    least: bool = False
    judged: bool = True

    @property
    def passed(self) -> bool:
        """Whether it is met; what is not finite is not."""
        return self.value >= self.limit if self.least else self.value <= self.limit

    @property
    def verdict(self) -> str:
        if math.isnan(self.value):
            return "not measured"
        word = "pass" if self.passed else "**FAIL**"
        return word if self.judged else f"({word.strip('*').lower()})"


def number(value) -> str:
    """Return a value as a cell shows it."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "-" if math.isnan(value) else f"{value:.3g}"
    return str(value)


def table(rows: Iterable[dict]) -> str:
    """Return rows with the same keys as a table; the keys of the first are the heads."""
    rows = list(rows)
    if not rows:
        return "(no rows)"
    return tables.table(list(rows[0]), [[number(value) for value in row.values()] for row in rows])


def target_table(targets: Iterable[Target]) -> str:
    """Return targets as a table; verdicts in brackets are of figures that the issue sets no bound for."""
    return table(
        {
            "figure": t.what,
            "measured": t.value,
            "bound": f"{'at least' if t.least else 'at most'} {t.limit:g}",
            "": t.verdict,
            "worst": t.worst,
        }
        for t in targets
    )


def grouped(rows: Iterable[dict], *keys: str) -> dict[tuple, list[dict]]:
    """Return rows by their values of `keys`, in order of appearance."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def median(rows: Iterable[dict], name: str) -> float:
    """Return the median of a column; NaN where there is nothing."""
    values = [row[name] for row in rows if row[name] is not None]
    return float(np.median(values)) if values else float("nan")


def least(rows: Iterable[dict], name: str) -> float:
    return float(min((row[name] for row in rows), default=float("nan")))


def worst(
    what: str,
    rows: Iterable[dict],
    name: str,
    limit: float,
    label: Callable[[dict], str],
    *,
    least: bool = False,
    judged: bool = True,
) -> Target:
    """Return the target that the worst of all rows has to meet; a NaN is the worst."""
    rows = [row for row in rows if row[name] is not None]
    if not rows:
        return Target(what, float("nan"), limit, "no such row", least, judged)
    bad = max(rows, key=lambda row: (math.isnan(row[name]), -row[name] if least else row[name]))
    value = float(bad[name])
    return Target(what, math.inf if math.isnan(value) and not least else value, limit, label(bad), least, judged)
