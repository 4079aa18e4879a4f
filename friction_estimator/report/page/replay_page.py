"""The page of `replay`, of the demonstration and of `identify`."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.fit.frozen_score import FrozenScore
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.text import LONGEST_NAME, number, shown
from friction_estimator.report.page import trust
from friction_estimator.report.page.content import Advice, Chart, Page, Section
from friction_estimator.report.page.write import is_interactive


def replay_page(
    result: Replay,
    scores: list[tuple[str, FrozenScore]],
    summary: Mapping[str, Any],
    q: Quantities,
    files: Sequence[tuple[Path, str]],
    elsewhere: Sequence[Section],
    details: Sequence[Section],
    *,
    fitted: bool = False,
    words: Sequence[str] = (),
) -> Page:
    """Return the page of a replay, or of a fit that is written as one.

    Parameters
    ----------
    scores : what was predicted without learning, by name. summary : the JSON of the run. q : how numbers are shown.
    files : figures for where there are no charts. elsewhere : sections on what was predicted without learning.
    details : sections on the data and on the run.
    fitted : True for a batch fit: its samples were all known, and none was predicted before it was used.
    words : the command line, which advice repeats with more options; one is made of the recordings where there is none.
    """
    light, advice = trust.trust(result, scores, q, fitted=fitted, diverged=summary["diverged"])
    advice = [_with_command(one, summary, words) for one in advice]
    charts: Mapping[str, Sequence[Chart]] = {}
    if is_interactive():
        from friction_estimator.report.page.replay_charts import replay_charts  # noqa: PLC0415

        charts = replay_charts(result, q, fitted)
    what = "fitted to all samples at once" if fitted else f"law {summary['law']}"
    bags = ", ".join(shown(bag, LONGEST_NAME) for bag in summary["bags"])
    return Page(
        title="Friction identified" if fitted else "Friction estimated",
        lead=f"{result.config.structure} model, {what}, over {bags}; theoretical curve: {summary['theory']}",
        verdict=_verdict(result, scores, q, fitted),
        light=light,
        advice=advice,
        facts=_facts(result, scores, summary, q),
        sections=[
            Section("Over time", charts=charts.get("time", ())),
            Section("Friction against velocity", charts=charts.get("map", ())),
            *([_online(summary)] if summary.get("online") else []),
            Section("Error", charts=charts.get("error", ())),
            *elsewhere,
            Section("What is left, by channel", charts=charts.get("left", ())),
            Section("What was learned", _taps_text(summary), charts=charts.get("taps", ())),
            *details,
        ],
        files=files,
    )


def _with_command(advice: Advice, summary: Mapping[str, Any], words: Sequence[str]) -> Advice:
    """Return advice whose command is whole: the one that made the page, with all its options, and what to add."""
    if not advice.command:
        return advice
    verb = "identify" if summary["law"] == "batch" else "replay"
    again = words if list(words[1:2]) == [verb] else ["friction_estimator", verb, *summary["bags"]]
    more = {"--test": "--test OTHER_RECORDING"}.get(advice.command, advice.command)
    return Advice(advice.text, f"{shlex.join(again)} {more}")


def _verdict(result: Replay, scores: list[tuple[str, FrozenScore]], q: Quantities, fitted: bool) -> str:
    errors = trust.errors_at_the_end(result)
    verb = "Fitted" if fitted else "Predicted"
    if not np.isfinite(errors.model) or errors.model > 1e6 * errors.spread:
        return "The estimate diverged: its predictions mean nothing."
    text = (
        f"{verb} to ±{q.text(errors.model, FORCE, '.2g')} rms over the last fifth of the record, "
        f"{_percent(errors.share)} of the friction's spread there"
    )
    theory = errors.rivals.get("theory")
    if theory is not None and errors.model > 0.0:
        text += f"; {_times(theory / errors.model)} than the theory"
    known = errors.rivals.get("coulomb_viscous")
    if known is not None and errors.model > 0.0:
        text += f"{',' if theory is not None else ';'} {_times(known / errors.model)} than Coulomb and viscous friction"
    for name, score in scores[:2]:
        where = _place(name)
        error = q.text(score.nrmse * score.spread_N, FORCE, ".2g")
        text += f"; {where}, without learning: ±{error}"
    return text + "."


def _place(name: str) -> str:
    """Return in words what a score without learning is of: another recording, or a part of this one."""
    return "on the rest of the record" if name.startswith("after --") else f"on {shown(name, 60)}"


def _percent(share: float) -> str:
    return f"{number(100 * share, '.2g')} %"


def _times(factor: float) -> str:
    """Return a comparison in words: 22 times better, no better, 1.3 times worse."""
    if not np.isfinite(factor):
        return "not comparable"
    if 1.0 / trust.CLEARLY < factor < trust.CLEARLY:
        return "no better"
    if factor >= 1.0:
        return f"{number(factor, '.2g')} times better"
    return f"{number(1.0 / max(factor, 1e-12), '.2g')} times worse"


def _facts(
    result: Replay, scores: list[tuple[str, FrozenScore]], summary: Mapping[str, Any], q: Quantities
) -> list[tuple[str, str, str]]:
    errors = trust.errors_at_the_end(result)
    out = [("error, last fifth", q.text(errors.model, FORCE, ".3g"), f"{_percent(errors.share)} of the spread")]
    whole = summary["nrmse"] * metrics.spread(result.samples.friction_N)
    out.append(("error, all samples", q.text(whole, FORCE, ".3g"), f"nrmse {summary['nrmse']:.4f}"))
    for name, score in scores[:2]:
        error = q.text(score.nrmse * score.spread_N, FORCE, ".3g")
        out.append((f"without learning, {_place(name)}", error, f"{_percent(score.nrmse)} of the spread"))
    known = errors.rivals.get("coulomb_viscous")
    if known is not None:
        out.append(("Coulomb and viscous, fitted", q.text(known, FORCE, ".3g"), "last fifth, for comparison"))
    rate = summary["sample_rate_hz"]
    told = f"{len(result.samples)} samples" + (f" at {rate:.4g} Hz" if np.isfinite(rate) else "")
    out.append(("recorded", f"{summary['duration_s']:.4g} s", told))
    return out


def _taps_text(summary: Mapping[str, Any]) -> list[str]:
    if summary.get("identifiable_rank") is None:
        return []
    return [
        f"The recording determines {summary['identifiable_rank']} of the {summary['parameter_count']} directions in "
        "parameter space; the prior decides the others, and single values of taps and weights may differ from run to "
        "run where the prediction does not."
    ]


def _online(summary: Mapping[str, Any]) -> Section:
    rows: list[Sequence[object]] = [("law", "nrmse, last fifth", "times the fit's", "nrmse, all samples", "times it")]
    for law, row in summary["online"].items():
        rows.append((law, *(float(row[key]) for key in ("nrmse_final", "excess_final", "nrmse", "excess"))))
    text = (
        "The fit knows every sample beforehand: it is the least that this structure can leave. The online laws predict "
        "each sample before they see it; what they err more is the price of learning while running."
    )
    return Section("The online laws beside the fit", [text], rows)
