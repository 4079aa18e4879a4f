"""`--joint all`: a verb over every joint of a recording, as a table, a folder a joint and one JSON document."""

import argparse
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_estimator.cli import common
from friction_estimator.cli.progress import progress
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError, sentence
from friction_estimator.core.settings.joint_names import plain_names
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.output.layout import Layout
from friction_estimator.output.staging import Refusal

if TYPE_CHECKING:
    from friction_estimator.core.online.replay import Replay

SCHEMA = "friction_estimator/joints/1"
ALL = "all"

_MARK = re.compile(r'\{\s*"schema": "friction_estimator/joints/\d+"')

HEADS = ("samples", "rate (Hz)", "nrmse final", "frozen")
"""Of `outcome`."""

NO_BETTER = 1.05
"""A frozen error above this many times that of a Coulomb-viscous line is no gain over it."""

_NUMBER_WIDTH = 11

_NAMELESS = "a joint without a name cannot be chosen: name it in its driver"


@dataclass(frozen=True)
class Outcome:
    """How a verb ended for one joint, or for the only drive of a recording.

    Attributes
    ----------
    code : exit code.
    cells : figures for the table of `--joint all`, under the verb's heads.
    verdict : what came out, in words.
    answered : whether the data told anything; where not, `verdict` says why.
    """

    code: int
    cells: tuple[str, ...]
    verdict: str
    answered: bool = True


Verb = Callable[[argparse.Namespace, common.Outlet], Outcome]
"""Runs for the joint in `args.joint`."""


def run(args: argparse.Namespace, output: common.Output, heads: Sequence[str], verb: Verb) -> int:
    """Run a verb for the joint that is asked for, or for each of a recording; return the exit code.

    With `--joint all` a joint that fails is a row of the table with its reason. The code is 0 if one joint could be
    answered and 1 if none could; what the usage or the files made fail for every joint is raised.
    """
    if args.joint != ALL:
        return verb(args, output).code
    shared: list[str] = []
    """Warnings about the configuration, which every joint would repeat."""
    joints = joints_of(args, shared.append)
    for line in shared:
        output.warn(line)
    folders = plain_names(filter(None, joints)) if args.out else {}
    width = max(len("joint"), *(len(shown(name, LONGEST_NAME)) for name in joints))
    _tell(output, width, "joint", heads, "verdict")
    documents: dict[str, Any] = {}
    failures: list[FrictionEstimatorError] = []
    answered = False
    with ExitStack() as stack:
        folder = stack.enter_context(output.part()) if args.out else None
        if folder is not None:
            folder.mkdir()
        for joint in joints:
            name = folders.get(joint, "")
            own = argparse.Namespace(**{**vars(args), "joint": joint, "out": args.out and str(Path(args.out) / name)})
            outlet = _JointOutlet(folder and folder / name)
            try:
                if not joint:
                    raise UnanswerableError(_NAMELESS)
                outcome = verb(own, outlet)
            except FrictionEstimatorError as error:
                failures.append(error)
                outcome = Outcome(error.exit_code, ("-",) * len(heads), sentence(error), answered=False)
            _tell(output, width, joint, outcome.cells, outcome.verdict)
            for line in outlet.warnings:
                if line not in shared:
                    output.warn(f"{joint}: {line}")
            documents[joint] = {"problem": None if outcome.answered else outcome.verdict, **outlet.document}
            answered |= outcome.answered
        if len(failures) == len(joints) and not any(isinstance(e, UnanswerableError) for e in failures):
            raise failures[0]
        document = {"schema": SCHEMA, "joints": documents}
        if folder is not None:
            (folder / "summary.json").write_text(common.to_json(document) + "\n", encoding="utf-8")
    if args.out:
        output.say(f"written: {args.out}, a folder for each joint, and summary.json")
    output.result(document)
    return 0 if answered else 1


def outcome(summary: Mapping[str, Any], result: "Replay") -> Outcome:
    """Return a replay, or a fit written as one, as a row of the table; `summary` is its JSON."""
    contact = result.contact
    rivals = summary["baselines"] or {}
    frozen, rival = summary["nrmse_frozen"], rivals.get("coulomb_viscous")
    answered = False
    if not np.ptp(result.samples.velocity_m_s):
        verdict = "stands still: the velocity never changes"
    elif contact is not None and not contact.ended:
        verdict = "hardly moves: no two reversals and no 10 s of motion"
    else:
        answered, verdict = True, "estimated"
        if summary["diverged"]:
            verdict = "diverged"
        elif frozen is not None and rival is not None and frozen > NO_BETTER * rival:
            verdict = f"no better than coulomb+viscous ({rival:.4f})"
    cells = (
        str(summary["samples"]["used"]),
        f"{summary['sample_rate_hz']:.5g}",
        figure(summary["nrmse_final"]),
        figure(frozen),
    )
    return Outcome(0, cells, verdict, answered)


def figure(value: float | None) -> str:
    """Return an nrmse as a cell."""
    return "-" if value is None or not np.isfinite(value) else f"{value:.4f}"


def refusal(single: Refusal) -> Refusal:
    """Return what refuses to replace a folder: results of one joint, which `single` knows, or of all joints."""
    several = Layout("summary.json", _MARK, other_folders=single)

    def either(folder: Path) -> str | None:
        return several.refusal(folder) if several.is_of(folder) else single(folder)

    return either


def joints_of(args: argparse.Namespace, warned: Callable[[str], None]) -> list[str]:
    """Return the joints that `all` means: those of `input.joints` in `--config`, else all of the recordings, in order.

    Raises UnanswerableError where a recording has no joints, InputError where the topic is not clear.
    """
    from friction_estimator.bag.joint_survey import joint_names  # noqa: PLC0415 - `--help` needs none of it

    topics = common.topics_from(args)
    named = sorted({"velocity", "friction"} & set(topics))
    if named:
        raise InputError(
            f"--joint all takes velocity and effort from one JointState topic, and --topic {named[0]} names another: "
            "leave one of them out, or name the topic with --topic joint_states=TOPIC"
        )
    config = common.config_from(argparse.Namespace(**{**vars(args), "joint": None}), warned=warned)
    names: dict[str, None] = {}
    for bag in args.bags:
        with progress("looking for joints", unit="messages") as advance:
            names |= dict.fromkeys(joint_names(bag, config.input, topics, advance))
    return list(names)


class _JointOutlet:
    """What a verb says and writes for one joint: files go into the joint's folder, words become rows of the table."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.document: dict[str, Any] = {}
        self.warnings: list[str] = []

    @contextmanager
    def part(self) -> Iterator[Path]:
        """Yield where to build the joint's files."""
        assert self._folder is not None, "a run without --out has no set"
        yield self._folder

    def say(self, text: str = "") -> None:
        """Pass over a line: the table says what comes out."""

    def warn(self, text: str) -> None:
        """Keep a warning."""
        self.warnings.append(text)

    def result(self, value: Any) -> None:
        """Keep the joint's document."""
        self.document = dict(value)


def _tell(output: common.Output, width: int, joint: str, cells: Sequence[str], verdict: str) -> None:
    name = shown(joint, LONGEST_NAME).ljust(width)
    output.say("  ".join([name, *(cell.rjust(_NUMBER_WIDTH) for cell in cells), verdict]))
