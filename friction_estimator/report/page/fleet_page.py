"""The page of `diagnose --each`: which recording shows what, since when, and how it grows."""

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from friction_estimator.core.text import counted
from friction_estimator.fleet.trend import UNDECIDABLE, Growth, Trend, date
from friction_estimator.report.page.content import CAUTION, GOOD, NEUTRAL, Advice, Light, Page, Section, Whisker

MOST_ROWS = 300
"""Rows of a table on the page; the files beside it have all."""

Rows = list[Sequence[object]]

HOW = (
    "Each recording was diagnosed by itself; gains are on samples that no fit saw. An effect that is not named in a "
    "recording need not be absent from it: its own diagnosis says how large it would have to be.",
    "Growth: slope of a straight line through the values, weighted by their intervals, with its 95 % interval, widened "
    "where the values scatter more than their intervals say. It is told of three recordings and more, and is of "
    "those in which the effect was named. Many slopes are tried: one in twenty leaves out 0 by chance.",
)


def fleet_page(
    summary: Mapping[str, Any], found: Sequence[Trend], told: Callable[[Trend], str], details: Sequence[Section]
) -> Page:
    """Return the page.

    Parameters
    ----------
    summary : the JSON. found : the trends. told : a trend in a sentence. details : sections on the run.
    """
    entries = summary["recordings"]
    verdicts = Counter("failed" if one["problem"] else one["verdict"] for one in entries)
    rigs = list(dict.fromkeys(one["rig"] for one in entries))
    growing = [one for one in found if any(course.growth and course.growth.told for course in one.courses)]
    sections = [_by_rig(entries, rigs, found), *_growth(found), _recordings(entries), *_failed(entries)]
    sections.append(Section("How to read it", HOW, folded=True))
    return Page(
        title="Recordings compared",
        lead=f"{len(entries)} recordings of {counted(len(rigs), 'rig')}, each diagnosed by itself",
        verdict=_verdict(verdicts, growing, told),
        light=_light(verdicts, growing),
        advice=_advice(entries, growing),
        facts=[(name.replace("_", " "), str(count), "recordings") for name, count in verdicts.most_common()],
        sections=[*sections, *details],
    )  # fmt: skip


def _verdict(verdicts: Counter[str], growing: Sequence[Trend], told: Callable[[Trend], str]) -> str:
    text = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in verdicts.most_common()) + "."
    return text + (f" What changes: {'; '.join(f'{one.rig}: {told(one)}' for one in growing[:3])}." if growing else "")


def _light(verdicts: Mapping[str, int], growing: Sequence[Trend]) -> Light:
    if verdicts.get("failed") or verdicts.get("undecidable"):
        return Light(CAUTION, "Some recordings could not be read or cannot tell: what is said is of the others.")
    if growing:
        return Light(NEUTRAL, "Something changes from recording to recording.")
    return Light(GOOD, "Every recording could be diagnosed.")


def _advice(entries: Sequence[Mapping[str, Any]], growing: Sequence[Trend]) -> list[Advice]:
    shown = next((one for one in entries if not one["problem"] and (one["effects"] or one["faults"])), None)
    if shown is None and not growing:
        return []
    bag = growing[0].since.bag if growing else str(shown and shown["bag"])
    return [Advice("One of them in full:", f"friction_estimator diagnose {shlex.quote(bag)} --out diagnosed")]


