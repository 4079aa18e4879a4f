"""`diagnose --each`: each recording by itself, a table of all, and what grows over the recordings of a rig."""

import argparse
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_estimator.cli import common, many
from friction_estimator.core.errors import InputError, UnanswerableError
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.fleet.job import Job, diagnosed, ready
from friction_estimator.fleet.trend import UNDECIDABLE, Entry, Trend, date, findings, trends
from friction_estimator.output.layout import Layout
from friction_estimator.output.parquet import is_available, write_parquet
from friction_estimator.tasks.task import Failure

SCHEMA = "friction_estimator/fleet/1"
TABLE, FINDINGS = "table.parquet", "findings.parquet"

LAYOUT = Layout(
    "summary.json",
    re.compile(r'\{\s*"schema": "friction_estimator/fleet/\d+"'),
    frozenset({"report.html", TABLE, FINDINGS, many.ROWS}),
)

STAMP = "%Y-%m-%dT%H:%M:%SZ"
"""A date as JSON and tables have it."""

TOLD = 20
"""Lines of each kind that are printed; the others are in the tables."""


def run(args: argparse.Namespace) -> int:
    """Run `diagnose --each`; 1 where no recording could be decided."""
    many.check_options(args)
    if not args.out:
        raise InputError("--each needs --out DIR, where it also keeps what is computed if it is interrupted")
    if args.units:
        raise InputError("--units is not for --each: its table is in SI units")
    if args.figures != common.FIGURE_FORMATS[:1]:
        raise InputError("--figures is not for --each: it draws none; diagnose a recording alone")
    with common.Output(args.json, args.out, LAYOUT.refusal, common.paths_read(args), resumes=True) as output:
        return _run(args, output)


def _run(args: argparse.Namespace, output: common.Output) -> int:
    rigs = [rig_of(bag, args.rig) for bag in args.bags]
    many.tell_tables(output, TABLE, FINDINGS)
    rows, text = _rows(args, common.config_from(args, warned=output.warn), output)
    failures = [(bag, row) for bag, row in zip(args.bags, rows, strict=True) if isinstance(row, Failure)]
    many.tell_failures(output, failures, "recordings")
    if len(failures) == len(rows):
        raise UnanswerableError(f"no recording could be diagnosed; the first: {failures[0][1].problem}")
    entries = [
        Entry(rig, bag, row)
        for rig, bag, row in zip(rigs, args.bags, rows, strict=True)
        if not isinstance(row, Failure)
    ]
    found = trends(entries)
    summary = _summary(args, rigs, rows, found)
    _tell(output, entries, found, len(failures))
    with output.part() as folder:
        folder.mkdir()
        (folder / many.ROWS).write_text(text, encoding="utf-8")
        (folder / "summary.json").write_text(common.to_json(summary) + "\n", encoding="utf-8")
        _write_tables(folder, args.bags, rigs, rows)
        _write_page(folder, args, summary, found)
    output.say(f"{'written':<12}{args.out}: report.html, summary.json, {TABLE}, {FINDINGS}")
    output.result(summary)
    return 1 if all(entry.row["verdict"] == UNDECIDABLE for entry in entries) else 0


def rig_of(bag: str, pattern: str | None) -> str:
    """Return the name of the rig of a recording: what of its path a pattern finds, else the folder that holds it.

    >>> rig_of("fleet/press_3/monday", None), rig_of("fleet/press_3_monday.mcap", "press_([0-9]+)")
    ('press_3', '3')

    Raises InputError where the pattern is none, or finds nothing.
    """
    path = Path(bag).parent if Path(bag).name == "metadata.yaml" else Path(bag)
    if pattern is None:
        return path.absolute().parent.name
    try:
        match = re.search(pattern, str(path))
    except re.error as error:
        raise InputError(f"--rig {pattern}: {error}") from None
    if match is None:
        raise InputError(f"--rig {pattern}: nothing in {bag} is like that")
    return (match[1] if match.re.groups else match[0]) or ""


def _rows(args: argparse.Namespace, config: Config, output: common.Output) -> tuple[list[many.Row], str]:
    """Return the row of each recording, and the text of the file that keeps them."""
    with many.workers(args, len(args.bags), ready) as pool:
        files, topics = many.files(args.bags), common.topics_from(args)
        facts = {"verb": "diagnose", "topics": topics, "seed": args.seed, **many.settings_facts([config])[0]}
        settings = many.changed_settings(config)
        pieces = [
            many.Piece({**facts, "recording": file.content}, diagnosed, (Job(file, settings, topics, args.seed),))
            for file in files
            if not isinstance(file, Failure)
        ]
        computed, text = many.computed(pieces, args, output, "diagnosing", pool)
    following = iter(computed)
    return [file if isinstance(file, Failure) else next(following) for file in files], text


def _summary(
    args: argparse.Namespace, rigs: Sequence[str], rows: Sequence[many.Row], found: Sequence[Trend]
) -> dict[str, Any]:
    recordings: list[dict[str, Any]] = []
    for bag, rig, row in zip(args.bags, rigs, rows, strict=True):
        known = {"problem": row.problem} if isinstance(row, Failure) else {"problem": None, **row}
        recordings.append(
            {"bag": bag, "rig": rig, "start": None if isinstance(row, Failure) else date(row, STAMP), **known}
        )
    return {"schema": SCHEMA, "recordings": recordings, "trends": [_trend(one) for one in found]}


