"""Six joints of one JointState topic: one node for all of them beside a node for each, in turns.

    python joints.py [--seconds 20] [--rate 1000] [--rounds 3] [--joints 6]

CPU is that of the node processes, from the first message to the last prediction; both take the same messages.
Loss is looked for twice: every node counts its predictions and, by the rhythm of the stamps, messages that never came;
and in one more run another process hears all predictions of the one node and compares their stamps with those sent.
"""

import argparse
import contextlib
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from common import write_section
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.serialization import serialize_message
from ros_graph import NS, Graph, Process, await_, force, graph, motion, qos
from sensor_msgs.msg import JointState
from tables import table

from friction_estimator.bag.joint_arrays import JointArrays
from friction_estimator.bag.layout import Cursor

NODE = "/friction_estimator"
DEPTH = 100_000
MATCHED_S = 3.0
"""The node knows its hearer a moment after the hearer knows the node."""
REMAP = ("-r", "joint_states:=/joint_states")


def names_of(count: int) -> list[str]:
    return [f"joint{number}" for number in range(count)]


class Robot:
    """Publishes the states of all joints at a steady rate, each with a motion of its own.

    Messages are serialised before the first is sent: what is measured is who takes them.
    """

    def __init__(self, made: Graph, joints: list[str], rate_hz: float, seconds: float) -> None:
        self._publisher = made.publisher(JointState, "/joint_states", depth=5000)
        self._made, self._rate_hz = made, rate_hz
        zeros = [0.0] * len(joints)
        template = bytes(serialize_message(JointState(name=joints, position=zeros, velocity=zeros, effort=zeros)))
        arrays = JointArrays.walk(Cursor(template))
        moves = [motion(round(rate_hz * seconds), rate_hz, seed) for seed in range(len(joints))]
        self.stamps = moves[0][0]
        table = np.tile(np.frombuffer(template, np.uint8), (self.stamps.size, 1))
        seconds_ns = np.stack(np.divmod(self.stamps, NS), 1).astype("<u4")
        table[:, 4:12] = seconds_ns.view(np.uint8)
        for quantity, part in (("velocity", 1), ("friction", 2)):
            values = np.stack([move[part] for move in moves], 1).astype("<f8")
            start = arrays.starts[quantity]
            table[:, start : start + 8 * len(joints)] = values.view(np.uint8)
        self._messages = [row.tobytes() for row in table]

    def run(self, readers: int) -> float:
        """Publish everything to this many readers; return the time it took, s."""
        self._made.matched("/joint_states", count=readers)
        time.sleep(1.0)  # let discovery calm down: it is not what is measured
        start, step = time.perf_counter_ns(), NS / self._rate_hz
        for k, message in enumerate(self._messages):
            while (wait := start + k * step - time.perf_counter_ns()) > 0:
                time.sleep(wait * 1e-9)
            self._publisher.publish(message)
        return (time.perf_counter_ns() - start) * 1e-9


