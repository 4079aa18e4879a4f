"""A node that is fed faster than it can predict: what it must tell, and that it stays reachable.

Every sample that was sent is in one place: predicted, dropped and counted, without a partner, or never handed over by
the middleware, which only the rhythm of the stamps tells.
"""

import signal
import time

import numpy as np
import ros_graph
from ros_graph import Feeder, await_, motion
from test_ros_node import feed

NODE = "/friction_estimator"
TOPICS = ("velocity", "friction")
WITHIN = 0.01
"""Share of what was sent within which the account is exact."""


def values_of(message):
    values = {"stamp_s": message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec}
    for status in message.status:
        part = status.name.rpartition(" ")[2]
        values |= {pair.key: pair.value for pair in status.values}
        values |= {f"{part} level": int.from_bytes(status.level), f"{part} message": status.message}
    return values


def count(values, key):
    return int(values.get(key, 0))


def account(values):
    """Return, of each topic, the samples that diagnostics speak of."""
    told = ("predictions", "samples lost", "samples dropped, too slow", "samples waiting")
    refused = ("nan", "infinite", "duplicate_stamp", "backward_stamp", "zero_stamp")
    joined = sum(count(values, key) for key in told) + sum(count(values, f"rejected: {reason}") for reason in refused)
    arrived = {topic: count(values, f"{topic}: messages") for topic in TOPICS}
    # A message is part of a sample, had no partner, or waits for one: nothing else becomes of it.
    alone = count(values, "rejected: unmatched") + sum(
        map(int, values["waiting velocity, friction"].strip("()").split(","))
    )
    assert sum(arrived.values()) == 2 * joined + alone, values
    return {topic: arrived[topic] + count(values, f"{topic}: messages missing") for topic in TOPICS}


def overload(graph, parameters, *, seconds, rate_hz, stopped=False):
    """Feed a node that cannot keep up; judge what it says and return figures.

    Parameters
    ----------
    stopped : whether the process is stopped (SIGSTOP) while the middle third is sent.
    """
    from diagnostic_msgs.msg import DiagnosticArray

    process = graph.start_node(parameters, deep=False, limit_s=5 * ros_graph.LIMIT_S)
    feeder = Feeder(graph)
    feeder.matched()
    told = []
    graph.probe.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: told.append((time.monotonic(), values_of(m))), 1000
    )
    await_(lambda: told, "diagnostics")
    begin = time.monotonic()
    stamps, velocity, friction = motion(round(seconds * rate_hz), rate_hz)
    for third in range(3):
        if stopped:
            process.popen.send_signal(signal.SIGSTOP if third == 1 else signal.SIGCONT)
        part = slice(third * stamps.size // 3, (third + 1) * stamps.size // 3)
        feed(feeder, stamps[part], velocity[part], friction[part], rate_hz)
    asked = time.monotonic()
    assert graph.call_get(NODE, "model.law") == "rls"
    answered_s = time.monotonic() - asked
    feeder.acknowledged()

    def settled():
        values = told[-1][1]
        return values if all(abs(n - stamps.size) <= WITHIN * stamps.size for n in account(values).values()) else None

    try:
        values = await_(settled, "every sample to be accounted for")
    except AssertionError as error:
        raise AssertionError(f"{error}: {stamps.size} sent, {account(told[-1][1])} told: {told[-1][1]}") from None
    during = [(at - begin, v) for at, v in told if at > begin]
    # By their stamps: this process hears nothing for a second when it begins to ask for parameters.
    pauses = np.diff([v["stamp_s"] for _, v in during])
    stopping = time.monotonic()
    assert process.stop() == 0
    return {
        "sent": stamps.size,
        "told": account(values),
        "missing": {topic: count(values, f"{topic}: messages missing") for topic in TOPICS},
        "predicted": count(values, "predictions"),
        "dropped": count(values, "samples dropped, too slow"),
        "unmatched": count(values, "rejected: unmatched"),
        "warned_s": next((at for at, v in during if max(v["estimator level"], v["inputs level"]) >= 1), None),
        "longest_pause_s": float(pauses.max()) if pauses.size else 0.0,
        "answered_s": answered_s,
        "stopped_s": time.monotonic() - stopping,
        "words": {v["estimator message"] for _, v in during},
    }


SLOW = {"basis.velocity_unit": 0.01, "basis.companding": 0.0}
WEIGHTS_4000 = SLOW | {"basis.finest_level": -6}
WEIGHTS_2000 = SLOW | {"basis.finest_level": -5}
