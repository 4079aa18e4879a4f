"""A hostile publisher: every fault that a drive, a bag or a clock can commit; shared by the tests and benchmarks."""

import random
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from ros_graph import NS, Feeder, await_, force, motion

RATE_HZ = 500.0
STEP_NS = round(NS / RATE_HZ)


class Hostile:
    """Publishes plausible samples at 500 Hz of stamp time, and faults between them.

    Parameters
    ----------
    feeder : publishes.
    heard : fills with the raw predictions.
    wall_rate_hz : pairs a second of wall-clock time.
    """

    def __init__(self, feeder: Feeder, heard: list[Any], wall_rate_hz: float = 1500.0) -> None:
        self.feeder, self.heard = feeder, heard
        self._wall = wall_rate_hz
        _, self._velocity, self._friction = motion(200_000, RATE_HZ)
        self._next = 0
        self._stamp = 1_700_000_000 * NS
        self._truth: dict[int, float] = {}
        self._due = time.perf_counter()

    def _pace(self) -> None:
        self._due = max(self._due + 1.0 / self._wall, time.perf_counter() - 0.01)
        while (wait := self._due - time.perf_counter()) > 0:
            time.sleep(wait)

    def take(self, count: int) -> Iterator[tuple[int, float, float]]:
        """Yield the next samples (stamp, velocity, friction) at the pace of publishing."""
        for _ in range(count):
            self._pace()
            k, self._next = self._next, self._next + 1
            self._stamp += STEP_NS
            yield self._stamp, float(self._velocity[k]), float(self._friction[k])

    def send(self, stamp: int, velocity: float, friction: float) -> None:
        self._truth[stamp] = friction
        self.feeder.pair(stamp, velocity, friction)

    def normal(self, seconds: float) -> float:
        """Publish for so long in stamp time; return the rms error of the last quarter, N."""
        count = round(seconds * RATE_HZ)
        stamps = []
        for sample in self.take(count):
            self.send(*sample)
            stamps.append(sample[0])
        await_(lambda: self.heard and force(self.heard[-1])[0] == stamps[-1], "the last prediction")
        predicted = dict(force(raw) for raw in self.heard[-2 * count :])
        assert all(stamp in predicted for stamp in stamps[count // 4 :]), "normal samples were not predicted"
        last = stamps[-count // 4 :]
        return float(np.sqrt(np.mean([(predicted[s] - self._truth[s]) ** 2 for s in last])))

    def shift(self, seconds: float) -> None:
        """Let the clock jump."""
        self._stamp += round(seconds * NS)


def _values(velocity: float | None, friction: float | None) -> Callable[[Hostile], int]:
    def commit(hostile: Hostile) -> int:
        for stamp, v, f in hostile.take(100):
            hostile.feeder.pair(stamp, v if velocity is None else velocity, f if friction is None else friction)
        return 100

    return commit


def _jump(seconds: float) -> Callable[[Hostile], int]:
    def commit(hostile: Hostile) -> int:
        hostile.shift(seconds)
        return 1

    return commit


def _shuffled(hostile: Hostile) -> int:
    rng = random.Random(1)
    late = 0
    for _ in range(10):
        block = list(hostile.take(10))
        rng.shuffle(block)
        newest = 0
        for sample in block:
            hostile.send(*sample)
            late += sample[0] < newest
            newest = max(newest, sample[0])
    return late


def _repeated(hostile: Hostile) -> int:
    for sample in hostile.take(50):
        for _ in range(3):
            hostile.send(*sample)
    return 100


def _stamped_in(seconds: int) -> Callable[[Hostile], int]:
    def commit(hostile: Hostile) -> int:
        for k, (_, v, f) in enumerate(hostile.take(50)):
            hostile.send(seconds * NS + (k + 1) * STEP_NS, v, f)
        return 1

    return commit


def _burst(hostile: Hostile) -> int:
    stamp = hostile._stamp
    _, v, f = next(hostile.take(1))
    for k in range(400):
        hostile.send(stamp + k * NS // 10_000, v, f)
        if k % 50 == 49:
            time.sleep(0.005)
    return 0


def _spikes(hostile: Hostile) -> int:
    for k, (stamp, v, f) in enumerate(hostile.take(100)):
        hostile.feeder.pair(stamp, v, 1e3 if k % 20 == 0 else f)
    return 5


def _half(velocity: bool) -> Callable[[Hostile], int]:
    def commit(hostile: Hostile) -> int:
        for stamp, v, f in hostile.take(100):
            if velocity:
                hostile.feeder.velocity(stamp, v)
            else:
                hostile.feeder.friction(stamp, f)
        return 100

    return commit


def _zero(hostile: Hostile) -> int:
    for _, v, f in hostile.take(100):
        hostile.feeder.pair(0, v, f)
    return 100


FAULTS: dict[str, tuple[Callable[[Hostile], int], str]] = {
    "NaN friction": (_values(None, float("nan")), "rejected: nan"),
    "NaN velocity": (_values(float("nan"), None), "rejected: nan"),
    "infinite friction": (_values(None, float("inf")), "rejected: infinite"),
    "infinite velocity": (_values(float("-inf"), None), "rejected: infinite"),
    "1e300 N": (_values(None, 1e300), "rejected: infinite"),
    "1e300 m/s": (_values(1e300, None), "rejected: infinite"),
    "spikes of 1 kN": (_spikes, "outliers clipped"),
    "1e9 m/s": (_values(1e9, None), "outside velocity range"),
    "gap of 0.1 s": (_jump(0.1), "gaps"),
    "gap of 10 s": (_jump(10.0), "gaps"),
    "shuffled stamps": (_shuffled, "rejected: backward_stamp"),
    "repeated stamps": (_repeated, "rejected: duplicate_stamp"),
    "stamps from 1970": (_stamped_in(100), "clock jumps back"),
    "stamps from 2038": (_stamped_in(2**31 - 100), "clock jumps back"),
    "stamps from 2106": (_stamped_in(2**32 - 1000), "clock jumps back"),
    "jump of +1 h": (_jump(3600.0), "gaps"),
    "jump of -1 h": (_jump(-3600.0), "clock jumps back"),
    "burst at 10 kHz": (_burst, ""),
    "velocity only": (_half(True), "rejected: unmatched"),
    "friction only": (_half(False), "rejected: unmatched"),
    "zero stamps": (_zero, "rejected: zero_stamp"),
}
"""Name -> (commits the fault and returns by how much a counter must grow at least, the counter)."""
