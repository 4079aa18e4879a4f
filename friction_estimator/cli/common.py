"""What the verbs share: options, JSON, outputs."""

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, TypeAlias

from friction_estimator.cli.terminal import EXIT_CODES, Parser, say, say_document, warn
from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.quantities import Quantities, unit_named
from friction_estimator.core.settings.config import Config, retired
from friction_estimator.documents.configuration import config_of, read_parameters
from friction_estimator.output.journal import Journal
from friction_estimator.output.run import RunOutput
from friction_estimator.output.staging import Refusal
from friction_estimator.streams import ClosedStdout

INPUTS = ("velocity", "friction", "pressure", "temperature", "position", "joint_states")
"""What `--topic` can name."""

FIGURE_FORMATS = ("png", "svg")
"""What figures may be written as; a test holds it against `report.style`, which `--help` must not load."""

_RECORDING_SUFFIXES = {".mcap", ".db3", ".bag", ".zstd", ".csv", ".yaml"}


Subparsers: TypeAlias = "argparse._SubParsersAction[Parser]"  # the only name that argparse gives to this type


def add_verb(subparsers: Subparsers, name: str, summary: str, *, description: str, example: str) -> Parser:
    """Add the parser of one verb; its help ends with an example and the exit codes."""
    return subparsers.add_parser(
        name, help=summary, description=description, epilog=f"example:\n  {example}\n\n{EXIT_CODES}"
    )


def add_bag_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of every verb that reads a recording: `--topic`, `--joint`, `--config`."""
    group = add_topic_options(parser)
    group.add_argument("--config", metavar="YAML", help="ROS parameter file with the settings")
    add_units_option(parser)


def add_units_option(parser: argparse.ArgumentParser) -> None:
    """Add `--units`."""
    parser.add_argument(
        "--units",
        type=_units,
        default=(),
        metavar="UNIT,...",
        help="units of what people read, such as mm/s,N or rpm,mN m (default: SI); the JSON stays in SI",
    )


def add_figures_option(parser: argparse.ArgumentParser, usual: Sequence[str] = FIGURE_FORMATS[:1]) -> None:
    """Add `--figures`; `usual` are the formats where it is not given."""
    parser.add_argument(
        "--figures",
        type=_formats,
        default=tuple(usual),
        metavar="FORMAT,...",
        help=f"formats of the figures, of {', '.join(FIGURE_FORMATS)} (default: {','.join(usual)})",
    )


def seed(text: str) -> int:
    """Return the number of `--seed`; argparse.ArgumentTypeError where it is none or below zero."""
    try:
        number = int(text)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed: give 0 or a positive integer")
    return number


def _formats(text: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(text.split(",")))
    for name in formats:
        if name not in FIGURE_FORMATS:
            raise argparse.ArgumentTypeError(f"{name!r} is no format of figures: give {' or '.join(FIGURE_FORMATS)}")
    return formats


def _units(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    try:
        for name in names:
            unit_named(name)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return names


def quantities_from(args: argparse.Namespace, config: Config) -> Quantities:
    """Return what the drive's numbers are, shown in the units of `--units`.

    Raises InputError for a unit of the other kind of motion.
    """
    try:
        return config.quantities.in_units(args.units)
    except ConfigError as error:
        raise InputError(f"--units {','.join(args.units)}: {error}") from error


def add_topic_options(parser: argparse.ArgumentParser) -> "argparse._ArgumentGroup":
    """Add `--topic` and `--joint`, which say where in a recording the inputs are; return their group."""
    group = parser.add_argument_group("recording")
    group.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="INPUT=TOPIC",
        help=f"which topic is which input ({', '.join(INPUTS)}); may be repeated",
    )
    group.add_argument(
        "--joint",
        metavar="NAME|all",
        help="joint in JointState messages (default: the only one); with all, replay, identify and diagnose take every "
        "joint in turn: a table, and a folder a joint under --out",
    )
    return group


def topics_from(args: argparse.Namespace) -> dict[str, str]:
    """Return `--topic` as a mapping from input to topic; InputError where one is malformed or unknown."""
    topics: dict[str, str] = {}
    for item in args.topic:
        name, equals, topic = item.partition("=")
        if not equals or not topic:
            raise InputError(f"--topic {item}: write INPUT=TOPIC, for instance --topic velocity=/rig/velocity")
        if name not in INPUTS:
            raise InputError(f"--topic {item}: unknown input {name!r}: choose one of {', '.join(INPUTS)}")
        if name in topics:
            raise InputError(f"--topic {item}: {name} is given twice")
        topics[name] = topic
    return topics


def config_from(
    args: argparse.Namespace,
    overrides: Mapping[str, object] | None = None,
    warned: Callable[[str], None] = warn,
) -> Config:
    """Return the configuration: `--config`, then `--joint` and `overrides` (dotted names; None is no override).

    Of a configuration for several joints it is that of `--joint`, or of `input.joint`.
    """
    given = read_parameters(args.config) if args.config else None
    return config_with(given, args, overrides, warned)


def config_with(
    given: Mapping[str, Any] | None,
    args: argparse.Namespace,
    overrides: Mapping[str, object] | None = None,
    warned: Callable[[str], None] = warn,
) -> Config:
    """Return the configuration of parameters `given` in the file of `--config`, None where there is none."""
    config = Config()
    values = dict(overrides or {})
    if given is not None:
        joint = args.joint if args.joint is not None else given.get("input.joint")
        config = config_of(given, args.config, joint if isinstance(joint, str) else "")
        for line in retired(given):
            warned(f"{args.config}: {line}")
    if args.joint is not None:
        values["input.joint"] = args.joint
    return config.updated({name: value for name, value in values.items() if value is not None})


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add `--json FILE`; `-`, or no FILE, prints the JSON alone on stdout."""
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        metavar="FILE",
        type=_json_target,
        help="write the result as JSON; - (or no FILE) prints only JSON on stdout, messages go to stderr",
    )


