"""`diagnose`: what the simulation gets wrong, its named cause, the extended model, the gain."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from friction_estimator.cli import common, joints, many
from friction_estimator.cli.progress import progress
from friction_estimator.core.errors import InputError, about
from friction_estimator.core.memory import kept
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.output.layout import Layout, only

if TYPE_CHECKING:
    from friction_estimator.bag.recording import Recording
    from friction_estimator.bag.samples import Admitted
    from friction_estimator.diagnosis.result import Diagnosis
    from friction_estimator.effects.detection import Fault
    from friction_estimator.report.page.content import Section

EXTENDED = "extended.yaml"
Loaded: TypeAlias = "tuple[Recording, Admitted, list[Fault]]"
_HEADS = ("samples", "rate (Hz)", "held out", "extended")
_MARK = re.compile(r'\{\s*"schema": "friction_estimator/diagnosis/\d+"')


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "diagnose",
        "what the simulation gets wrong, the cause, the extended model, the gain",
        description="Fit the base model (theory, odd static curve, short FIR), look for what it cannot explain, name "
        "the cause, and write the model extended by it. Gains are measured on data that the fit never saw.",
        example="friction_estimator diagnose run1 run2 --out out\n"
        "  friction_estimator diagnose fleet/*/* --each --out out",
    )
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings, in the order in which they were made")
    parser.add_argument(
        "--out", metavar="DIR", help="write extended.yaml, figures/, report.html and summary.json into this folder"
    )
    common.add_figures_option(parser)
    parser.add_argument("--seed", type=common.seed, default=0, help="of folds and bootstrap (default 0)")
    fleet = parser.add_argument_group("many recordings")
    fleet.add_argument(
        "--each",
        action="store_true",
        help="diagnose each recording by itself: a table of what each shows, since when, and how it grows; what was "
        "computed is kept, and the same command goes on where it was interrupted",
    )
    fleet.add_argument(
        "--rig",
        metavar="REGEX",
        help="with --each: what in a recording's path names its rig, such as 'press_[0-9]+' (default: the folder that "
        "it lies in)",
    )
    many.add_options(parser)
    common.add_bag_options(parser)
    common.add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb; 1 for the verdict `undecidable`."""
    if args.each:
        from friction_estimator.cli import each  # noqa: PLC0415 - numpy and the readers

        return each.run(args)
    for name in ("rig", "workers", "scheduler"):
        if getattr(args, name) is not None:
            raise InputError(f"--{name} goes with --each: without it all recordings are diagnosed as one")
    with kept(), common.Output(args.json, args.out, joints.refusal(refusal), common.paths_read(args)) as output:
        return joints.run(args, output, _HEADS, _run)


def refusal(folder: Path) -> str | None:
    """Return why a folder may not be replaced by a diagnosis."""
    from friction_estimator.effects import EFFECTS  # noqa: PLC0415
    from friction_estimator.report.diagnosis_figures import REMAINDER  # noqa: PLC0415
    from friction_estimator.report.style import SUFFIXES  # noqa: PLC0415

    figures = only({*EFFECTS, REMAINDER}, SUFFIXES)
    return Layout("summary.json", _MARK, frozenset({"report.html", EXTENDED}), {"figures": figures}).refusal(folder)


def _run(args: argparse.Namespace, output: common.Outlet) -> joints.Outcome:
    # scipy takes a second to import: `--help` needs none of it.
    from friction_estimator.cli.data_quality import data_quality  # noqa: PLC0415
    from friction_estimator.cli.recorded import counted, settled, tell_theory  # noqa: PLC0415
    from friction_estimator.diagnosis.diagnose import diagnose  # noqa: PLC0415
    from friction_estimator.diagnosis.extend import is_offered  # noqa: PLC0415
    from friction_estimator.diagnosis.summary import as_json, judged_by, sentences  # noqa: PLC0415
    from friction_estimator.diagnosis.theory import theory_chosen  # noqa: PLC0415

    config = common.config_from(args, warned=output.warn)
    loaded = [_load(bag, args, config, output) for bag in args.bags]
    config = settled(config, [recording for recording, _, _ in loaded])
    quantities = common.quantities_from(args, config)
    recordings = [admitted.samples for _, admitted, _ in loaded]
    faults = {fault.name: fault for _, _, found in loaded for fault in found}
    with about(", ".join(args.bags)), progress("diagnosing", 100, unit="%") as advance:
        shown = 0

        def report(_stage: str, part: float) -> None:
            nonlocal shown
            done = min(100, round(100 * part))
            advance(max(0, done - shown))
            shown = max(shown, done)

        result = diagnose(recordings, config, seed=args.seed, progress=report, faults=tuple(faults.values()))
    tell_theory(output, theory_chosen(config, result.raw.samples), result.raw.samples)
    for line in sentences(result, quantities):
        output.say(line)
    extended = str(Path(args.out) / EXTENDED) if args.out and is_offered(result) else None
    summary = as_json(result, args.bags, {}, extended, quantities)
    if args.out:
        judged = judged_by(args.bags, extended, args.config, _reading(args))
        with output.part() as folder:
            data = data_quality(
                [recording for recording, _, _ in loaded],
                config,
                quantities,
                counted([admitted for _, admitted, _ in loaded]),
            )
            summary = _write(folder, args, result, quantities, extended, judged, data)
        for line in judged:
            output.say(line)
        output.say(f"written: {args.out}")
    output.result(summary)
    return _outcome(summary, recordings)


