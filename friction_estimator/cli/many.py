"""Many recordings at once: what `sweep` and `diagnose --each` share. A task and a row for each, computed once."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_estimator.cli import common
from friction_estimator.cli.progress import progress
from friction_estimator.core.errors import FrictionEstimatorError, InputError
from friction_estimator.core.settings.config import PATHS, Config
from friction_estimator.output.journal import Journal, line
from friction_estimator.output.parquet import is_available
from friction_estimator.tasks import identity
from friction_estimator.tasks.identity import File
from friction_estimator.tasks.local import MOST_WORKERS, LocalWorkers, usable_cores
from friction_estimator.tasks.task import Failure, Task, Workers

ROWS = "rows.jsonl"
"""Every row as it was computed, under its digest: a later run into the same folder takes over what is still valid."""

MOST_TASKS = 200_000
"""Rows that a run holds in memory at the end, some 3 kB each."""

_TOLD = 3
"""Failures that are told one by one."""


@dataclass(frozen=True)
class Piece:
    """A task to be: what identifies its result, how it is computed, and with which others it shares a recording."""

    facts: Mapping[str, Any]
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    kin: str | None = None


Row = dict[str, Any] | Failure
"""What a task returned, or why it did not."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--scheduler`."""
    group = parser.add_argument_group("where it is computed")
    group.add_argument(
        "--workers", type=int, metavar="N", help="processes of this machine (default: one for each core)"
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="compute on the workers of this Dask scheduler instead, such as tcp://host:8786; they need this package "
        "and the recordings under the same paths",
    )


def check_options(args: argparse.Namespace) -> None:
    """Raise InputError for options that cannot be used together, or out of range."""
    if args.workers is not None and args.scheduler is not None:
        raise InputError("--workers is of this machine, --scheduler of another: give one of them")
    if args.workers is not None and not 1 <= args.workers <= MOST_WORKERS:
        raise InputError(f"--workers {args.workers}: give 1 to {MOST_WORKERS}")
    if args.joint == "all":
        raise InputError("--joint all makes a table of joints, and this is one of recordings: name one joint")


def files(bags: Sequence[str], what: str = "BAG", known: Sequence[File | Failure] = ()) -> list[File | Failure]:
    """Return the recordings with the digest of their content; a failure for one that cannot be read.

    Parameters
    ----------
    what : the option that names them. known : recordings whose digest was taken before.

    Raises InputError where one does not exist, or two are the same.
    """
    paths = [Path(bag).parent if Path(bag).name == "metadata.yaml" else Path(bag) for bag in bags]
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: no such recording")
    before = {file.path: file for file in known if isinstance(file, File)}
    found: list[File | Failure] = []
    new = [path for path in paths if str(path.resolve()) not in before]
    with progress("hashing", sum(map(identity.size, new)), unit="B") as advance:
        for path in paths:
            if (file := before.get(str(path.resolve()))) is not None:
                found.append(file)
                continue
            try:
                # The time is taken first: a change while it is read shows, too.
                changed = identity.changed_ns(path)
                found.append(File(str(path.resolve()), identity.content(path, advance), changed))
            except FrictionEstimatorError as error:
                found.append(Failure(str(error), error.exit_code))
    _refuse_doubles(paths, found, what)
    return found


def _refuse_doubles(paths: Sequence[Path], found: Sequence[File | Failure], what: str) -> None:
    first: dict[str, Path] = {}
    doubles = []
    folders = {path.resolve(): path for path in paths if path.is_dir()}
    for path, file in zip(paths, found, strict=True):
        if path.is_file() and path.resolve().parent in folders:
            doubles.append(f"{path} is a file of {folders[path.resolve().parent]}")
        elif isinstance(file, File):
            if file.content in first:
                doubles.append(f"{path} is the same recording as {first[file.content]}")
            first.setdefault(file.content, path)
    if doubles:
        more = f" ({len(doubles) - 1} more like this)" if len(doubles) > 1 else ""
        raise InputError(f"{doubles[0]}{more}: each would count twice; give one of them as {what}")


