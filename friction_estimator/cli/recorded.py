"""Read recordings for a verb: options, configuration, samples, and what must be said about them."""

import argparse
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, Protocol, TypeVar

from friction_estimator.bag.ahead import ahead
from friction_estimator.bag.recording import Recorded
from friction_estimator.bag.samples import Admitted, Begins, Piece, Read, read_samples, sample_pieces
from friction_estimator.cli import common, joints
from friction_estimator.cli.progress import Advance, progress
from friction_estimator.core.errors import InputError, about
from friction_estimator.core.model.theory_choice import has_pressure, told, warning
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Samples, joined
from friction_estimator.core.settings.config import PARAMETERS, Config

Item = TypeVar("Item")


class Described(Protocol):
    """What the JSON of a run says about its recordings."""

    @property
    def bags(self) -> list[str]:
        """Their paths, in order."""

    def counts(self) -> dict[str, Any]:
        """Return `samples` of the JSON: read, used and rejected by reason."""


def counted(admitted: Sequence[Admitted]) -> dict[str, Any]:
    """Return `samples` of the JSON over recordings: read, used and rejected by reason."""
    rejected: Counter[str] = Counter()
    for one in admitted:
        rejected.update(one.rejected)
    used = sum(len(one.samples) for one in admitted)
    return {"read": sum(one.read for one in admitted), "used": used, "rejected": dict(rejected)}


@dataclass(frozen=True)
class Loaded:
    """A recording, its admitted samples and the configuration."""

    recording: Recorded
    admitted: Admitted
    config: Config

    @property
    def samples(self) -> Samples:
        """The usable samples."""
        return self.admitted.samples

    @property
    def bags(self) -> list[str]:
        """The recording's path."""
        return [str(self.recording.path)]

    def counts(self) -> dict[str, Any]:
        """Return `samples` of the JSON: read, used and rejected by reason."""
        return counted([self.admitted])


@dataclass(frozen=True)
class Session:
    """Recordings that are learned in order, and others to judge by; one configuration for all.

    Attributes
    ----------
    learned : the recordings to learn, at least one.
    others : the recordings of `--test`.
    config : as given; range and units may be open.
    quantities : what the drive's numbers are, shown in the units of `--units`.
    """

    learned: tuple[Loaded, ...]
    others: tuple[Loaded, ...]
    config: Config
    quantities: Quantities

    @cached_property
    def samples(self) -> Samples:
        """The samples to learn, each recording admitted on its own; the delay lines restart at each."""
        return joined([loaded.samples for loaded in self.learned])

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the first sample of each recording in `samples`."""
        return tuple(accumulate((len(loaded.samples) for loaded in self.learned[:-1]), initial=0))

    @property
    def recordings(self) -> list[Recorded]:
        """The recordings to learn."""
        return [loaded.recording for loaded in self.learned]

    @property
    def bags(self) -> list[str]:
        """Paths of the recordings to learn."""
        return [str(recording.path) for recording in self.recordings]

    def counts(self) -> dict[str, Any]:
        """Return `samples` of the JSON over the recordings to learn: read, used and rejected by reason."""
        return counted([loaded.admitted for loaded in self.learned])


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the recordings, `--test`, `--model`, `--law`, `--freeze-after`, `--out`, options of reading and of JSON."""
    parser.add_argument(
        "bags",
        nargs="+",
        metavar="BAG",
        help="recording: ROS 2 folder, .mcap or .db3 file, or ROS 1 .bag; several are learned in this order",
    )
    parser.add_argument(
        "--test",
        nargs="+",
        action="extend",
        default=[],
        metavar="BAG",
        help="other recordings, to be predicted with what was learned, without learning; give them after BAG",
    )
    parser.add_argument("--model", choices=PARAMETERS["model.type"].choices, help="model structure (default: parallel)")
    parser.add_argument("--law", choices=PARAMETERS["model.law"].choices, help="adaptation law (default: rls)")
    parser.add_argument(
        "--freeze-after",
        type=float,
        metavar="FRACTION",
        help="learn from this first fraction of the samples only, and score the rest without learning",
    )
    parser.add_argument("--out", metavar="DIR", help="write bag/, figures/, report.html, summary.json, config.yaml")
    common.add_figures_option(parser)
    common.add_bag_options(parser)
    common.add_json_option(parser)


