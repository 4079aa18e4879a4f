"""`friction_estimator import`: a table becomes a recording."""

import argparse
from dataclasses import asdict

from friction_estimator.cli.common import Output, Subparsers, add_json_option, add_verb, paths_read
from friction_estimator.cli.progress import progress
from friction_estimator.cli.terminal import warn
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import ROTARY

SCHEMA = "friction_estimator/import/1"


def add_parser(subparsers: Subparsers) -> None:
    """Add the verb's options."""
    parser = add_verb(
        subparsers,
        "import",
        "table (CSV, .mat, .npz, .parquet) to recording",
        description=(
            "Turn a table into a recording. Each input is arithmetic over columns, in SI units (m/s, N, absolute Pa,\n"
            "degC, m; of a rotary drive rad/s, N m, rad): + - * / **, pi, the functions abs sqrt exp log log10 sin\n"
            "cos tan asin acos atan atan2 tanh sign min max, and d(), the derivative by time, without delay. A unit\n"
            "in brackets turns a column into SI units: v[mm/s], q[deg], n[rpm], tau[mN m], p[bar], T[degF]; a unit\n"
            "in the column's own name, v [mm/s] or Force (N), does so by itself. Units of rotation make the recording\n"
            'rotary. Columns are named as in the table, or in quotes where that reads as something else: "2"*3.\n\n'
            "A piece starts where the --segment column changes or time steps back by more than ten sample periods.\n"
            "It begins at least twenty sample periods after the one before, and at least 1 s after it where time\n"
            "restarts; its time is shifted later where need be. Rows that repeat a time, or step back a little, are\n"
            "left out; so are rows with an empty time, velocity or friction cell, or where arithmetic has no answer.\n"
            "All are counted. Time that begins before 1 s is shifted to begin at 1 s."
        ),
        example=(
            "friction_estimator import rig.csv --out rig_bag --time t_ms*1e-3 \\\n"
            "      --map velocity=v_mm_s*1e-3,friction=F_N,pressure=p[bar]+101325 --where seal=O-ring\n"
            "  friction_estimator import arm.csv --out arm --time t \\\n"
            "      --map 'position=q[deg],velocity=d(q[deg]),friction=tau-0.0189*acc-1.2*sin(q[deg])'"
        ),
    )
    parser.add_argument("table", metavar="TABLE", help="CSV, .mat (not v7.3), .npz or .parquet file")
    parser.add_argument("--out", required=True, metavar="BAG", help="recording to write (folder, or .mcap/.db3 file)")
    parser.add_argument("--time", required=True, metavar="COL", help="time in seconds (t_ms*1e-3, t[ms])")
    parser.add_argument(
        "--map",
        required=True,
        action="append",
        metavar="INPUT=EXPR,...",
        help="velocity, friction, pressure, temperature, position; may be repeated. Without velocity it is d(position)",
    )
    parser.add_argument(
        "--where", action="append", default=[], metavar="COL=VALUE", help="keep matching rows; may be repeated"
    )
    parser.add_argument("--segment", metavar="COL", help="a change in this column makes a gap")
    parser.add_argument(
        "--rate",
        type=float,
        default=0.0,
        metavar="HZ",
        help="sample rate of the recording; a filter without delay passes 0.4 of it and stops 0.6",
    )
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), help="default mcap")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Import the table; return the exit code."""
    from friction_estimator.bag.write import refusal_at, storage_of  # noqa: PLC0415 - `--help` needs none of them

    storage = storage_of(args.out, args.storage)
    with Output(args.json, args.out, refusal_at(args.out), paths_read(args)) as output:
        return _run(args, output, storage)


def _run(args: argparse.Namespace, output: Output, storage: str) -> int:
    from friction_estimator.bag.expression_text import parts  # noqa: PLC0415
    from friction_estimator.bag.table import read_table  # noqa: PLC0415
    from friction_estimator.bag.table_map import TableSpec  # noqa: PLC0415
    from friction_estimator.bag.write import add_samples, written  # noqa: PLC0415

    inputs: dict[str, str] = {}
    for item in (part for text in args.map for part in parts(text)):
        name, column = _pair("--map", item)
        if name in inputs:
            raise InputError(f"--map {item}: {name} is mapped twice")
        inputs[name] = column
    spec = TableSpec(args.time, inputs, [_pair("--where", item) for item in args.where], args.segment, args.rate)
    samples, report = read_table(args.table, spec)
    for doubt in report.warnings:
        warn(doubt)
    with (
        progress("writing", unit="messages") as advance,
        output.part() as part,
        written(part, storage, advance) as writer,
    ):
        add_samples(writer, samples, motion=report.motion)
    duration_s = samples.duration_s
    output.say(
        f"{args.out}: {len(samples)} samples, {duration_s:.6g} s, {samples.sample_rate_hz:.6g} Hz, "
        f"{report.pieces - 1} gaps made; {report.selected} of {report.rows} rows selected"
    )
    for name, unit in report.units.items():
        output.say(f"column {name} is read as {unit}, by its name")
    if report.motion == ROTARY:
        output.say("the units are those of a rotary drive: rad/s, N m and rad are written")
    left_out = {f"empty {name}": count for name, count in report.missing.items()}
    left_out |= {f"infinite {name}": count for name, count in report.infinite.items()}
    left_out |= {"duplicate time": report.duplicate, "backward time": report.backward}
    told = [f"{count} {reason}" for reason, count in left_out.items() if count]
    if told:
        output.say(f"missing samples (rows left out): {', '.join(told)}")
    for name, count in report.not_held.items():
        output.say(f"{name}: {count} empty or infinite cells; the last value is held")
    output.result(
        {
            "schema": SCHEMA,
            "table": args.table,
            "bag": args.out,
            "samples": len(samples),
            "duration_s": duration_s,
            "sample_rate_hz": samples.sample_rate_hz,
            "gaps": report.pieces - 1,
            **asdict(report),
        }
    )
    return 0


def _pair(option: str, item: str) -> tuple[str, str]:
    name, equals, value = item.partition("=")
    if not equals or not name.strip() or not value.strip():
        form = "INPUT=EXPRESSION" if option == "--map" else "COLUMN=VALUE"
        raise InputError(f"{option} {item}: write {form}")
    return name.strip(), value.strip()
