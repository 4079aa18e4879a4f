"""The work of `sweep`: rows, their order, what is said and written of it."""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_estimator.cli import common, many
from friction_estimator.cli.sweep import BEST, ROW_TABLE, SCHEMA, TABLE, TOLD, settings_text
from friction_estimator.core.errors import InputError, UnanswerableError
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import shown
from friction_estimator.documents.configuration import write_config
from friction_estimator.output.parquet import is_available, write_parquet
from friction_estimator.sweep.grid import Configurations, Settings
from friction_estimator.sweep.job import Job, judge, ready
from friction_estimator.sweep.ranking import Ranked, Ranking, best_baseline, log_nrmse_of, rank
from friction_estimator.tasks.identity import File
from friction_estimator.tasks.task import Failure


def run(args: argparse.Namespace, base: Config, configurations: Configurations, output: common.Output) -> int:
    """Compute, rank, tell and write; return the exit code."""
    many.tell_tables(output, TABLE, ROW_TABLE)
    configs = [base.updated(settings) for settings in configurations.settings]
    rows, text = _rows(args, configs, output)
    failed = _failed(args.bags, configurations.settings, rows)
    many.tell_failures(output, [(one["bag"], Failure(one["problem"], 1)) for one in failed], "rows")
    found = [[None if isinstance(row, Failure) else row for row in own] for own in rows]
    if not any(row for own in found for row in own):
        raise UnanswerableError(f"no configuration could be judged on any recording; the first: {failed[0]['problem']}")
    ranking = rank(configurations.settings, found)
    summary = _summary(args, configurations, ranking, found, failed)
    _tell(output, ranking, summary)
    with output.part() as folder:
        folder.mkdir()
        (folder / many.ROWS).write_text(text, encoding="utf-8")
        (folder / "summary.json").write_text(common.to_json(summary) + "\n", encoding="utf-8")
        best = ranking.ranked[0]
        header = f"The best of a sweep by friction_estimator: {settings_text(best.settings)}"
        write_config(folder / BEST, configs[best.number], header=header)
        _write_tables(folder, args, ranking, rows)
        _write_page(folder, args, ranking, summary)
    output.say(f"{'written':<12}{args.out}: report.html, summary.json, {TABLE}, {ROW_TABLE}, {BEST} (the best)")
    output.result(summary)
    return 0


def _rows(
    args: argparse.Namespace, configs: Sequence[Config], output: common.Output
) -> tuple[list[list[many.Row]], str]:
    """Return the row of each configuration and recording, and the text of the file that keeps them."""
    with many.workers(args, len(args.bags) * len(configs), ready) as pool:
        learned, topics = many.files(args.bags), common.topics_from(args)
        tests = many.files(args.test, "--test", learned)
        for file in tests:
            if isinstance(file, Failure):
                raise InputError(f"--test: {file.problem}")
        judges = [file for file in tests if isinstance(file, File)]
        settings = [many.changed_settings(config) for config in configs]
        facts = many.settings_facts(configs)
        pieces, places = [], []
        for r, file in enumerate(learned):
            if isinstance(file, Failure):
                continue
            others = tuple(other for other in judges if other.content != file.content)
            if args.test and not others:
                raise InputError(f"{args.bags[r]} would be judged on itself: give another recording with --test")
            share = 0.0 if others else args.freeze_after
            same = {"verb": "sweep", "recording": file.content, "others": [other.content for other in others]}
            for c in range(len(configs)):
                job = Job(file, others, settings[c], topics, share)
                own = {**same, "topics": topics, "share": share, **facts[c]}
                pieces.append(many.Piece(own, judge, (job,), file.content))
                places.append((c, r))
        found, text = many.computed(pieces, args, output, "sweeping", pool)
    rows: list[list[many.Row]] = [
        [file if isinstance(file, Failure) else Failure("", 1) for file in learned] for _ in configs
    ]
    for (c, r), row in zip(places, found, strict=True):
        rows[c][r] = row
    return rows, text


def _failed(
    bags: Sequence[str], settings: Sequence[Settings], rows: Sequence[Sequence[many.Row]]
) -> list[dict[str, Any]]:
    """Return what failed, recording by recording; one entry without settings where all configurations did alike."""
    out: list[dict[str, Any]] = []
    for r, bag in enumerate(bags):
        problems = {c: row.problem for c, own in enumerate(rows) if isinstance(row := own[r], Failure)}
        if len(problems) == len(rows) and len(set(problems.values())) == 1:
            out.append({"bag": bag, "settings": None, "problem": problems[0]})
        else:
            out += [{"bag": bag, "settings": settings[c], "problem": text} for c, text in problems.items()]
    return out