def _json_target(text: str) -> str:
    if text != "-" and (Path(text).suffix in _RECORDING_SUFFIXES or Path(text).is_dir()):
        raise argparse.ArgumentTypeError(f"{text} is no JSON file; write `--json -` to print")
    if text == "-" and isinstance(sys.stdout, ClosedStdout):
        raise argparse.ArgumentTypeError("stdout is closed, the result cannot be printed; name a file")
    return text


class Outlet(Protocol):
    """Takes what a verb says, builds and finds: `Output`, or that of one joint of several (`cli.joints`)."""

    def part(self) -> AbstractContextManager[Path]:
        """Yield where to build what `out` names."""
        ...

    def say(self, text: str = "") -> None:
        """Take a line for the reader."""

    def warn(self, text: str) -> None:
        """Take a warning."""

    def result(self, value: object) -> None:
        """Take the JSON result."""


class Output:
    """Where a verb's words, files and result go (context manager).

    Entered before anything is computed: an output that cannot be written, is in use, or would replace an input or what
    is not this program's is known at once.

    Parameters
    ----------
    json_target : value of `--json`: None, "-" or a file name.
    out : value of `--out`.
    refusal : why a folder that stands under `out` may not be replaced (see `RunOutput`); None for a single file.
    inputs : what the verb reads (see `paths_read`).
    resumes : whether what an unfinished run has computed is kept (see `RunOutput`).
    """

    def __init__(
        self,
        json_target: str | None = None,
        out: str | None = None,
        refusal: Refusal | None = None,
        inputs: Sequence[str] = (),
        *,
        resumes: bool = False,
    ) -> None:
        self._prints = json_target == "-"
        self._files = RunOutput(out, refusal, None if self._prints else json_target, inputs, resumes=resumes)

    def __enter__(self) -> "Output":
        """Check and lock what is written; raises InputError."""
        self._files.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give up what was locked."""
        self._files.__exit__(kind, error, trace)

    def part(self) -> AbstractContextManager[Path]:
        """Yield where to build what `out` names; it is in place when the block ends without an exception."""
        return self._files.part()

    def journal(self) -> Journal:
        """Return what this run, or one like it that was not finished, has computed."""
        return self._files.journal()

    def say(self, text: str = "") -> None:
        """Print a line for the reader: on stdout, or on stderr where stdout carries JSON."""
        say(text, aside=self._prints)

    def warn(self, text: str) -> None:
        """Print a warning on stderr."""
        warn(text)

    def result(self, value: object) -> None:
        """Print or write the JSON result, where `--json` asks for one: the last thing that a verb does."""
        if self._prints:
            say_document(to_json(value))
        else:
            self._files.write_document(to_json(value) + "\n")


def paths_read(args: argparse.Namespace) -> list[str]:
    """Return the files that the options of a verb name as inputs, the theory table of `--config` included."""
    given = vars(args)
    paths = [*given.get("bags", ()), *given.get("test", ())]
    paths += [given[name] for name in ("bag", "table", "config") if given.get(name)]
    # Of a recording given by its metadata the whole folder is read.
    paths = [os.path.dirname(path) or "." if os.path.basename(path) == "metadata.yaml" else path for path in paths]
    if given.get("config"):
        table = read_parameters(args.config).get("theory.table")
        paths += [table] if isinstance(table, str) and table else []
    return paths


def to_json(value: object) -> str:
    """Return strict JSON: what is not finite becomes null, arrays become lists, dataclasses objects.

    It is ASCII: whatever a name holds, it passes any terminal, locale and file. A byte of a file name that is no UTF-8
    stays what Python makes of it, a lone surrogate (`os.fsencode` turns it back).

    >>> to_json({"nrmse": float("nan"), "taps": (1, 2.5)}).replace(chr(10), "")
    '{  "nrmse": null,  "taps": [    1,    2.5  ]}'
    """
    return json.dumps(plain(value), indent=2, allow_nan=False)


def plain(value: object) -> object:
    """Return a value as strict JSON holds it (see `to_json`)."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy scalars and arrays, without importing numpy
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int | None):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no JSON form")
