"""The page of `sweep`: configurations in order, with the noise of each figure, and what each setting is worth."""

import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from friction_estimator.report.page.content import CAUTION, GOOD, NEUTRAL, Advice, Light, Page, Section, Whisker
from friction_estimator.sweep.grid import Settings
from friction_estimator.sweep.ranking import BLOCKS, Ranked, Ranking

MOST_ROWS = 200
"""Rows of a table on the page; the files beside it have all."""

FEW_RECORDINGS = 20
"""More of them are folded away."""

LEFT, WIDEST = 0.5, 3.0
"""Error over that of the best at the ends of what is drawn: what is worse needs no picture."""

Rows = list[Sequence[object]]

Told = Callable[[Settings], str]

OF_SAME_DRIVE = (
    "Judged on later parts of the same recordings: how well it holds on another drive, --test on other recordings says."
)
WORTH = (
    "The best that was reached with each value, whatever the others: a setting whose values cannot be told apart need "
    "not be tuned."
)
ERROR = (
    "Error: rms of measured minus predicted friction where the model did not learn, over the standard deviation of "
    "what was measured; over several recordings the geometric mean."
)
OVER_BLOCKS = (
    "Noise is over blocks of about a drive cycle: it holds for more of the same drive. How much recordings differ from "
    "each other, six or more of them say."
)
OVER_RECORDINGS = "Noise is over recordings: it holds for others like these."
RATIO = (
    "A ratio to the best compares both on the same samples, so that what is hard for all drops out. Intervals hold for "
    "all comparisons at once (95 %): the best of many always looks better than it is."
)


def sweep_page(
    ranking: Ranking, summary: Mapping[str, Any], verdict: str, told: Told, details: Sequence[Section]
) -> Page:
    """Return the page.

    Parameters
    ----------
    summary : the JSON of the sweep. verdict : which cannot be told from the best, in a sentence.
    told : settings in a line. details : sections on the run.
    """
    ranked, rival = ranking.ranked, summary["baseline_nrmse"]
    best, others = ranked[0], len(ranked) - 1
    judged_on = f"{len(summary['test'])} recordings" if summary["test"] else "the rest of it"
    noise = "" if best.standard_error is None else f", standard error {best.standard_error:.2g}"
    facts = [
        ("best error", f"{best.nrmse:.4f}", f"rms over the friction's spread, where it did not learn{noise}"),
        ("not told from it", str(sum(not one.told for one in ranked) - 1), f"of {others} others"),
    ]
    if rival is not None:
        facts.append(("static curve", f"{rival:.4f}", "the best of the textbook's, fitted to the same samples"))
    sections = [_order(ranked, told), *_worth(ranked, summary), _recordings(summary), *_failed(summary, told)]
    over = OVER_BLOCKS if ranking.noise_over == BLOCKS else OVER_RECORDINGS
    sections.append(Section("How to read it", [ERROR, over, RATIO], folded=True))
    return Page(
        title="Configurations compared",
        lead=f"{len(ranked)} configurations, each learned on each of {len(summary['bags'])} recordings, judged on "
        f"{judged_on}",
        verdict=f"Best: {told(best.settings)}. {verdict}",
        light=_light(best, summary),
        advice=[*_edges(ranked, summary), _next(summary)],
        facts=facts,
        sections=[*sections, *details],
    )


def _light(best: Ranked, summary: Mapping[str, Any]) -> Light:
    rival = summary["baseline_nrmse"]
    if rival is not None and best.nrmse >= rival:
        return Light(CAUTION, "A static curve fitted to the same samples predicts no worse than the best of them.")
    if not summary["test"]:
        return Light(NEUTRAL, OF_SAME_DRIVE)
    return Light(GOOD, "Judged on recordings that were not learned.")


