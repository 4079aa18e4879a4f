"""`play`: publish a recording to the live node, where `ros2 bag play` is not installed."""

import argparse
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from friction_estimator.bag.source import Source
from friction_estimator.cli import common
from friction_estimator.cli.terminal import EXIT_CODES, Parser, guarded, say
from friction_estimator.core.errors import InputError

INTERRUPTED = 130
"""Exit code of a playback that was stopped before its end."""


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb."""
    parser = common.add_verb(
        subparsers,
        "play",
        "publish a recording to the live node",
        description="Publish a recording on its topics, reliably: the first message waits for the subscribers, the end "
        "for their acknowledgement. Needs rclpy (a ROS 2 installation, or its wheels).",
        example="friction_estimator play bags/demo --rate 2 --remap /velocity:=/rig/velocity",
    )
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what can be said about a playback."""
    parser.add_argument("bag", metavar="BAG", help="ROS 2 recording: folder, .mcap or .db3 file")
    parser.add_argument("--rate", "-r", type=float, default=1.0, metavar="R", help="speed (default: 1)")
    parser.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="begin S seconds into it")
    parser.add_argument("--duration", type=float, metavar="S", help="play S seconds of it (default: to the end)")
    parser.add_argument("--loop", "-l", action="store_true", help="begin again at the end, until stopped")
    parser.add_argument(
        "--clock", type=float, nargs="?", const=40.0, default=0.0, metavar="HZ", help="publish /clock (40 Hz if no HZ)"
    )
    parser.add_argument(
        "--remap", "-m", action="append", default=[], metavar="FROM:=TO", help="another topic name; may be repeated"
    )
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to play (default: all)")
    parser.add_argument(
        "--wait",
        type=float,
        default=30.0,
        metavar="S",
        help="longest wait for a subscriber (default: 30); 0 plays to nobody too",
    )


def run(args: argparse.Namespace, ros_arguments: tuple[str, ...] = ()) -> int:
    """Play the recording; return the exit code."""
    try:
        from friction_estimator.ros.player import Playback, Player  # noqa: PLC0415 - needs ROS, the other verbs do not
    except ImportError as error:
        raise InputError(f"play needs rclpy, which cannot be imported here ({error}); source a ROS 2 setup") from error
    playback = Playback(
        rate=args.rate,
        start_offset_s=args.start_offset,
        duration_s=args.duration,
        loop=args.loop,
        clock_hz=args.clock,
        remap=_remap(args.remap),
        topics=args.topics,
        wait_s=args.wait,
    )

    def tell(line: str) -> None:
        say(f"play: {line}", flush=True)

    with Source(args.bag) as source, Player(source, playback, tell, ros_arguments) as player:
        with _stopped_by_signals(player.stop):
            player.run()
        # A loop has no other end than this.
        return INTERRUPTED if player.stopped and not args.loop else 0


@contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Turn SIGINT and SIGTERM into a call of `stop` for as long as the block lasts."""
    before = {number: signal.signal(number, lambda *_: stop()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _remap(rules: list[str]) -> dict[str, str]:
    remap = {}
    for rule in rules:
        old, arrow, new = rule.partition(":=")
        if not arrow or not old or not new:
            raise InputError(f"--remap {rule}: write FROM:=TO, for instance --remap /velocity:=/rig/velocity")
        remap[old] = new
    return remap


def main(argv: list[str] | None = None) -> int:
    """Play as `ros2 run friction_estimator player BAG ... [--ros-args ...]`."""
    words: list[Any] = list(sys.argv[1:] if argv is None else argv)
    split = words.index("--ros-args") if "--ros-args" in words else len(words)
    parser = Parser(prog="player", description=__doc__, epilog=EXIT_CODES)
    add_options(parser)
    args = parser.parse_args(words[:split])
    return guarded("player", lambda: run(args, tuple(words[split:])), words[:split])


if __name__ == "__main__":
    sys.exit(main())