def _reading(args: argparse.Namespace) -> list[str]:
    """Return the options that say how the recordings are read, for another command over them."""
    topics = [word for topic in args.topic for word in ("--topic", topic)]
    return topics + (["--joint", args.joint] if args.joint else [])


def _outcome(summary: dict[str, Any], recordings: list[Samples]) -> joints.Outcome:
    """Return a diagnosis as a row of the table of joints."""
    gain = summary["total_gain"]
    cells = (
        str(sum(map(len, recordings))),
        f"{recordings[0].sample_rate_hz:.5g}",
        joints.figure(summary["base"]["nrmse_holdout"]),
        joints.figure(gain["nrmse_after"] if gain else None),
    )
    names = ", ".join(found["name"] for found in (*summary["effects"], *summary["faults"]))
    decided = summary["verdict"] != "undecidable"
    why = names if decided else "; ".join(summary["excitation"]["warnings"])
    return joints.Outcome(0 if decided else 1, cells, summary["verdict"] + (f": {why}" if why else ""), decided)


def _load(bag: str, args: argparse.Namespace, config: Config, output: common.Outlet) -> Loaded:
    """Return one recording, what of it was admitted and the faults of its stamps; say what was read."""
    from friction_estimator.fleet.reading import read_to_diagnose  # noqa: PLC0415

    with progress(f"reading {bag}", unit="messages") as advance:
        read = read_to_diagnose(bag, config, common.topics_from(args), advance)
    admitted = read.admitted
    refused = ", ".join(f"{count} {reason}" for reason, count in admitted.rejected.items())
    output.say(
        f"{bag}: {len(admitted.samples)} samples of {admitted.read}" + (f"; refused: {refused}" if refused else "")
    )
    return read.recording, admitted, read.faults


def _write(
    folder: Path,
    args: argparse.Namespace,
    result: "Diagnosis",
    quantities: Quantities,
    extended: str | None,
    judged: list[str],
    data: "Section",
) -> dict[str, Any]:
    """Write the diagnosis into `folder`, which is made here and will be `--out`; return its summary."""
    from friction_estimator.cli.provenance import provenance  # noqa: PLC0415
    from friction_estimator.diagnosis.extend import extended_config  # noqa: PLC0415
    from friction_estimator.diagnosis.summary import as_json  # noqa: PLC0415
    from friction_estimator.documents.configuration import write_config  # noqa: PLC0415
    from friction_estimator.report.diagnosis_figures import write_diagnosis_figures  # noqa: PLC0415
    from friction_estimator.report.page.diagnosis_page import diagnosis_page  # noqa: PLC0415
    from friction_estimator.report.page.write import write_page  # noqa: PLC0415

    folder.mkdir()
    if extended is not None:
        names = ", ".join([*(found.name for found in result.effects), *(fault.name for fault in result.faults)])
        write_config(
            folder / EXTENDED,
            extended_config(result),
            header=f"Written by friction_estimator diagnose from {', '.join(args.bags)}.\n"
            f"Base model with {names}; accepted by replay, simulate, diagnose and the live node.",
        )
    (folder / "figures").mkdir()
    drawn = write_diagnosis_figures(result, folder / "figures", quantities, args.figures)
    figures = {name: str(Path(args.out) / "figures" / path.name) for name, path in drawn.items()}
    summary = as_json(result, args.bags, figures, extended, quantities)
    (folder / "summary.json").write_text(common.to_json(summary) + "\n", encoding="utf-8")
    details = [data, *provenance(args.words, [Path(bag) for bag in args.bags], result.config)]
    write_page(folder / "report.html", diagnosis_page(result, args.bags, quantities, drawn, judged, details))
    return summary
