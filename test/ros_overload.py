"""A node that is fed faster than it can predict: what it must tell, and that it stays reachable."""

import time

import numpy as np
import ros_graph
from ros_graph import Feeder, await_, motion
from test_ros_node import feed

NODE = "/friction_estimator"


def overload(graph, weights_level, seconds, rate_hz):
    """Feed a node whose basis is too slow; return the process, what was sent, and the diagnostics with their times."""
    from diagnostic_msgs.msg import DiagnosticArray

    process = graph.start_node(
        {"basis.finest_level": weights_level, "basis.velocity_unit": 0.01, "basis.companding": 0.0},
        deep=False,
        limit_s=5 * ros_graph.LIMIT_S,
    )
    feeder = Feeder(graph)
    feeder.matched()
    told = []
    graph.probe.create_subscription(DiagnosticArray, "/diagnostics", lambda m: told.append((time.monotonic(), m)), 100)
    await_(lambda: told, "diagnostics")
    told.clear()
    begin = time.monotonic()
    stamps, velocity, friction = motion(round(seconds * rate_hz), rate_hz)
    feed(feeder, stamps, velocity, friction, rate_hz)
    return process, feeder, stamps.size, begin, told


def estimator_values(message):
    status = next(s for s in message.status if s.name.endswith("estimator"))
    return {pair.key: pair.value for pair in status.values} | {
        "level": int.from_bytes(status.level),
        "message": status.message,
    }


def judge_overload(graph, weights_level, *, seconds, rate_hz):
    """Loss told with its reason, counted to the sample; diagnostics on time, services answered, signals obeyed."""
    process, feeder, sent, begin, told = overload(graph, weights_level, seconds, rate_hz)
    asked = time.monotonic()
    assert graph.call_get(NODE, "model.law") == "rls"
    answered_s = time.monotonic() - asked
    feeder.acknowledged()

    def settled():
        if not told:
            return None
        values = estimator_values(told[-1][1])
        accounted = sum(int(values[k]) for k in ("predictions", "samples dropped, too slow", "samples waiting"))
        return values if accounted == sent else None

    values = await_(settled, "every sample to be accounted for", 5 * ros_graph.LIMIT_S)
    dropped = int(values["samples dropped, too slow"])
    assert dropped > 0, values
    during = [(at, estimator_values(message)) for at, message in told]
    warned = next(at for at, v in during if v["level"] >= 1 and at > begin) - begin
    grave = next(at for at, v in during if v["level"] == 2) - begin
    reason = next(v["message"] for _, v in during if v["level"] == 2)
    assert "too slow" in reason
    assert "smaller basis" in reason
    pauses = np.diff([at for at, _ in told])
    begun = time.monotonic()
    assert process.stop() == 0
    return {
        "sent": sent,
        "predicted": int(values["predictions"]),
        "dropped": dropped,
        "warned_s": warned,
        "grave_s": grave,
        "longest_pause_s": float(pauses.max()),
        "answered_s": answered_s,
        "stopped_s": time.monotonic() - begun,
        "share": during[len(during) // 2][1]["share of the sample period used (%)"],
    }