def settings_facts(configs: Sequence[Config]) -> list[dict[str, Any]]:
    """Return what a result follows from in each configuration: every value, and the content of the files it names."""
    contents: dict[str, str] = {}
    """By path: many configurations name one table."""
    out = []
    for config in configs:
        facts: dict[str, Any] = dict(config.to_mapping())
        for name in PATHS:
            path = str(facts.get(name) or "")
            if path and name != "state.file":
                if path not in contents:
                    contents[path] = identity.content(Path(path))
                facts[f"{name} content"] = contents[path]
        out.append(facts)
    return out


def changed_settings(config: Config) -> dict[str, Any]:
    """Return the settings that differ from the defaults."""
    usual = Config().to_mapping()
    return {name: value for name, value in config.to_mapping().items() if value != usual[name]}


def computed(
    pieces: Sequence[Piece], args: argparse.Namespace, output: common.Output, label: str, pool: Workers
) -> tuple[list[Row], str]:
    """Return the row of each piece, in their order, and the text of `ROWS`.

    What an unfinished run into the same folder has computed is taken over, and of the finished one that stands there
    what did not fail.
    """
    code = identity.code()
    keys = [identity.digest({"code": code, **piece.facts}) for piece in pieces]
    if len(keys) > MOST_TASKS:
        raise InputError(f"these are {len(keys)} rows, at most {MOST_TASKS} are computed at once: take fewer at a time")
    wanted = set(keys)
    with output.journal() as journal:
        former = Journal(Path(args.out) / ROWS).rows()
        known = {key: row for key, row in former.items() if key in wanted and _is_row(row) and row["problem"] is None}
        known |= {key: row for key, row in journal.rows().items() if key in wanted and _is_row(row)}
        tasks = [
            Task(key, piece.function, piece.arguments, piece.kin)
            for key, piece in dict(zip(keys, pieces, strict=True)).items()
            if key not in known
        ]
        if known:
            output.say(f"taken over  {len(known)} of {len(wanted)} rows from an earlier run")
        with progress(label, len(tasks), unit="rows") as advance:
            for done in pool.run(tasks):
                row = _plain(done.result, done.failure)
                if done.failure is not None and "--debug" in args.words and done.failure.trace:
                    output.warn(done.failure.trace)
                journal.add(str(done.task.key), row)
                known[str(done.task.key)] = row
                advance(1)
    text = "".join(line(key, known[key]) for key in dict.fromkeys(keys))
    return [_row(known[key]) for key in keys], text


def workers(args: argparse.Namespace, most: int, ready: Callable[[], None]) -> Workers:
    """Return who computes, by `--workers` and `--scheduler`.

    Those of this machine load what they need while the recordings are still looked at.

    Parameters
    ----------
    most : rows that there may be. ready : what loads it.
    """
    if args.scheduler is not None:
        from friction_estimator.tasks.cluster import Cluster  # noqa: PLC0415

        return Cluster(args.scheduler)
    return LocalWorkers(min(args.workers or usable_cores(), most), ready)


def tell_failures(output: common.Output, failures: Sequence[tuple[str, Failure]], of: str) -> None:
    """Warn of recordings that failed: the first few by name, then how many more."""
    for name, failure in failures[:_TOLD]:
        output.warn(failure.problem if name in failure.problem else f"{name}: {failure.problem}")
    if len(failures) > _TOLD:
        output.warn(f"{len(failures) - _TOLD} more {of} failed: each has its reason in the table")


def tell_tables(output: common.Output, *tables: str) -> None:
    """Warn of tables that cannot be written here."""
    if not is_available():
        output.warn(f"{' and '.join(tables)} are left out: pip install 'friction_estimator[parquet]'")


def _plain(result: Any, failure: Failure | None) -> dict[str, Any]:
    """Return a row as JSON holds it, so that one that was taken over is the same as one that was computed."""
    entry = {"result": result, "problem": failure and failure.problem, "code": failure.code if failure else 0}
    found = common.plain(entry)
    assert isinstance(found, dict)
    return found


def _is_row(entry: Any) -> bool:
    """Whether an entry of a journal is one of ours: a file in `--out` may have been edited."""
    return isinstance(entry, dict) and set(entry) == {"result", "problem", "code"}


def _row(entry: Mapping[str, Any]) -> Row:
    if entry["problem"] is not None:
        return Failure(entry["problem"], entry["code"])
    return dict(entry["result"])
