"""`sweep`: configurations over recordings, ranked by their error where they did not learn."""

import argparse
import re
from collections.abc import Mapping, Sequence
from typing import Any

from friction_estimator.cli import common
from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import counted
from friction_estimator.documents.grid import Ends, Given, parse_set, read_grid
from friction_estimator.output.layout import Layout
from friction_estimator.sweep.grid import MOST_CONFIGURATIONS, Axis, Configurations, Span, axis, drawn, grid, span

SCHEMA = "friction_estimator/sweep/1"
TABLE, ROW_TABLE, BEST = "table.parquet", "rows.parquet", "config.yaml"
TOLD = 10
"""Configurations that are printed; the others are in the table."""

LAYOUT = Layout(
    "summary.json",
    re.compile(r'\{\s*"schema": "friction_estimator/sweep/\d+"'),
    frozenset({"report.html", TABLE, ROW_TABLE, BEST, "rows.jsonl"}),
)


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    from friction_estimator.cli import many  # noqa: PLC0415 - the list of verbs needs none of it

    parser = common.add_verb(
        subparsers,
        "sweep",
        "configurations over recordings, ranked where they did not learn",
        description="Learn each recording with each configuration, and judge it on what was not learned: the later "
        "part of the recording, or other recordings (--test). Ranks the configurations with the noise of each figure "
        "and says which cannot be told from the best. What is computed is kept: the same command goes on where it was "
        "interrupted.",
        example="friction_estimator sweep monday tuesday --set law=nlms,rls --set fir.order=0,4,8 --out swept\n"
        "  friction_estimator sweep runs/* --test runs/* --config grid.yaml --out swept\n"
        "  friction_estimator sweep monday --set prior.tap_deviation=0.01..1:log --random 50 --out swept",
    )
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings, each learned by itself")
    parser.add_argument(
        "--test",
        nargs="+",
        action="extend",
        default=[],
        metavar="BAG",
        help="judge on these recordings; one that is also learned judges the others only; give them after BAG",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=V1,V2,...",
        help="alternatives for a setting, as in a parameter file; of one that takes lists each is a list: "
        "--set 'load.terms=[],[inertia]'; with --random also LOW..HIGH or LOW..HIGH:log; may be repeated",
    )
    parser.add_argument(
        "--random",
        type=int,
        metavar="N",
        help=f"draw N configurations instead of taking all of the grid (all: at most {MOST_CONFIGURATIONS})",
    )
    parser.add_argument("--seed", type=common.seed, default=0, help="of --random (default: %(default)s)")
    parser.add_argument(
        "--freeze-after",
        type=float,
        default=0.5,
        metavar="FRACTION",
        help="without --test: learn this first fraction of each recording, judge the rest (default: %(default)s)",
    )
    parser.add_argument(
        "--out", metavar="DIR", required=True, help=f"write report.html, summary.json, {TABLE}, {ROW_TABLE}, {BEST}"
    )
    many.add_options(parser)
    common.add_bag_options(parser)
    common.add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    from friction_estimator.cli import many  # noqa: PLC0415

    many.check_options(args)
    if not args.test and not 0.0 < args.freeze_after < 1.0:
        raise InputError(f"--freeze-after {args.freeze_after:g}: something must be learned and something judged; "
                         "give a fraction between 0 and 1")  # fmt: skip
    given = read_grid(args.config) if args.config else Given()
    inputs = [*args.bags, *args.test, *([args.config] if args.config else []), *_tables(given)]
    with common.Output(args.json, args.out, LAYOUT.refusal, inputs, resumes=True) as output:
        return _run(args, given, output)


def _run(args: argparse.Namespace, given: Given, output: common.Output) -> int:
    from friction_estimator.cli import swept  # noqa: PLC0415 - numpy and the readers

    base = common.config_with(given.shared if args.config else None, args, warned=output.warn)
    configurations = configurations_of(args, given, base)
    output.say(f"{counted(len(configurations.settings), 'configuration')}, {counted(len(args.bags), 'recording')}")
    if configurations.left_out:
        told = counted(len(configurations.left_out), "combination")
        output.say(f"left out    {told} that cannot be: {configurations.left_out[0]}")
    return swept.run(args, base, configurations, output)


def configurations_of(args: argparse.Namespace, given: Given, base: Config) -> Configurations:
    """Return the configurations that are asked for. Raises ConfigError."""
    ways: dict[str, Axis | Span] = {}
    for name, values in given.alternatives.items():
        one = axis(name, values)
        ways[one.name] = one
    named: set[str] = set()
    for text in args.set:
        name, told = parse_set(text)
        if isinstance(told, Ends):
            if args.random is None:
                raise ConfigError(f"--set {text}: a span is drawn from: give --random N, or name the values")
            way: Axis | Span = span(name, told.low, told.high, logarithmic=told.logarithmic)
        else:
            way = axis(name, told)
        if way.name in named:
            raise ConfigError(f"--set {text}: {way.name} is set twice; write all of its values in one")
        named.add(way.name)
        ways[way.name] = way
    if not ways:
        raise ConfigError("nothing is varied: name alternatives with --set NAME=V1,V2,... or as lists in --config")
    if args.random is not None:
        return drawn(base, list(ways.values()), args.random, args.seed)
    return grid(base, [way for way in ways.values() if isinstance(way, Axis)])


def _tables(given: Given) -> list[str]:
    """Return the files that the parameter file names as inputs."""
    names: Sequence[Any] = [given.shared.get("theory.table"), *given.alternatives.get("theory.table", [])]
    return [name for name in names if isinstance(name, str) and name]


def settings_text(settings: Mapping[str, Any]) -> str:
    """Return settings in one line, as `--set` takes them.

    >>> settings_text({"model.law": "rls", "fir.order": 4, "load.terms": ("inertia",)})
    'model.law=rls fir.order=4 load.terms=[inertia]'
    """
    return " ".join(f"{name}={value_text(value)}" for name, value in settings.items()) or "as given"


def value_text(value: Any) -> str:
    """Return a value as a parameter file has it."""
    if isinstance(value, tuple | list):
        return f"[{','.join(map(value_text, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