def outputs(args: argparse.Namespace) -> common.Output:
    """Return where a verb with these options writes; enter it before anything is read."""
    refusal = None
    if args.out:
        from friction_estimator.cli.results import RESULTS  # noqa: PLC0415 - drawing is loaded where asked for

        refusal = joints.refusal(RESULTS.refusal)
    return common.Output(args.json, args.out, refusal, common.paths_read(args))


class Learner(Protocol):
    """Learns recordings while they are read."""

    def begin(self, config: Config) -> None:
        """Take the begin of a recording, and the configuration with what it says of the motion."""

    def push(self, samples: Samples) -> None:
        """Take the next samples of it."""

    def foresee(self, samples: Samples) -> Iterator[None]:
        """Form what can be said of all samples while some wait to be learned, a step at a time; in another thread."""

    def give_up(self) -> None:
        """Let go of all that was learned: the recording was not as it said."""


def load(
    args: argparse.Namespace,
    output: common.Outlet,
    overrides: Mapping[str, object] | None = None,
    learner: Learner | None = None,
) -> Session:
    """Read `args.bags` and `args.test`, pair and admit their messages; say what was done and refused.

    `learner` is given the samples of `args.bags` while others are read.

    Raises InputError and UnanswerableError as reading does; both name the recording.
    """
    config = common.config_from(args, overrides, output.warn)
    several = len(args.bags) + len(args.test) > 1
    learned = [_read(bag, args, config, output, "learned" if several else "", learner) for bag in args.bags]
    others = [_read(bag, args, config, output, "test") for bag in args.test]
    config = settled(config, [recording for recording, _ in (*learned, *others)]).updated(_live_input(learned[0][0]))
    quantities = common.quantities_from(args, config)
    return Session(_with(learned, config), _with(others, config), config, quantities)


def settled(config: Config, recordings: Sequence[Recorded]) -> Config:
    """Return the configuration with what the recordings say of `input.motion`.

    Raises InputError where one is linear and another rotary.
    """
    first = recordings[0]
    for other in recordings[1:]:
        if other.motion != first.motion:
            raise InputError(
                f"{first.path} is {first.motion} and {other.path} {other.motion}: they are not of one drive; "
                "leave one out, or set input.motion where that is a mistake"
            )
    return config.updated({"input.motion": first.motion})


def tell_units(output: common.Outlet, quantities: Quantities, given: Config, used: Config) -> None:
    """Say which range and units were chosen where they were open: `given` as configured, `used` at the end."""
    for name in ("learned.velocity_range", "learned.force_unit"):
        value = PARAMETERS[name].of(used)
        if value != PARAMETERS[name].of(given):
            unit = PARAMETERS[name].unit
            ends = [float(end) for end in (value if isinstance(value, tuple) else [value])]
            shown = quantities.range_text(ends, unit, ".5g") if ends[1:] else quantities.text(ends[0], unit, ".5g")
            output.say(f"{'chosen':<12}{name} = {shown}")


def tell_theory(output: common.Outlet, config: Config, samples: Samples) -> None:
    """Say which theoretical curve is used and why, and warn where these samples would have chosen another."""
    pressure = has_pressure(samples)
    output.say(f"{'theory':<12}{told(config, pressure)}")
    if text := warning(config, pressure):
        output.warn(text)


def _with(read: Sequence[tuple[Recorded, Admitted]], config: Config) -> tuple[Loaded, ...]:
    return tuple(Loaded(recording, admitted, config) for recording, admitted in read)