def _by_rig(entries: Sequence[Mapping[str, Any]], rigs: Sequence[str], found: Sequence[Trend]) -> Section:
    """Return what each rig shows: how many of its recordings, since when, and what naming it wins."""
    rows: Rows = [("rig", "what", "", "recordings", "since", "not yet in", "gain (%)")]
    for rig in rigs[:MOST_ROWS]:
        own = [one for one in found if one.rig == rig]
        for one in own:
            gain = "" if one.gain_percent is None else f"{one.gain_percent:.1f}"
            before = "" if one.before is None else _when(one.before.bag, one.before.row)
            rows.append(
                (
                    rig,
                    one.name,
                    one.what,
                    f"{one.recordings} of {one.of}",
                    _when(one.since.bag, one.since.row),
                    before,
                    gain,
                )
            )
        if not own:
            count = sum(one["rig"] == rig and not one["problem"] and one["verdict"] != UNDECIDABLE for one in entries)
            rows.append((rig, "nothing named", "", f"0 of {count}", "", "", ""))
    return Section("By rig", ["Gain: median of what naming it takes off the held-out error."], rows[: MOST_ROWS + 1])


def _growth(found: Sequence[Trend]) -> list[Section]:
    """Return the growth of parameters, each drawn about 0 on a scale of its own; those that are told come first."""
    known = [(one, course, course.growth) for one in found for course in one.courses if course.growth is not None]
    known.sort(key=lambda item: not item[2].told)
    rows: Rows = [("rig", "what", "parameter", "first", "last", "change", "0 in the middle", "")]
    for one, course, growth in known[:MOST_ROWS]:
        word = "changes" if growth.told else "not told from 0"
        text = f"{growth.value:.3g} ({growth.low:.3g} to {growth.high:.3g}) {course.unit} a {growth.per}"
        rows.append((
            one.rig, one.name, course.name.replace("_", " "), f"{course.first:.4g} {course.unit}",
            f"{course.last:.4g} {course.unit}", text, _drawn(growth, text), word,
        ))  # fmt: skip
    return [Section("How it grows", [], rows)] if known else []


def _drawn(growth: Growth, text: str) -> Whisker:
    reach = max(abs(growth.low), abs(growth.high)) or 1.0
    return Whisker(growth.value, growth.low, growth.high, (-reach, reach), text, quiet=not growth.told)


def _recordings(entries: Sequence[Mapping[str, Any]]) -> Section:
    rows: Rows = [("recording", "rig", "start", "verdict", "what", "error (%)", "noise (%)", "after (%)", "left (%)")]
    for one in entries[:MOST_ROWS]:
        if one["problem"]:
            rows.append((one["bag"], one["rig"], "", "failed", "", "", "", "", ""))
            continue
        what = ", ".join(_figures(found) for found in (*one["effects"], *one["faults"]))
        gain = one["total_gain"]
        after = "" if gain is None else _percent(gain["nrmse_after"])
        rows.append((
            one["bag"], one["rig"], _when("", one), one["verdict"].replace("_", " "), what,
            _percent(one["base"]["nrmse_holdout"]), _percent(one["base"]["noise_floor"]), after,
            f"{one['unexplained_percent']:.1f}",
        ))  # fmt: skip
    text = [
        "Error of the base model on held-out samples, of what does not repeat, and with all that was found, over the "
        "friction's spread; left: what of it is above the noise."
    ]
    if len(entries) > MOST_ROWS:
        text.append(f"{len(entries) - MOST_ROWS} more are in table.parquet.")
    return Section("Recordings", text, rows)


def _figures(found: Mapping[str, Any]) -> str:
    """Return a finding with its first parameter and interval."""
    for name, item in found["parameters"].items():
        if item["value"] is not None:
            low, high = ("" if end is None else f"{end:.3g}" for end in item["ci95"])
            return f"{found['name']} ({name.replace('_', ' ')} {item['value']:.3g} {item['unit']}, {low} to {high})"
    return str(found["name"])


def _failed(entries: Sequence[Mapping[str, Any]]) -> list[Section]:
    failed = [one for one in entries if one["problem"]]
    rows: Rows = [("recording", "why"), *((one["bag"], one["problem"]) for one in failed[:MOST_ROWS])]
    return [Section("What failed", [], rows)] if failed else []


def _percent(value: float) -> str:
    return f"{100.0 * value:.2f}"


def _when(bag: str, row: Mapping[str, Any]) -> str:
    return date(row) or bag