class Counters:
    """What the nodes say in /diagnostics: by node, by status, by key."""

    def __init__(self, made: Graph) -> None:
        self._seen: dict[tuple[str, str], dict[str, str]] = {}
        made.probe.create_subscription(DiagnosticArray, "/diagnostics", self._look, 100)

    def _look(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._seen[status.hardware_id, status.name] = {pair.key: pair.value for pair in status.values}

    def total(self, key: str) -> int:
        return sum(int(values[key]) for values in list(self._seen.values()) if key in values)

    def settled(self, expected: int) -> dict[str, int]:
        """Return the counts once all predictions are there, or after a while without change."""
        with contextlib.suppress(AssertionError):
            await_(lambda: self.total("predictions") >= expected, "all predictions", 10.0)
        return {
            "predictions": self.total("predictions"),
            "missing": self.total("joint_states: messages missing"),
            "lost": self.total("samples lost") + self.total("samples dropped, too slow"),
        }


@contextlib.contextmanager
def nodes(made: Graph, joints: list[str], together: bool) -> Iterator[list[Process]]:
    """Run one node for all joints, or one for each."""
    mode = {"input.mode": "joint_state"}
    if together:
        running = [made.start_node({**mode, "input.joints": joints}, deep=False)]
    else:
        running = [
            made.start_node({**mode, "input.joint": joint}, namespace=f"/{joint}", arguments=REMAP, deep=False)
            for joint in joints
        ]
    try:
        yield running
    finally:
        for process in running:
            process.stop()


def turn(joints: list[str], rate_hz: float, seconds: float, together: bool) -> dict[str, Any]:
    """Load one variant; return CPU and counts."""
    with graph(Path(tempfile.mkdtemp())) as made, nodes(made, joints, together) as running:
        robot, counters = Robot(made, joints, rate_hz, seconds), Counters(made)
        cpu = sum(process.cpu_s() for process in running)
        took = robot.run(len(running))
        found = counters.settled(robot.stamps.size * len(joints))
        cpu = sum(process.cpu_s() for process in running) - cpu
    return {**found, "cpu_s": cpu, "took_s": took, "sent": robot.stamps.size}


def heard_stamps(joints: list[str], rate_hz: float, seconds: float) -> list[str]:
    """Return how many of the stamps sent are missing among each joint's predictions, as another process hears them."""
    with graph(Path(tempfile.mkdtemp())) as made, nodes(made, joints, together=True):
        listener = made.start(__file__, "--listen", str(made.folder / "heard.npz"), "--joints", str(len(joints)))
        listener.says("hearing")
        robot = Robot(made, joints, rate_hz, seconds)
        robot.run(1)
        counters = Counters(made)
        counters.settled(robot.stamps.size * len(joints))
        listener.stop()
        heard = np.load(made.folder / "heard.npz")
        missed = [np.flatnonzero(~np.isin(robot.stamps, heard[joint])) for joint in joints]
        return [f"{each.size} ({each[0]} to {each[-1]})" if each.size else "0" for each in missed]


def listen(file: Path, joints: list[str]) -> None:
    """Hear the predictions of all joints until SIGINT; write their stamps."""
    stopping: list[bool] = []
    rclpy.init(args=[])
    node = rclpy.create_node("listener")
    heard: dict[str, list[bytes]] = {joint: [] for joint in joints}
    hearing = qos(True, DEPTH)
    subscriptions = [
        node.create_subscription(WrenchStamped, f"{NODE}/{joint}/friction_predicted", box.append, hearing, raw=True)
        for joint, box in heard.items()
    ]
    signal.signal(signal.SIGINT, lambda *_: stopping.append(True))
    executor = EventsExecutor()
    executor.add_node(node)
    await_(lambda: all(each.get_publisher_count() for each in subscriptions), "publishers")
    time.sleep(MATCHED_S)
    print("hearing", flush=True)
    while not stopping:
        executor.spin_once(timeout_sec=0.1)
    for _ in range(20):
        executor.spin_once(timeout_sec=0.01)
    np.savez(file, **{joint: np.array([force(raw)[0] for raw in box], np.int64) for joint, box in heard.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--joints", type=int, default=6)
    parser.add_argument("--listen", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    joints = names_of(args.joints)
    if args.listen:
        listen(args.listen, joints)
        return
    lines, cpu = [], {True: 0.0, False: 0.0}
    for number in range(1, args.rounds + 1):
        for together in (True, False) if number % 2 else (False, True):
            found = turn(joints, args.rate, args.seconds, together)
            cpu[together] += found["cpu_s"]
            wanted = found["sent"] * len(joints)
            lines.append(
                [
                    number,
                    "one node" if together else f"{len(joints)} nodes",
                    f"{found['sent'] / found['took_s']:.0f}",
                    found["sent"],
                    wanted - found["predictions"],
                    found["missing"],
                    found["lost"],
                    f"{found['cpu_s']:.2f}",
                    f"{found['cpu_s'] / wanted * 1e6:.0f}",
                ]
            )
            print(lines[-1], flush=True)
    missing = heard_stamps(joints, args.rate, args.seconds)
    header = ["round", "variant", "rate (Hz)", "messages", "predictions missing", "messages missing", "samples lost",
              "CPU (s)", "CPU a sample (us)"]  # fmt: skip
    share = 100.0 * cpu[True] / cpu[False]
    text = (
        f"{len(joints)} joints of one JointState topic at {args.rate:g} Hz for {args.seconds:g} s, reliable.\n\n"
        f"{table(header, lines)}\n\nCPU of one node over that of {len(joints)} nodes: {share:.0f} %. Stamps that a "
        f"process of its own missed among the predictions of the one node, by joint: {', '.join(missing)}."
    )
    write_section("Joints", text)


if __name__ == "__main__":
    sys.exit(main())
