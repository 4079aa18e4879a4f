"""One JointState topic at a high rate: how many samples get lost, beside the node under the stock executor.

    python joint_state.py [--seconds 60] [--rate 5000]

The load is a process of its own without any subscription; the node itself counts, in its diagnostics.
"""

import argparse
import struct
import tempfile
import time
from pathlib import Path

from common import HERE, write_section
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from ros_graph import NS, Graph, Process, await_, graph, motion
from sensor_msgs.msg import JointState
from tables import table


def load(made: Graph, rate_hz: float, seconds: float) -> tuple[int, float]:
    """Publish; return the number of messages and the rate that was reached."""
    publisher = made.publisher(JointState, "/joint_states", depth=5000)
    made.matched("/joint_states")
    time.sleep(1.0)
    count = round(rate_hz * seconds)
    stamps, velocity, friction = motion(count, rate_hz)
    message = JointState(name=["shaft"], velocity=[0.0], effort=[0.0])
    template = bytearray(serialize_message(message))
    at = template.rindex(struct.pack("<I", 1), 0, len(template) - 8)  # count of the last array, effort
    effort_at = next(p for p in range(at + 4, at + 12) if (p - 4) % 8 == 0)
    velocity_at = effort_at - 16
    start = time.perf_counter_ns()
    step = 1e9 / rate_hz
    for k, (stamp, v, f) in enumerate(zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True)):
        while (wait := start + k * step - time.perf_counter_ns()) > 0:
            if wait > 100_000:
                time.sleep(wait * 1e-9 / 2)
        struct.pack_into("<iI", template, 4, *divmod(stamp, NS))
        struct.pack_into("<d", template, velocity_at, v)
        struct.pack_into("<d", template, effort_at, f)
        publisher.publish(bytes(template))
    took = (time.perf_counter_ns() - start) * 1e-9
    return count, count / took


def predictions(made: Graph) -> dict[str, int]:
    """Return what the node counted, once its counters stand still."""
    seen: list[dict[str, int]] = []

    def look(message: DiagnosticArray) -> None:
        values = {pair.key: pair.value for status in message.status for pair in status.values}
        if "predictions" in values:
            seen.append({"predictions": int(values["predictions"]), "lost": int(values["samples lost"])})

    subscription = made.probe.create_subscription(DiagnosticArray, "/diagnostics", look, 10)
    await_(lambda: len(seen) > 2 and seen[-1] == seen[-2], "counters to stand still")
    made.probe.destroy_subscription(subscription)
    return seen[-1]


def start(made: Graph, stock: bool) -> Process:
    values = ("input.mode:=joint_state", "qos_overrides./joint_states.subscription.reliability:=best_effort")
    words = [word for value in values for word in ("-p", value)]
    module = [str(HERE / "stock_node.py")] if stock else ["-m", "friction_estimator.ros.node"]
    process = made.start(*module, "--ros-args", *words)
    process.says("listening")
    return process


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=5000.0)
    args = parser.parse_args()
    lines = []
    for name, stock in (("node", False), ("node, stock executor", True)):
        with graph(Path(tempfile.mkdtemp())) as made:
            process = start(made, stock)
            cpu = process.cpu_s()
            sent, rate = load(made, args.rate, args.seconds)
            found = predictions(made)
            cpu = process.cpu_s() - cpu
            code = process.stop()
        lost = 1.0 - found["predictions"] / sent
        lines.append(
            [name, f"{rate:.0f}", sent, found["predictions"], f"{100 * lost:.2f} %", f"{cpu / sent * 1e6:.0f}", code]
        )
    header = ["variant", "rate (Hz)", "messages", "predictions", "lost", "CPU a message (us)", "exit code"]
    write_section("JointState", f"One JointState topic for {args.seconds:g} s, best effort.\n\n" + table(header, lines))


if __name__ == "__main__":
    main()
