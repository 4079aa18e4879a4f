"""`watch`: what a running node predicts, as a page on this machine or as a screen of text."""

import argparse
import sys
import threading
from typing import TYPE_CHECKING

from friction_estimator.cli import common
from friction_estimator.cli.terminal import say, stopped_by_signals
from friction_estimator.core.errors import InputError, how_to_install

if TYPE_CHECKING:
    from friction_estimator.ros.monitor_feed import MonitorFeed

PORT = 5007


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb."""
    parser = common.add_verb(
        subparsers,
        "watch",
        "a live page on this machine, or a screen of text, beside a running node",
        description="Show what a running node measures, predicts and has learned. The page is served on 127.0.0.1 "
        f"only (over ssh: `ssh -L {PORT}:127.0.0.1:{PORT} rig`); --terminal draws it as text. The node publishes for "
        "it only while somebody looks, and neither ends the other. Ends with Ctrl-C. Needs rclpy, and bokeh for the "
        "page or rich for the text.",
        example="friction_estimator watch\n  friction_estimator watch --terminal --node /left/friction_estimator",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--port", type=int, default=PORT, metavar="N", help=f"port of the page (default: {PORT}; 0: any that is free)"
    )
    where.add_argument("--terminal", action="store_true", help="draw on the terminal instead")
    parser.add_argument(
        "--node",
        default="friction_estimator",
        metavar="NAME",
        help="the node, with its namespace (default: %(default)s)",
    )
    parser.add_argument("--joint", default="", metavar="NAME", help="one of several joints of the node")


def run(args: argparse.Namespace) -> int:
    """Serve the page, or draw, until a signal ends it; return the exit code."""
    if not 0 <= args.port < 65536:
        raise InputError(f"--port {args.port}: give 1 to 65535, or 0 for any that is free")
    try:
        from friction_estimator.ros.monitor_feed import MonitorFeed  # noqa: PLC0415 - needs ROS
    except ImportError as error:
        raise InputError(
            f"watch needs rclpy, which cannot be imported here ({error}); {how_to_install('rclpy')}"
        ) from error
    ended = threading.Event()
    # Until all is closed: a second Ctrl-C must not tear threads of the middleware apart.
    with stopped_by_signals(ended.set), MonitorFeed(args.node, args.joint) as feed:
        if args.terminal:
            _screen(feed, ended)
        else:
            _page(feed, args.port, ended)
    return 0


def _page(feed: "MonitorFeed", port: int, ended: threading.Event) -> None:
    try:
        from friction_estimator.report.live.page import LivePage  # noqa: PLC0415 - bokeh takes a second
    except ImportError as error:
        raise InputError(
            f"the page needs bokeh, which cannot be imported here ({error}); {how_to_install('bokeh')}, "
            "or use --terminal"
        ) from error
    with LivePage(feed.look, feed.topic, port) as page:
        say(f"watch: {page.address} shows {feed.topic}; Ctrl-C ends", flush=True)
        page.serve_until(ended.is_set)


def _screen(feed: "MonitorFeed", ended: threading.Event) -> None:
    try:
        from friction_estimator.report.live.screen import draw_screen  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            f"--terminal needs rich, which cannot be imported here ({error}); {how_to_install('rich')}"
        ) from error
    if sys.stdout is None or not sys.stdout.isatty():
        raise InputError("--terminal draws on a terminal, and stdout is none; leave the pipe away")
    draw_screen(feed.look, feed.topic, ended)