def _trend(one: Trend) -> dict[str, Any]:
    """Return a trend as JSON has it."""
    return {
        "rig": one.rig,
        "name": one.name,
        "recordings": one.recordings,
        "of": one.of,
        "since": {"bag": one.since.bag, "start": date(one.since.row, STAMP)},
        "last_without": one.before and {"bag": one.before.bag, "start": date(one.before.row, STAMP)},
        "gain_percent": one.gain_percent,
        "parameters": {
            course.name: {
                "unit": course.unit,
                "first": course.first,
                "last": course.last,
                "growth": course.growth
                and {
                    "value": course.growth.value,
                    "ci95": [course.growth.low, course.growth.high],
                    "per": course.growth.per,
                },
            }
            for course in one.courses
        },
    }


def _tell(output: common.Output, entries: Sequence[Entry], found: Sequence[Trend], failed: int) -> None:
    for entry in entries[:TOLD]:
        names = ", ".join(one["name"] for one in findings(entry.row))
        output.say(f"{shown(entry.bag, LONGEST_NAME)}  {entry.row['verdict']}{f': {names}' if names else ''}")
    if len(entries) > TOLD:
        output.say(f"... {len(entries) - TOLD} more in {TABLE}")
    verdicts = Counter(entry.row["verdict"] for entry in entries) + Counter(failed=failed)
    output.say("together    " + ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()))
    for trend in found[:TOLD]:
        output.say(f"{trend.rig}: {words(trend)}")
    if len(found) > TOLD:
        output.say(f"... {len(found) - TOLD} more on the page")


def words(trend: Trend) -> str:
    """Return a trend in a sentence or two."""
    since, before = (entry and date(entry.row) for entry in (trend.since, trend.before))
    if since is None or since == before:  # their clock does not say which was first: as they were given
        since, before = (entry and shown(Path(entry.bag).name, LONGEST_NAME) for entry in (trend.since, trend.before))
    text = f"{trend.name} in {trend.recordings} of {trend.of} recordings, first in that of {since}"
    if before is not None:
        text += f" and not in that of {before}"
    for course in trend.courses:
        growth = course.growth
        if growth is not None and growth.told:
            text += (
                f"; {course.name.replace('_', ' ')} changes by {growth.value:.3g} ({growth.low:.3g} to "
                f"{growth.high:.3g}) {course.unit} a {growth.per}"
            )
    return text


def _write_tables(folder: Path, bags: Sequence[str], rigs: Sequence[str], rows: Sequence[many.Row]) -> None:
    if not is_available():
        return
    done = [None if isinstance(row, Failure) else row for row in rows]
    same: dict[str, list[Any]] = {"rig": [shown(rig) for rig in rigs], "bag": [shown(bag) for bag in bags]}
    gains = [row and row["total_gain"] for row in done]
    write_parquet(
        folder / TABLE,
        same
        | {"start": [row and date(row, STAMP) for row in done]}
        | {name: [row and row[name] for row in done] for name in ("duration_s", "samples", "rate_hz", "verdict")}
        | {
            "effects": [row and [one["name"] for one in row["effects"]] for row in done],
            "faults": [row and [one["name"] for one in row["faults"]] for row in done],
            "nrmse_holdout": [row and row["base"]["nrmse_holdout"] for row in done],
            "noise_floor": [row and row["base"]["noise_floor"] for row in done],
            "nrmse_after": [gain and gain["nrmse_after"] for gain in gains],
            "gain_percent": [gain and gain["reduction_percent"] for gain in gains],
            "unexplained_percent": [row and row["unexplained_percent"] for row in done],
            "problem": [row.problem if isinstance(row, Failure) else None for row in rows],
        },
    )
    names = (
        "rig",
        "bag",
        "start",
        "kind",
        "name",
        "parameter",
        "value",
        "low",
        "high",
        "unit",
        "p_value",
        "gain_percent",
    )
    flat = [
        (shown(rig), shown(bag), date(row, STAMP), kind, one["name"], key, item["value"], *item["ci95"], item["unit"],
         one.get("p_value"), (one.get("gain") or {}).get("reduction_percent"))
        for rig, bag, row in zip(rigs, bags, done, strict=True) if row is not None
        for kind in ("effects", "faults")
        for one in row[kind]
        for key, item in (one["parameters"] or {"": {"value": None, "ci95": [None, None], "unit": ""}}).items()
    ]  # fmt: skip
    write_parquet(folder / FINDINGS, {name: [line[k] for line in flat] for k, name in enumerate(names)})


def _write_page(folder: Path, args: argparse.Namespace, summary: Mapping[str, Any], found: Sequence[Trend]) -> None:
    from friction_estimator.cli.provenance import provenance  # noqa: PLC0415 - drawn at the end only
    from friction_estimator.report.page.fleet_page import fleet_page  # noqa: PLC0415
    from friction_estimator.report.page.write import write_page  # noqa: PLC0415

    write_page(folder / "report.html", fleet_page(summary, found, words, provenance(args.words, [], None)))
