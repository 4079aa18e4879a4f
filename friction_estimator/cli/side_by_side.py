"""A model that does not learn beside its rivals, as a table: for the console and for the page."""

from collections.abc import Sequence

import numpy as np

from friction_estimator.cli import common
from friction_estimator.core.fit.frozen_score import FrozenScore
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.online.shortcomings import ONE_DIRECTION, InMotion
from friction_estimator.core.quantities import FORCE, Quantities

NAMES = {
    "coulomb_viscous": "coulomb+viscous",
    "stribeck": "stribeck",
    "stribeck_asymmetric": "asym. stribeck",
    "persistence": "f[k-1]",
    "theory": "theory",
}
"""Baseline -> how a table's head calls it."""

STANDS = 0.02
"""Share of the samples at standstill from which those in motion have a row of their own."""

HEAD = ("without learning", "samples", "unit", "model", *NAMES.values())


def scores_of(result: Replay) -> list[tuple[str, FrozenScore, InMotion]]:
    """Return what was predicted without learning, by name, and in motion alone: the frozen part of the record, then
    other recordings.
    """
    frozen = result.frozen_score
    name = "after --freeze-after" if result.learned.any() else "all samples"
    own = [] if frozen is None else [(name, frozen, result.in_motion)]
    return own + [(other.name, other.score, other.in_motion) for other in result.others]


def rows(result: Replay, quantities: Quantities) -> list[tuple[str, ...]]:
    """Return rows of cells as `HEAD` names them for each of `scores_of`: nrmse, rms error in newton or so, and nrmse in
    motion where the shaft stands for a while.
    """
    out = []
    for name, score, moving in scores_of(result):
        values = [score.nrmse, *(score.baselines[key] for key in NAMES)]
        out.append((name, str(score.samples), "nrmse", *(_cell(value, 1.0) for value in values)))
        spread = quantities.value(score.spread_N, FORCE)
        out.append(("", "", quantities.force, *(_cell(value, spread) for value in values)))
        if moving.standing_share > STANDS:
            values = [moving.nrmse, *(moving.baselines.get(key) for key in NAMES)]
            out.append(("of these in motion", str(moving.samples), "nrmse", *(_cell(value, 1.0) for value in values)))
    return out


def _cell(value: float | None, factor: float) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{factor * value:.4g}"


def tell(output: common.Outlet, result: Replay, quantities: Quantities) -> None:
    """Print the table where something was predicted without learning, and why a model is no better."""
    _tell_table(output, rows(result, quantities))
    if result.one_way:
        output.say(f"{'note':<12}{quantities.worded(ONE_DIRECTION)}")
    for one in result.shortcomings:
        output.say(f"{'why':<12}{one.text}; {one.advice}")


def _tell_table(output: common.Outlet, lines: Sequence[Sequence[str]]) -> None:
    if not lines:
        return
    width = [max(len(line[k]) for line in [HEAD, *lines]) for k in range(len(HEAD))]
    for line in [HEAD, *lines]:
        output.say("  ".join(_placed(line, width)).rstrip())


def _placed(line: Sequence[str], width: Sequence[int]) -> list[str]:
    """Return the cells of a row at equal width: names to the left, figures to the right."""
    return [
        cell.ljust(size) if k == 0 else cell.rjust(size) for k, (cell, size) in enumerate(zip(line, width, strict=True))
    ]
