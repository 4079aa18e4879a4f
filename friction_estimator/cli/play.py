"""`play`: publish a recording to the live node, where `ros2 bag play` is not installed."""

import argparse
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

from friction_estimator.bag.source import Source
from friction_estimator.cli import common
from friction_estimator.cli.keys import Keys, keys
from friction_estimator.cli.terminal import EXIT_CODES, Parser, draw, guarded, say, stopped_by_signals
from friction_estimator.core.errors import InputError, how_to_install

if TYPE_CHECKING:
    from friction_estimator.ros.player import Player

INTERRUPTED = 130
"""Exit code of a playback that was stopped before its end."""

REDRAW_S = 0.1

FASTER = 1.1
"""A key changes the rate by this factor."""

ROOM = 50
"""Columns for the bar and its numbers; a terminal that has no more beside the names of the keys is not told them."""

KEYS = "space pause, n or right next message, + - rate"


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb."""
    parser = common.add_verb(
        subparsers,
        "play",
        "publish a recording to the live node",
        description="Publish a recording on its topics, reliably: the first message waits for the subscribers, the end "
        "for their acknowledgement. Needs rclpy (a ROS 2 installation, or its wheels). Use `ros2 bag play` where you "
        f"have it: it knows more. Keys on a terminal: {KEYS}. Node and services are named as rosbag2's: "
        "/rosbag2_player/pause and so on.",
        example="friction_estimator play bags/demo --rate 2 --remap /velocity:=/rig/velocity",
    )
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what can be said about a playback."""
    parser.add_argument("bag", metavar="BAG", help="ROS 2 recording: folder, .mcap or .db3 file")
    parser.add_argument("--rate", "-r", type=float, default=1.0, metavar="R", help="speed (default: 1)")
    parser.add_argument("--start-offset", type=float, default=0.0, metavar="S", help="begin S seconds into it")
    parser.add_argument("--duration", type=float, metavar="S", help="play S seconds of it (default: to the end)")
    parser.add_argument("--start-paused", "-p", action="store_true", help="wait for the space key, or for a service")
    parser.add_argument("--disable-keyboard-controls", action="store_true", help="leave the terminal's keys alone")
    parser.add_argument("--quiet", "-q", action="store_true", help="say nothing but failures, no bar, no keys")
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
        raise InputError(
            f"play needs rclpy, which cannot be imported here ({error}); {how_to_install('rclpy')}"
        ) from error
    playback = Playback(
        rate=args.rate,
        start_offset_s=args.start_offset,
        duration_s=args.duration,
        loop=args.loop,
        clock_hz=args.clock,
        remap=_remap(args.remap),
        topics=args.topics,
        wait_s=args.wait,
        start_paused=args.start_paused,
    )
    screen, signalled = Screen(args.quiet), threading.Event()
    pressed = nullcontext() if args.disable_keyboard_controls or args.quiet else keys()
    with Source(args.bag) as source, Player(source, playback, screen.say, ros_arguments) as player:

        def stop() -> None:
            signalled.set()
            player.control.stop()

        with stopped_by_signals(stop), pressed as terminal, screen.showing(player, terminal):
            player.run()
    # A loop has no other end than this.
    return INTERRUPTED if signalled.is_set() and not args.loop else 0


class Screen:
    """The terminal during a playback: a bar with the position in the recording, and its keys; or nothing at all."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._drawn = ""
        self._lock = threading.Lock()

    def say(self, line: str) -> None:
        """Print a line; the bar makes room."""
        if self._quiet:
            return
        with self._lock:
            self._erase()
            say(f"play: {line}", flush=True)

    @contextmanager
    def showing(self, player: "Player", terminal: Keys | None) -> Iterator[None]:
        """Draw the bar and obey the keys for as long as the block lasts; in a pipe there is neither."""
        if self._quiet or (terminal is None and not sys.stderr.isatty()):
            yield
            return
        ended = threading.Event()
        thread = threading.Thread(target=self._serve, args=(player, terminal, ended), daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
            self._erase()

    def _serve(self, player: "Player", terminal: Keys | None, ended: threading.Event) -> None:
        while not ended.is_set():
            if terminal is None:
                ended.wait(REDRAW_S)
            elif key := terminal.read(REDRAW_S):
                obey(key, player)
            if sys.stderr.isatty() and player.control.begun:
                self._draw(player, terminal is not None)

    def _draw(self, player: "Player", with_keys: bool) -> None:
        from tqdm import tqdm  # noqa: PLC0415 - `--help` needs none

        position_s, end_s = player.span_s
        control = player.control
        state = "paused" if control.paused else "playing"
        place = f"{position_s:.{3 if control.paused else 1}f} of {end_s:.1f} s"
        room = shutil.get_terminal_size().columns - 1
        told = f"  [{KEYS}]" if with_keys and room >= len(KEYS) + ROOM else ""
        bar = f"{state} {control.rate:.3g}x {{bar}} {place}{told}"
        line = tqdm.format_meter(position_s, end_s, 0.0, ncols=room, bar_format=bar)
        with self._lock:
            if line != self._drawn:
                draw(line)
                self._drawn = line

    def _erase(self) -> None:
        if self._drawn:
            draw("")
            self._drawn = ""


def obey(key: str, player: "Player") -> None:
    """Do what a key asks of a playback; keys without a meaning do nothing."""
    control = player.control
    if key == " ":
        control.toggle_paused()
    elif key in ("n", "right"):
        control.play_next()
    elif key in ("+", "=", "up"):
        control.set_rate(control.rate * FASTER)
    elif key in ("-", "down"):
        control.set_rate(control.rate / FASTER)


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
