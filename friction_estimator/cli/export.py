"""`export`: what was learned, for a controller or a simulator, with the error that each simplification costs."""

import argparse
from pathlib import Path

import numpy as np

from friction_estimator.added_terms import added_terms
from friction_estimator.cli import common
from friction_estimator.cli.recorded import load
from friction_estimator.cli.terminal import say_document
from friction_estimator.core.errors import InputError
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.regular_file import read_regular
from friction_estimator.documents.load import Limits, parse_json
from friction_estimator.export import FORMATS
from friction_estimator.export.learned import Learned

SUMMARY = Limits(size=16 * 2**20, depth=32, nodes=500_000)
"""Of the summary.json of a run; its curves have 401 points a joint."""


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    kinds = "\n".join(f"  {name:<6}{kind.summary}" for name, kind in FORMATS.items())
    parser = common.add_verb(
        subparsers,
        "export",
        "what was learned, for a controller or a simulator",
        description="Write a learned model in a form that others read, and say the error of that form over the\n"
        f"recording that was learned from, or over those of --recording:\n{kinds}",
        example="friction_estimator replay bags/demo --out out\n"
        "  friction_estimator export out --format c --out friction_model.h\n"
        "  friction_estimator export out --format urdf",
    )
    parser.add_argument(
        "model",
        metavar="MODEL",
        help="folder that replay or identify wrote with --out, its config.yaml, or the parameters that a node dumped",
    )
    parser.add_argument("--format", required=True, choices=list(FORMATS), help="what to write")
    parser.add_argument("--out", metavar="FILE", help="where to (default: standard output)")
    parser.add_argument(
        "--recording",
        nargs="+",
        action="extend",
        default=[],
        metavar="BAG",
        help="recordings to fit to and be judged on (default: those of MODEL)",
    )
    common.add_topic_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    # What people read goes to stderr: the text may go to stdout.
    with common.Output("-", args.out, inputs=_inputs(args)) as output:
        return _run(args, output)


def _run(args: argparse.Namespace, output: common.Output) -> int:
    kind = FORMATS[args.format]
    learned = _learned(args, output)
    if kind.needs_recording and learned.samples is None:
        raise InputError(
            f"{args.model} has no recording beside it, and --format {args.format} is fitted to one: "
            "give --recording BAG"
        )
    exported = kind.write(learned)
    if args.out:
        with output.part() as part:
            part.write_text(exported.text, encoding="utf-8")
        output.say(f"{'written':<12}{args.out}")
    else:
        say_document(exported.text.rstrip("\n"))
    for line in learned.cost(exported.error_rms_N):
        output.say(line)
    return 0


def _inputs(args: argparse.Namespace) -> list[str]:
    """Return what is read: model, recordings, theory table, and what the run left beside its config.yaml."""
    settings = _settings(args)
    beside = [path for path in (settings.parent / "summary.json", settings.parent / "bag") if path.exists()]
    config = str(settings) if settings.is_file() else None
    return [*map(str, beside), *common.paths_read(argparse.Namespace(bags=args.recording, config=config))]


def _settings(args: argparse.Namespace) -> Path:
    given = Path(args.model)
    return given / "config.yaml" if given.is_dir() else given


def _learned(args: argparse.Namespace, output: common.Output) -> Learned:
    """Read the model and, where there is one, the recording."""
    given = Path(args.model)
    settings = _settings(args)
    if given.is_dir() and not settings.is_file():
        raise InputError(f"{given} has no config.yaml: give the folder that replay or identify wrote with --out")
    folder = settings.parent
    read = argparse.Namespace(
        bags=args.recording or _recordings(folder / "bag"),
        test=[],
        config=str(settings),
        topic=args.topic,
        joint=args.joint,
        units=(),  # the file is in SI units
    )
    config, samples = common.config_from(read), None
    Learned(str(given), config)  # a model that holds nothing is refused before a recording is read
    if read.bags:
        session = load(read, output)
        config, samples = session.config, session.samples
    return Learned(str(given), config, added_terms(config), _curve(folder / "summary.json"), samples, read.bags)


def _recordings(path: Path) -> list[str]:
    """Return the recordings that a run left in its folder bag/."""
    if (path / "metadata.yaml").is_file():
        return [str(path)]
    return sorted(str(item.parent) for item in path.glob("*/metadata.yaml"))


def _curve(summary: Path) -> Curve | None:
    """Return the curve with its band that a run wrote beside its config.yaml; None where there is none."""
    try:
        curve = parse_json(read_regular(summary, SUMMARY.size), str(summary), SUMMARY)["curve"]
        share = curve["learned_share"]
        velocity, *forces = (np.array(curve[key], float) for key in ("velocity_m_s", "friction_N", "low_N", "high_N"))
        pressure, temperature = float(curve["pressure_Pa"]), float(curve["temperature_degC"])
    except (InputError, ValueError, KeyError, TypeError):
        return None
    friction, low, high = forces
    if not all(np.isfinite(column).all() and column.shape == velocity.shape for column in (velocity, *forces)):
        return None
    known = None if share is None else np.array(share, float)
    return Curve(velocity, friction, low, high, known, pressure, temperature)
