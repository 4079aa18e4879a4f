"""How much of its time the node uses, and how late its predictions are; it costs two looks at the clock a sample."""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

REMEMBERED = 20_000
"""Latencies kept between two looks: four seconds at 5 kHz."""

NAN = float("nan")


@dataclass(frozen=True)
class Account:
    """What happened between two looks.

    Attributes
    ----------
    p50_ms, p99_ms, longest_ms : time from the arrival of a sample to its prediction, ms; NaN without any.
    busy : share of the time that the node's thread used the processor.
    """

    p50_ms: float
    p99_ms: float
    longest_ms: float
    busy: float


class Load:
    """Latencies and processor time of the thread that serves the node.

    A sample arrives when its last message is handed over. While the node did something else that could not be seen, so
    a sample that comes right after other work counts from the beginning of that work: its latency is an upper bound.
    """

    def __init__(self) -> None:
        self._latencies_ns: deque[int] = deque(maxlen=REMEMBERED)
        self.note = self._latencies_ns.append
        """Takes the time from the arrival of a sample to its prediction, ns."""
        self._other_began = self._other_felt_until = 0
        self._message_came = 0
        self._wall, self._cpu = time.monotonic(), time.thread_time()

    def arrived(self, now_ns: int) -> int:
        """Return when a sample that is handed over at `now_ns` may have arrived, ns of `time.perf_counter_ns`."""
        came = self._message_came or now_ns
        return min(came, self._other_began) if came < self._other_felt_until else came

    def message(self) -> None:
        """Note that a message of several samples came: the last of them waits for all before it."""
        self._message_came = time.perf_counter_ns()

    def message_done(self) -> None:
        """Note that all samples of that message were handed over."""
        self._message_came = 0

    @contextmanager
    def other_work(self) -> Iterator[None]:
        """Do what is no sample; those that wait meanwhile are caught up with in about the same time."""
        began = time.perf_counter_ns()
        try:
            yield
        finally:
            ended = time.perf_counter_ns()
            self._other_began, self._other_felt_until = began, ended + (ended - began)

    def look(self) -> Account:
        """Return the account since the last look."""
        latencies = np.array(self._latencies_ns, np.float64) / 1e6
        self._latencies_ns.clear()
        wall, cpu = time.monotonic(), time.thread_time()
        busy = (cpu - self._cpu) / max(wall - self._wall, 1e-6)
        self._wall, self._cpu = wall, cpu
        if not latencies.size:
            return Account(NAN, NAN, NAN, busy)
        p50, p99 = np.percentile(latencies, [50.0, 99.0])
        return Account(float(p50), float(p99), float(latencies.max()), busy)