def _edges(ranked: Sequence[Ranked], summary: Mapping[str, Any]) -> list[Advice]:
    """Return what to try further where the best stands at the end of what was tried."""
    out = []
    for name, values in summary["varied"].items():
        if len(values) < 3 or not all(type(value) in (int, float) for value in values):
            continue
        value, ends = ranked[0].settings.get(name), (min(values), max(values))
        inner = next((one for one in ranked if one.settings.get(name) not in (None, *ends)), None)
        if value in ends and inner is not None and inner.told:
            which = "smallest" if value == ends[0] else "largest"
            out.append(Advice(f"The best {name} is the {which} that was tried, {_shown(value)}: try further ones."))
    return out


def _next(summary: Mapping[str, Any]) -> Advice:
    bag = shlex.quote(str(summary["bags"][0]))
    command = f"friction_estimator replay {bag} --config config.yaml --freeze-after 0.5 --out replayed"
    return Advice("What the best (config.yaml) does to a recording, on a page:", command)


def _order(ranked: Sequence[Ranked], told: Told) -> Section:
    rows: Rows = [("place", "error", "standard error", "over the best", "", "", "settings")]
    comparisons = [one.comparison for one in ranked[1:MOST_ROWS] if one.comparison is not None]
    left = max(LEFT, min([0.99, *(one.low for one in comparisons)]))
    right = min(WIDEST, max([1.01, *(one.high for one in comparisons)]))
    for place, one in enumerate(ranked[:MOST_ROWS], start=1):
        beside = _beside(one, (left, right), best=place == 1)
        rows.append((place, f"{one.nrmse:.4f}", _shown(one.standard_error), *beside, told(one.settings)))
    return Section("In order", _more(len(ranked), "table.parquet"), rows)


def _beside(one: Ranked, reach: tuple[float, float], *, best: bool) -> tuple[object, object, str]:
    """Return how a configuration compares with the best: in numbers, drawn, and in a word."""
    if best:
        return "", "", "the best"
    comparison = one.comparison
    word = "worse" if one.told else "not told from it"
    if one.failed:
        word = f"failed on {one.failed}"
    if comparison is None:
        return "", "", word
    text = f"{comparison.ratio:.3f} ({comparison.low:.3f} to {comparison.high:.3f})"
    drawn = Whisker(comparison.ratio, comparison.low, comparison.high, reach, text, quiet=comparison.told)
    return text, drawn, word


def _worth(ranked: Sequence[Ranked], summary: Mapping[str, Any]) -> list[Section]:
    """Return for each setting the best that was reached with each of its values."""
    rows: Rows = [("setting", "value", "best error with it", "over the best", "")]
    for name, values in summary["varied"].items():
        if 1 < len(values) <= MOST_ROWS // 4:
            for value in values:
                first = next((one for one in ranked if one.settings.get(name) == value), None)
                if first is not None:
                    interval, _, word = _beside(first, (0.0, 1.0), best=first is ranked[0])
                    rows.append((name, _shown(value), f"{first.nrmse:.4f}", interval, word))
    return [Section("What each setting is worth", [WORTH], rows)] if len(rows) > 1 else []


def _recordings(summary: Mapping[str, Any]) -> Section:
    rows: Rows = [("recording", "samples learned", "samples judged", "error of the best", "static curve")]
    entries = summary["recordings"]
    names = ("bag", "samples_learned", "samples_judged", "nrmse_of_best", "baseline_nrmse")
    rows += [[_shown(one[name]) for name in names] for one in entries[:MOST_ROWS]]
    return Section("Recordings", _more(len(entries), "rows.parquet"), rows, folded=len(entries) > FEW_RECORDINGS)


def _failed(summary: Mapping[str, Any], told: Told) -> list[Section]:
    failed = summary["failed"]
    rows: Rows = [("recording", "settings", "why")]
    for one in failed[:MOST_ROWS]:
        rows.append((one["bag"], "all" if one["settings"] is None else told(one["settings"]), one["problem"]))
    return [Section("What failed", _more(len(failed), "summary.json"), rows)] if failed else []


def _more(count: int, file: str) -> list[str]:
    return [f"{count - MOST_ROWS} more are in {file}."] if count > MOST_ROWS else []


def _shown(value: object) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_shown, value))}]"
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