def _summary(
    args: argparse.Namespace,
    configurations: Configurations,
    ranking: Ranking,
    found: Sequence[Sequence[Mapping[str, Any] | None]],
    failed: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    best = ranking.ranked[0]
    rows = [row for row in found[best.number] if row is not None]
    quantities = Config.from_mapping({"input.motion": rows[0]["motion"]}).quantities
    names = list(dict.fromkeys(name for settings in configurations.settings for name in settings))
    return {
        "schema": SCHEMA,
        "bags": args.bags,
        "test": args.test,
        "judged_on": "test" if args.test else "held_out",
        "learned_share": None if args.test else args.freeze_after,
        "units": quantities.names,
        "noise_over": ranking.noise_over,
        "varied": {name: _values(name, configurations.settings) for name in names},
        "left_out": configurations.left_out,
        "configurations": [_entry(k, one) for k, one in enumerate(ranking.ranked, start=1)],
        "recordings": [
            {
                "bag": bag,
                "samples_learned": row and row["samples"],
                "samples_judged": row and sum(one["samples"] for one in row["judged"]),
                "nrmse_of_best": row and math.exp(log_nrmse_of(row)),
                "baseline_nrmse": row and best_baseline([row]),
            }
            for bag, row in zip(args.bags, found[best.number], strict=True)
        ],
        "baseline_nrmse": best_baseline(rows),
        "failed": failed,
    }


def _values(name: str, settings: Sequence[Settings]) -> list[Any]:
    """Return the values that a setting takes, in order."""
    return list(dict.fromkeys(one[name] for one in settings if name in one))


def _entry(place: int, one: Ranked) -> dict[str, Any]:
    """Return a configuration as JSON has it."""
    comparison = one.comparison
    return {
        "rank": place,
        "settings": one.settings,
        "nrmse": one.nrmse,
        "standard_error": one.standard_error,
        "ratio_to_best": comparison and {"value": comparison.ratio, "ci95": [comparison.low, comparison.high]},
        "told_from_best": one.told,
        "recordings": one.recordings,
        "failed": one.failed,
    }


def _tell(output: common.Output, ranking: Ranking, summary: Mapping[str, Any]) -> None:
    ranked = ranking.ranked
    output.say(f"{'':>4}  {'nrmse':<18}{'of the best':<24}settings")
    for place, one in enumerate(ranked[:TOLD], start=1):
        noise = "" if one.standard_error is None else f" +-{one.standard_error:.2g}"
        beside = ""
        if place > 1 and one.comparison is not None:
            beside = f"{one.comparison.ratio:.3f} ({one.comparison.low:.3f} to {one.comparison.high:.3f})"
        output.say(f"{place:>4}  {f'{one.nrmse:.4f}{noise}':<18}{beside:<24}{settings_text(one.settings)}")
    if len(ranked) > TOLD:
        output.say(f"      ... {len(ranked) - TOLD} more in {TABLE}")
    output.say(words(ranking))
    rival = summary["baseline_nrmse"]
    if rival is not None:
        output.say(f"{'beside':<12}{rival:.4f}, the best of the textbook's static curves fitted to the same samples")


def words(ranking: Ranking) -> str:
    """Return in a sentence which configurations cannot be told from the best."""
    ranked = ranking.ranked
    tied = sum(not one.told for one in ranked) - 1
    over = "recordings" if ranking.noise_over == "recordings" else "blocks of about a drive cycle of these recordings"
    if len(ranked) == 1:
        return "One configuration could be judged: there is nothing to rank."
    if not tied:
        return f"The best is told from all {len(ranked) - 1} others (95 %, noise over {over})."
    return f"{tied} of {len(ranked) - 1} others cannot be told from the best (95 %, noise over {over})."


def _write_tables(folder: Path, args: argparse.Namespace, ranking: Ranking, rows: Sequence[Sequence[many.Row]]) -> None:
    if not is_available():
        return
    ranked = ranking.ranked
    names = list(dict.fromkeys(name for one in ranked for name in one.settings))
    entries = [_entry(place, one) for place, one in enumerate(ranked, start=1)]
    ratios = [entry["ratio_to_best"] or {"value": None, "ci95": [None, None]} for entry in entries]
    columns: dict[str, list[Any]] = {"rank": [entry["rank"] for entry in entries]}
    columns |= {name: [one.settings.get(name) for one in ranked] for name in names}
    columns |= {name: [entry[name] for entry in entries] for name in ("nrmse", "standard_error")}
    columns |= {"ratio_to_best": [ratio["value"] for ratio in ratios]}
    columns |= {name: [ratio["ci95"][k] for ratio in ratios] for k, name in enumerate(("ratio_low", "ratio_high"))}
    columns |= {name: [entry[name] for entry in entries] for name in ("told_from_best", "recordings", "failed")}
    write_parquet(folder / TABLE, columns)
    flat = [(place, one, bag, row) for place, one in enumerate(ranked, start=1)
            for bag, row in zip(args.bags, rows[one.number], strict=True)]  # fmt: skip
    done = [None if isinstance(row, Failure) else row for *_, row in flat]
    columns = {"rank": [place for place, *_ in flat]}
    columns |= {name: [one.settings.get(name) for _, one, *_ in flat] for name in names}
    columns |= {
        "bag": [shown(bag) for _, _, bag, _ in flat],
        "nrmse": [row and math.exp(log_nrmse_of(row)) for row in done],
        "samples_learned": [row and row["samples"] for row in done],
        "samples_judged": [row and sum(one["samples"] for one in row["judged"]) for row in done],
        "problem": [row.problem if isinstance(row, Failure) else None for *_, row in flat],
    }
    write_parquet(folder / ROW_TABLE, columns)


def _write_page(folder: Path, args: argparse.Namespace, ranking: Ranking, summary: Mapping[str, Any]) -> None:
    from friction_estimator.cli.provenance import provenance  # noqa: PLC0415 - drawn at the end only
    from friction_estimator.report.page.sweep_page import sweep_page  # noqa: PLC0415
    from friction_estimator.report.page.write import write_page  # noqa: PLC0415

    page = sweep_page(ranking, summary, words(ranking), settings_text, provenance(args.words, [], None))
    write_page(folder / "report.html", page)
