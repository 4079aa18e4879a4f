"""`replay`: the estimator over recordings, as fast as the machine goes, without a ROS graph."""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from friction_estimator.added_terms import added_terms, added_terms_as_met
from friction_estimator.cli import common, joints, loads, side_by_side
from friction_estimator.cli.progress import progress
from friction_estimator.cli.recorded import Described, Session, add_run_options, load, outputs, tell_theory, tell_units
from friction_estimator.core.errors import about
from friction_estimator.core.memory import kept
from friction_estimator.core.model.theory_choice import has_pressure, told
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import Replay, check_answerable, concluded, foreseen, replay
from friction_estimator.core.online.run import Run
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import PARAMETERS, Config

SCHEMA = "friction_estimator/replay/2"


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "replay",
        "the estimator over recordings",
        description="Run the estimator over recordings, one after the other, by the live node's own path and report "
        "the error of its predictions, each made before its measurement was used. Other recordings (--test), or what "
        "comes after --freeze-after, are predicted with what was learned, without learning, and judged beside the "
        "textbook's friction curves fitted to the same samples.",
        example="friction_estimator replay bags/demo --law rls --freeze-after 0.5 --out out\n"
        "  friction_estimator replay monday tuesday --test wednesday\n"
        "  friction_estimator replay wednesday --config out/config.yaml --freeze-after 0",
    )
    add_run_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with kept(), outputs(args) as output:
        return joints.run(args, output, joints.HEADS, _run)


def _run(args: argparse.Namespace, output: common.Outlet) -> joints.Outcome:
    # What part of a record is its first fraction, nobody knows before its end.
    learner = Learner(bool(args.out)) if args.freeze_after is None else None
    session = load(args, output, {"model.type": args.model, "model.law": args.law}, learner)
    with about(", ".join(session.bags)):
        result = (learner and learner.result(session)) or _replayed(args, session)
    tell_units(output, session.quantities, session.config, result.estimator.config)
    tell_theory(output, result.estimator.config, session.samples)
    result = judged(session, result)
    summary = summarise(session, result, SCHEMA)
    _tell(output, summary)
    loads.tell(output, result.loads, session.quantities)
    _warn_of_contact(output, result)
    side_by_side.tell(output, result, session.quantities)
    if args.out:
        # Drawing and HTML are loaded only where they are asked for.
        from friction_estimator.cli.results import write_results  # noqa: PLC0415

        with output.part() as folder:
            write_results(folder, session.recordings, result, summary, session.quantities, args.words, args.figures)
        output.say(f"{'written':<12}{args.out}: bag/, figures/, report.html, summary.json, config.yaml")
    output.result(summary)
    return joints.outcome(summary, result)


def _replayed(args: argparse.Namespace, session: Session) -> Replay:
    with progress("replaying", len(session.samples)) as advance:
        return replay(
            session.samples,
            session.config,
            extension=added_terms_as_met(session.config, session.samples),
            freeze_after=args.freeze_after,
            starts=session.starts,
            deviation=bool(args.out),
            advance=advance,
        )


class Learner:
    """Learns recordings while they are read; what goes wrong here waits until all is read."""

    def __init__(self, deviation: bool) -> None:
        self._deviation = deviation
        self._run: Run | None = None
        self._given_up = False
        self._problem: Exception | None = None
        self._figures: RecordFigures | None = None

    def begin(self, config: Config) -> None:
        """Take the begin of a recording."""
        if config.extension.terms:  # they are built of the first contact
            self.give_up()
        self._do(lambda: self._begin(config))

    def _begin(self, config: Config) -> None:
        self._run = self._run or Run(config, deviation=self._deviation)
        self._run.begin()

    def push(self, samples: Samples) -> None:
        """Take the next samples of it."""
        run = self._run
        self._do(lambda: run.push(samples) if run else None)

    def foresee(self, samples: Samples) -> Iterator[None]:
        """Form the figures of samples that are all read, a step at a time, while some are still learned."""
        try:
            figures = foreseen(self._run, [samples]) if self._run else None
            yield from figures.formed() if figures else ()
        except Exception:  # raised where they are asked for: what else is wrong comes before
            return
        self._figures = figures

    def give_up(self) -> None:
        """Let go of all that was learned; nothing more is."""
        self._run, self._given_up = None, True

    def _do(self, work: Callable[[], None]) -> None:
        if self._given_up or self._problem is not None:
            return
        try:
            work()
        except Exception as error:
            self._problem = error

    def result(self, session: Session) -> Replay | None:
        """Return what was learned of a session that is read; None where it was given up. Raises as `replay`."""
        if self._given_up:
            return None
        check_answerable(session.samples, session.config.quantities)
        if self._problem is not None:
            raise self._problem
        assert self._run is not None
        heard = {name: PARAMETERS[name].of(session.config) for name in ("input.mode", "input.joint")}
        return concluded(self._run, session.samples, heard, self._figures)


def judged(session: Session, result: Replay) -> Replay:
    """Return the replay with the other recordings of the session predicted by what was learned.

    Raises UnanswerableError where a recording cannot judge.
    """
    with progress("judging", sum(len(other.samples) for other in session.others)) as advance:
        others = []
        for other in session.others:
            extension = added_terms(result.config)
            others.append(result.judge(other.bags[0], other.samples, extension))
            advance(len(other.samples))
    return replace(result, others=tuple(others))


def summarise(loaded: Described, result: Replay, schema: str) -> dict[str, Any]:
    """Return the JSON of a replay."""
    config = result.config
    return {
        "schema": schema,
        "bags": loaded.bags,
        "model": config.structure,
        "theory": told(config, has_pressure(result.samples)),
        "law": config.model.law,
        "samples": loaded.counts(),
        **result.figures(),
        "health": result.health,
    }


def _warn_of_contact(output: common.Outlet, result: Replay) -> None:
    """Say where a live node would have behaved otherwise: it waits for a first contact that the recording lacks."""
    contact = result.contact
    if contact is None:
        return
    if not contact.ended:
        output.warn(
            "the recording ends before two reversals or 10 s of motion: range and units are those of what there is, "
            "and a live node would still wait; set basis.velocity_range and force_unit"
        )
    if contact.dropped:
        output.warn(f"{contact.dropped} samples came before the first contact and were let go: they are not predicted")


def _tell(output: common.Outlet, summary: dict[str, Any]) -> None:
    figures = [
        ("nrmse", summary["nrmse"], "a priori error over the std of friction, whole record"),
        ("final", summary["nrmse_final"], "last fifth"),
        ("frozen", summary["nrmse_frozen"], "without learning, after --freeze-after"),
        ("persistence", summary["nrmse_persistence"], "the guess f[k-1], to read the others beside"),
        ("theory", summary["theory_nrmse"], "the theoretical curve alone"),
    ]
    for name, value, meaning in figures:
        if value is not None:
            output.say(f"{name:<12}{value:.4f}  {meaning}")
    if summary["diverged"]:
        output.warn("the estimator diverged: lower the step size, or use --law rls")
    health = summary["health"]
    if health.outside:
        output.warn(
            f"{health.outside} samples lie outside the velocities learned: they were predicted, not learned from"
        )
