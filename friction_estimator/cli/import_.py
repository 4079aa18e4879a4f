"""`friction_estimator import`: a table becomes a recording."""

import argparse
from dataclasses import asdict

from friction_estimator.cli.common import Output, Subparsers, add_json_option, add_verb, paths_read
from friction_estimator.cli.progress import progress
from friction_estimator.cli.terminal import warn
from friction_estimator.core.errors import InputError

SCHEMA = "friction_estimator/import/1"


def add_parser(subparsers: Subparsers) -> None:
    """Add the verb's options."""
    parser = add_verb(
        subparsers,
        "import",
        "table (CSV, .mat, .npz, .parquet) to recording",
        description=(
            "Turn a table into a recording. Columns are mapped to inputs in SI units (m/s, N, absolute Pa, degC, m),\n"
            "with scale and offset where needed: velocity=v_mm_s*1e-3,pressure=p_bar*1e5+101325.\n\n"
            "A piece starts where the --segment column changes or time steps back by more than ten sample periods.\n"
            "It begins at least twenty sample periods after the one before, and at least 1 s after it where time\n"
            "restarts; its time is shifted later where need be. Rows that repeat a time, or step back a little, are\n"
            "left out; so are rows with an empty time, velocity or friction cell. All are counted. Time that begins\n"
            "before 1 s is shifted to begin at 1 s."
        ),
        example=(
            "friction_estimator import rig.csv --out rig_bag --time t_ms*1e-3 \\\n"
            "      --map velocity=v_mm_s*1e-3,friction=F_N,pressure=p_bar*1e5+101325 --where seal=O-ring"
        ),
    )
    parser.add_argument("table", metavar="TABLE", help="CSV, .mat (not v7.3), .npz or .parquet file")
    parser.add_argument("--out", required=True, metavar="BAG", help="recording to write (folder, or .mcap/.db3 file)")
    parser.add_argument("--time", required=True, metavar="COL", help="time in seconds (scale it: t_ms*1e-3)")
    parser.add_argument(
        "--map",
        required=True,
        action="append",
        metavar="INPUT=COL,...",
        help="velocity, friction, pressure, temperature, position; may be repeated",
    )
    parser.add_argument(
        "--where", action="append", default=[], metavar="COL=VALUE", help="keep matching rows; may be repeated"
    )
    parser.add_argument("--segment", metavar="COL", help="a change in this column makes a gap")
    parser.add_argument("--storage", choices=("mcap", "sqlite3"), help="default mcap")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Import the table; return the exit code."""
    from friction_estimator.bag.write import refusal_at, storage_of  # noqa: PLC0415 - `--help` needs none of them

    storage = storage_of(args.out, args.storage)
    with Output(args.json, args.out, refusal_at(args.out), paths_read(args)) as output:
        return _run(args, output, storage)


def _run(args: argparse.Namespace, output: Output, storage: str) -> int:
    from friction_estimator.bag.table import TableSpec, read_table  # noqa: PLC0415
    from friction_estimator.bag.write import add_samples, written  # noqa: PLC0415

    inputs: dict[str, str] = {}
    for item in ",".join(args.map).split(","):
        name, column = _pair("--map", item)
        if name in inputs:
            raise InputError(f"--map {item}: {name} is mapped twice")
        inputs[name] = column
    spec = TableSpec(args.time, inputs, [_pair("--where", item) for item in args.where], args.segment)
    samples, report = read_table(args.table, spec)
    for doubt in report.warnings:
        warn(doubt)
    with (
        progress("writing", unit="messages") as advance,
        output.part() as part,
        written(part, storage, advance) as writer,
    ):
        add_samples(writer, samples)
    duration_s = samples.duration_s
    output.say(
        f"{args.out}: {len(samples)} samples, {duration_s:.6g} s, {samples.sample_rate_hz:.6g} Hz, "
        f"{report.pieces - 1} gaps made; {report.selected} of {report.rows} rows selected"
    )
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
        form = "INPUT=COLUMN" if option == "--map" else "COLUMN=VALUE"
        raise InputError(f"{option} {item}: write {form}")
    return name.strip(), value.strip()
