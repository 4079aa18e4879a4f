"""Ten minutes at 200 Hz with everything going on at once.

    python endurance.py [--minutes 10]

The player loops a recording into two nodes in two namespaces while parameters change every second and services are
called. Nothing may be lost, nothing restart, memory stay flat.
"""

import argparse
import contextlib
import tempfile
import time
from collections import Counter
from pathlib import Path

from common import write_section
from geometry_msgs.msg import WrenchStamped
from ros_graph import ROOT, await_, force, graph
from std_srvs.srv import SetBool, Trigger
from tables import table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    args = parser.parse_args()
    sides = ("left", "right")
    with graph(Path(tempfile.mkdtemp())) as made:
        nodes, heard, players = {}, {}, {}
        for side in sides:
            topics = {
                f"qos_overrides./{side}/{t}.subscription.reliability": "reliable" for t in ("velocity", "friction")
            }
            state = {"state.file": str(made.folder / f"{side}.json"), "state.period": 5.0}
            nodes[side] = made.start_node({**topics, **state}, namespace=f"/{side}", units=False)
            heard[side] = made.hear(WrenchStamped, f"/{side}/friction_estimator/friction_predicted", raw=True)
        bag = str(ROOT / "bags" / "demo")
        sent = {side: made.hear(WrenchStamped, f"/{side}/friction", raw=True) for side in sides}
        for side in sides:
            names = ("velocity", "friction", "pressure", "temperature", "position")
            remap = [word for t in names for word in ("--remap", f"/{t}:=/{side}/{t}")]
            players[side] = made.start("-m", "friction_estimator", "play", bag, "--loop", *remap)
        await_(lambda: all(len(found) > 200 for found in heard.values()), "predictions")
        begin = time.monotonic()
        memory: dict[str, list[float]] = {side: [] for side in sides}
        faults = []
        calls = 0
        while time.monotonic() - begin < 60.0 * args.minutes:
            turn = time.monotonic()
            for side in sides:
                name = f"/{side}/friction_estimator"
                value = 0.9990 + 0.0001 * (calls % 9)
                answer = made.call_set(name, rls__forgetting_factor=value, publish__parameters_rate=float(calls % 20))
                if not answer.successful:
                    faults.append(answer.reason)
                for kind, service, fields in (
                    (Trigger, "save", {}),
                    (SetBool, "adapt", {"data": calls % 5 != 0}),
                ):
                    if not made.call(kind, f"{name}/{service}", **fields).success:
                        faults.append(f"{service} failed")
                if len(made.call_get(name, "learned.wavelet_weights")) < 10:
                    faults.append("no weights")
                memory[side].append(nodes[side].memory_MB())
            calls += 1
            while time.monotonic() - turn < 1.0:
                time.sleep(0.02)
        for side in sides:
            players[side].stop()
        # The player may be stopped between the two messages of a pair.
        with contextlib.suppress(AssertionError):
            await_(lambda: all(len(heard[s]) >= len(sent[s]) - 1 for s in sides), "the last predictions", 20.0)
        lines = []
        for side in sides:
            found, wanted = ([force(raw)[0] for raw in part[side]] for part in (heard, sent))
            missing = Counter(wanted[: len(wanted) - 1]) - Counter(found)
            if missing:
                places = [k for k, stamp in enumerate(wanted) if stamp in missing]
                faults.append(f"{side}: {sum(missing.values())} lost, among samples {places[0]} to {places[-1]}")
            same = found[: len(wanted) - 1] == wanted[: len(wanted) - 1]
            growth = max(memory[side][60:], default=0.0) - (memory[side][60] if len(memory[side]) > 60 else 0.0)
            lines.append(
                [
                    side,
                    len(sent[side]),
                    len(heard[side]),
                    sum(missing.values()),
                    same,
                    f"{memory[side][-1]:.1f}",
                    f"{growth:.2f}",
                    nodes[side].stop(),
                    players[side].popen.returncode,
                ]
            )
            if "Traceback" in nodes[side].output() or "ERROR" in nodes[side].output():
                faults.append(nodes[side].output()[-2000:])
    header = ["node", "samples", "predictions", "lost", "same order", "memory (MB)", "growth after 1 min (MB)"]
    write_section(
        "Endurance",
        f"{args.minutes:g} minutes at 200 Hz, two nodes, looping players, parameters and services every second.\n\n"
        + table([*header, "exit code", "player's"], lines)
        + f"\n\n{len(faults)} faults in {calls} rounds of calls."
        + "".join(f"\n\n```\n{text}\n```" for text in faults[:3]),
    )


if __name__ == "__main__":
    main()
