"""What is required of the figures of bench.json, and whether they keep it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

Parts = Mapping[str, Any]
"""Figures by part."""

LOOP_OVER_C = {"lms": 1.8, "nlms": 2.0, "rls": 2.0}
LIVE_OVER_BATCH_US = 2.5
READING = {"mcap": 25.0, "sqlite3": 12.0}
SHARE_OF_THE_LOOP = 0.7
MEMORY_MB = 600.0
START_UP = {"import friction_estimator": 0.3, "--help": 0.7, "info of bags/demo": 4.0}
FIRST_MESSAGE = 3.0
CPU_OVER_RAW_ECHO, P99_OVER_TYPED_ECHO = 1.3, 1.2
TWO_PROCESSES = 1.8

REFERENCE = "import rosbags.highlevel, numpy"


class Requirement(NamedTuple):
    """Something that a figure is to be at most, or at least.

    Attributes
    ----------
    figure : the worst of all that it is about.
    holds : what is required beside the bound.
    """

    what: str
    figure: float
    bound: float
    at_most: bool = True
    unit: str = ""
    holds: bool = True

    @property
    def met(self) -> bool:
        """Whether the figure keeps its bound."""
        return self.holds and (self.figure <= self.bound if self.at_most else self.figure >= self.bound)


def ratio(one: Sequence[float], other: Sequence[float]) -> float:
    """Return the median of the ratios within a round."""
    return median(a / b for a, b in zip(one, other, strict=True))


def difference(one: Sequence[float], other: Sequence[float]) -> list[float]:
    """Return the differences within a round."""
    return [a - b for a, b in zip(one, other, strict=True)]


def share(loops: Mapping[str, Any], law: str, kind: str, with_start: bool) -> float:
    """Return the speed of `replay` over that of the bare loop, by processor time (`cpu`) or by the `clock`."""
    whole = loops[f"replay, {law}"][kind]
    took = whole if with_start else difference(whole, loops[f"start of replay, {law}"][kind])
    return ratio(loops[f"bare loop, {law}"][kind], took)


def of_kernels(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    loops = figures["loops"].values()
    if all("C_us" in one for one in loops):
        for law, bound in LOOP_OVER_C.items():
            own = max(ratio(one["loop_us"], one["C_us"]) for one in loops if one["law"] == law)
            yield Requirement(f"sample loop of `{law}` over the same law in C", own, bound)
    before = figures["before"]
    both = max(
        ratio([a + b for a, b in zip(before["basis"], before[theory], strict=True)], before["loop, parallel lms"])
        for theory in ("Stribeck curve", "seal")
    )
    yield Requirement("basis and theory together over the loop, parallel `lms`", both, 1.0)
    live = max(median(difference(one["live_us"], one["batch_us"])) for one in figures["live"].values())
    yield Requirement("one live sample less the batch's", live, LIVE_OVER_BATCH_US, unit=" us")


def of_reading(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    for storage, bound in READING.items():
        ways = figures["storages"][storage]
        yield Requirement(
            f"{storage} pairs, rosbags' loop over ours", ratio(ways["rosbags"], ways["here"]), bound, False
        )


def of_long(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    loops, recording = figures["loops"], f"a recording of {figures['samples']} samples"
    for law in ("rls", "lms"):
        for with_start, words in ((False, "without the start"), (True, "with the start")):
            speed = share(loops, law, "clock", with_start)
            what = f"`replay` of {recording}, `{law}`: speed over the bare loop's, by the clock, {words}"
            yield Requirement(what, speed, SHARE_OF_THE_LOOP, False)
    peaks = {"replay": max(max(loops[f"replay, {law}"]["memory"]) for law in ("rls", "lms"))}
    peaks |= {name: max(cost["memory"]) for name, cost in figures["once"].items() if "start of" not in name}
    for name, peak in peaks.items():
        yield Requirement(f"`{name}` of {recording}: memory", peak, MEMORY_MB, unit=" MB")


def of_start_up(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    commands = figures["commands"]
    for name, bound in START_UP.items():
        own = ratio(commands[name]["cpu"], commands[REFERENCE]["cpu"])
        yield Requirement(f"`{name}` over `{REFERENCE}`", own, bound)


def of_node_start(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    processes = figures["processes"]
    own = ratio(processes["node"]["clock"], processes["bare rclpy node"]["clock"])
    yield Requirement(
        "node's first prediction over a bare rclpy node's first message, by the clock", own, FIRST_MESSAGE
    )


def of_node(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    own, rate = figures["variants"], f"{figures['rate_hz']:g} Hz"
    cpu = ratio(own["node"]["cpu_us"], own["echo, raw, events"]["cpu_us"])
    yield Requirement(f"node at {rate}: processor time over the raw echo's", cpu, CPU_OVER_RAW_ECHO)
    p99 = ratio(own["node"]["p99_us"], own["echo, typed, events"]["p99_us"])
    yield Requirement(f"node at {rate}: p99 over the typed echo's", p99, P99_OVER_TYPED_ECHO)


def of_many(figures: Mapping[str, Any]) -> Iterator[Requirement]:
    for name, verb in figures["verbs"].items():
        one, two = (verb["processes"][verb["workers"].index(count)] for count in (1, 2))
        for where, other in (("two processes", two), ("a Dask cluster of two workers", verb["dask"])):
            what = f"`{name}`, {verb['what']}: one process over {where}, rows equal to the bit"
            faster = ratio(one["clock"], other["clock"])
            yield Requirement(what, faster, TWO_PROCESSES, at_most=False, holds=verb["equal"])


OF: dict[str, Callable[[Mapping[str, Any]], Iterator[Requirement]]] = {
    "kernels": of_kernels,
    "reading": of_reading,
    "long": of_long,
    "start_up": of_start_up,
    "node_start": of_node_start,
    "node": of_node,
    "many": of_many,
}
"""Requirements by part."""
