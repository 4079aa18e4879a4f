"""`make demo`: the live node beside a replayed recording, in processes of their own, over DDS."""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.cli import common
from friction_estimator.cli.recorded import Loaded
from friction_estimator.cli.replay import SCHEMA, summarise
from friction_estimator.cli.results import RESULTS, write_results
from friction_estimator.cli.terminal import Parser, guarded, say
from friction_estimator.core.errors import FrictionEstimatorError
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.ros.listener import Listener

LIMIT_S = 300.0
"""Longest wait for a process to start, to finish a message, or to end: the first start compiles, which takes a
busy machine minutes. A process that has ended is noticed at once."""

RELIABLE = [
    word
    for topic in ("velocity", "friction")
    for word in ("-p", f"qos_overrides./{topic}.subscription.reliability:=reliable")
]

QUIET = ("--log-level", "friction_estimator:=error")
"""That nobody publishes yet, or any more, is no news here."""

STRANGE_DOMAINS = range(40, 100)


Process: TypeAlias = "subprocess.Popen[bytes]"


class DemonstrationError(FrictionEstimatorError):
    """The demonstration did not run to its end."""

    exit_code = 1


def main() -> int:
    """Run the demonstration; return the exit code."""
    parser = Parser(prog="friction_estimator.cli.demo", description=__doc__)
    parser.add_argument("--bag", default="bags/demo", help="recording to play (default: bags/demo)")
    parser.add_argument("--out", default="demo_out", help="folder for the results (default: demo_out)")
    parser.add_argument("--rate", type=float, default=1.0, help="play this many times faster (default: 1)")
    args = parser.parse_args()
    return guarded("demo", lambda: demonstrate(args), sys.argv)


def demonstrate(args: argparse.Namespace) -> int:
    """Play the recording to the live node, collect its predictions, write the results."""
    with common.Output(None, args.out, RESULTS.refusal, [args.bag]) as output:
        return _demonstrate(args, output)


def _demonstrate(args: argparse.Namespace, output: common.Output) -> int:
    out = args.out
    recording = read_recording(args.bag)
    admitted = to_samples(recording, Config())
    samples = admitted.samples
    config = Config()  # none at all: the first samples say what the node has to know
    with tempfile.TemporaryDirectory(prefix="friction_estimator-demo-") as folder:
        # A domain of its own: a running robot must not hear the demonstration, nor be heard in it.
        os.environ["ROS_DOMAIN_ID"] = str(STRANGE_DOMAINS[os.getpid() % len(STRANGE_DOMAINS)])
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ.setdefault("ROS_LOG_DIR", str(Path(folder) / "log"))
        node = [sys.executable, "-m", "friction_estimator.ros.node", "--ros-args", *QUIET, *RELIABLE]
        play = [sys.executable, "-m", "friction_estimator", "play", "--quiet", args.bag, "--rate", str(args.rate)]
        say(f"live node   {config.structure} model, law {config.model.law}")
        say(f"recording   {args.bag}: {len(samples)} samples in {samples.time_s[-1]:.1f} s, played at {args.rate:g}x")
        domain = f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        say(f"watch it    {domain} {Path(sys.executable).with_name('friction_estimator')} watch", flush=True)
        with Listener() as listener, _child(node) as live:
            _wait(listener, listener.connected, live, "the node did not appear")
            with _child(play) as player:
                _follow(listener, live, player, samples)
            _wait(
                listener,
                lambda: len(listener.predicted) >= len(samples) and len(listener.residual) >= len(samples),
                live,
                f"the node predicted {len(listener.predicted)} of {len(samples)} samples",
            )
    predicted = np.array([listener.predicted.get(int(stamp), np.nan) for stamp in samples.stamp_ns])
    offline = replay(samples, config)
    live_result = replace(offline, predicted_N=predicted)
    equal = bool(np.array_equal(predicted, offline.predicted_N))
    summary = summarise(Loaded(recording, admitted, config), live_result, SCHEMA) | {
        "predictions": len(listener.predicted),
        "live_equals_replay": equal,
    }
    with output.part() as part:
        write_results(
            part, recording, live_result, summary, words=["python", "-m", "friction_estimator.cli.demo", *sys.argv[1:]]
        )
    say(f"predictions {summary['predictions']} of {len(samples)} samples, all received over DDS")
    say(f"replay      {'gives the same predictions bit for bit' if equal else 'DIFFERS from the live node'}")
    say(f"final nrmse {summary['nrmse_final']:.4f}  (the guess f[k-1]: {summary['nrmse_persistence']:.4f})")
    say(f"written     {out}/report.html, {out}/summary.json, {out}/figures/, {out}/bag/, {out}/config.yaml")
    return 0 if equal else 1


def _follow(listener: Listener, live: Process, player: Process, samples: Samples) -> None:
    """Print the running error about once a second until the player ends."""
    shown, last = 0, time.monotonic()

    def tick() -> bool:
        nonlocal shown, last
        _alive(live)
        if time.monotonic() - last >= 1.0:
            last = time.monotonic()
            stamps = np.array(list(listener.predicted)[shown:], np.int64)
            predicted = np.array(list(listener.predicted.values())[shown:])
            if stamps.size > 1:
                measured = samples.friction_N[np.searchsorted(samples.stamp_ns, stamps)]
                shown += stamps.size
                error = nrmse(measured, predicted)
                say(f"  {shown:>7} predictions   nrmse of the last second {error:.4f}", flush=True)
        return player.poll() is not None

    listener.serve_until(tick)
    if player.returncode:
        raise DemonstrationError(f"the player ended with code {player.returncode}")


def _wait(listener: Listener, condition: Callable[[], bool], live: Process, complaint: str) -> None:
    limit = time.monotonic() + LIMIT_S

    def met() -> bool:
        _alive(live)
        if time.monotonic() > limit:
            raise DemonstrationError(f"{complaint} within {LIMIT_S:.0f} s")
        return condition()

    listener.serve_until(met)


def _alive(live: Process) -> None:
    if live.poll() is not None:
        raise DemonstrationError(f"the node ended with code {live.returncode}")


@contextmanager
def _child(command: list[str]) -> Iterator[Process]:
    """Run a process; stop it with SIGINT when the block ends, whatever happened."""
    process = subprocess.Popen(command)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


if __name__ == "__main__":
    sys.exit(main())