def _read(
    bag: str,
    args: argparse.Namespace,
    config: Config,
    output: common.Outlet,
    heading: str,
    learner: Learner | None = None,
) -> tuple[Recorded, Admitted]:
    """Read one recording; say what it holds, under its name where `heading` says what it is for."""
    topics = common.topics_from(args)
    with about(bag), progress("replaying" if learner else "reading", unit="messages") as advance:
        if learner is None:
            recording, admitted = read_samples(bag, config, topics, advance)
        else:
            alone = len(args.bags) == 1
            recording, admitted = _read_and_learned(bag, config, topics, advance, learner, alone)
    if heading:
        output.say(f"{heading:<12}{recording.path}")
    for name, stream in recording.streams.items():
        joint = f", joint {stream.joint}" if stream.joint else ""
        output.say(
            f"{name:<12}{stream.topic} ({stream.message_type.replace('/msg/', '/')}{joint}), {len(stream)} messages"
        )
    if admitted.tracker is not None:
        output.say(
            f"{'velocity':<12}from the position: {admitted.tracker.words(Quantities(recording.motion).position)}"
        )
    for note in recording.notes:
        output.say(f"note: {note}")
    refused = ", ".join(f"{count} {reason}" for reason, count in admitted.rejected.items())
    output.say(
        f"{'samples':<12}{len(admitted.samples)} used of {admitted.read}"
        + (f", refused: {refused}" if refused else "")
        + (f"; {admitted.gaps} gaps" if admitted.gaps else "")
        + (f"; {admitted.jumps} backward jumps of the clock" if admitted.jumps else "")
    )
    return recording, admitted


def _read_and_learned(
    bag: str,
    config: Config,
    topics: Mapping[str, str],
    advance: Advance,
    learner: Learner,
    alone: bool,
) -> tuple[Recorded, Admitted]:
    """Return what was read; it is learned while what follows is read.

    `alone` : whether it is all that is learned, so that its figures can be formed when it is read.
    """
    counts: list[tuple[int, int]] = []
    pieces = sample_pieces(bag, config, topics, lambda done, total: counts.append((done, total)))
    begun = False
    with ahead(_with_counts(_then(pieces, learner.foresee) if alone else pieces, counts)) as items:
        for item, read in items:
            if isinstance(item, Piece):
                learner.push(item.samples())
            elif isinstance(item, Read):
                found = item
            elif isinstance(item, Begins) and begun:
                learner.give_up()
            elif isinstance(item, Begins):
                learner.begin(config.updated({"input.motion": item.motion}))
                begun = True
            for done, total in read:  # not before they are learned
                advance(done, total)
    return found.recording, found.admitted


def _then(
    pieces: Generator[Item, None, None], work: Callable[[Samples], Iterator[None]]
) -> Generator[Item | None, None, None]:
    """Yield the pieces of a recording, then None for each step of what is done with all of it."""
    with closing(pieces):
        for item in pieces:
            yield item
    if isinstance(item, Read):
        yield from work(item.admitted.samples)


def _with_counts(
    items: Generator[Item, None, None], counts: list[tuple[int, int]]
) -> Generator[tuple[Item, list[tuple[int, int]]], None, None]:
    """Yield each item with the counts that came before it."""
    with closing(items):
        for item in items:
            taken = counts.copy()
            counts.clear()
            yield item, taken


def _live_input(recording: Recorded) -> dict[str, object]:
    """Return the settings by which the live node takes the same inputs; config.yaml is written for it."""
    streams = recording.streams
    velocity, friction = streams.get("velocity") or streams["position"], streams["friction"]
    if velocity.topic == friction.topic and velocity.joint:
        return {"input.mode": "joint_state", "input.joint": velocity.joint}
    if velocity.message_type == friction.message_type == "std_msgs/msg/Float64":
        return {"input.mode": "float64"}
    return {}
