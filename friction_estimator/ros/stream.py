"""From events to published predictions: the same intake and estimator that replay uses, fed as messages arrive."""

from collections.abc import Callable

import numpy as np

from friction_estimator.core.config import Config
from friction_estimator.core.estimator import Estimator
from friction_estimator.core.intake import Intake
from friction_estimator.core.pairing import FRICTION

BUFFER = 100
"""Events held back at most."""

Publish = Callable[[int, float, float], None]
"""Takes (stamp in ns, predicted friction, measured friction)."""


class SampleStream:
    """Feed events to an estimator and hand on its predictions.

    An event that cannot complete a sample is held back and pushed together with the one that can: the order of
    events, and so every result, is the same, for half the calls.

    Parameters
    ----------
    config : `sync.*` and `input.friction_sign` are read.
    estimator : predicts and learns; None while the configuration allows none (samples are counted and dropped).
    publish : takes each prediction.
    """

    def __init__(self, config: Config, estimator: Estimator | None, publish: Publish) -> None:
        self.intake = Intake(config)
        self.estimator = estimator
        self.learn = config.model.adapt
        self.predictions = 0
        self.lost = 0
        """Samples that the estimator did not predict, for want of a usable configuration or by a fault."""
        self.velocity_seen = (float("inf"), float("-inf"))
        self._publish = publish
        self._streams: list[int] = []
        self._stamps: list[int] = []
        self._values: list[float] = []
        self._pending = [False, False]
        self._waiting = (0, 0)
        self._past: dict[str, int] = {}

    def event(self, stream: int, stamp_ns: int, value: float) -> None:
        """Take one event; publish the samples that it completes."""
        self._streams.append(stream)
        self._stamps.append(stamp_ns)
        self._values.append(value)
        if stream <= FRICTION:
            self._pending[stream] = True
            other = 1 - stream
            if self._pending[other] or self._waiting[other]:
                self.flush()
                return
        if len(self._streams) >= BUFFER:
            self.flush()

    def flush(self) -> None:
        """Push what was held back."""
        if not self._streams:
            return
        samples = self.intake.push(self._streams, self._stamps, self._values)
        self._streams, self._stamps, self._values = [], [], []
        self._pending = [False, False]
        self._waiting = self.intake.pairer.waiting
        if not len(samples):
            return
        self.lost += len(samples)
        if self.estimator is None:
            return
        predicted = self.estimator.run(samples, self.learn)
        low, high = self.velocity_seen
        self.velocity_seen = (
            min(low, float(np.min(samples.velocity_m_s))),
            max(high, float(np.max(samples.velocity_m_s))),
        )
        for stamp, forecast, friction in zip(
            samples.stamp_ns.tolist(), predicted.tolist(), samples.friction_N.tolist(), strict=True
        ):
            self.predictions += 1
            self.lost -= 1
            self._publish(stamp, forecast, friction)

    def reconfigure(self, config: Config) -> None:
        """Pair by other settings from now on; the counters go on."""
        self.flush()
        self.intake.flush()
        self._past = self.counts
        self.intake = Intake(config)
        self._waiting = (0, 0)

    @property
    def counts(self) -> dict[str, int]:
        """Samples by reason (`used` among them), and the breaks in time: `gaps` and `jumps`."""
        total = dict(self._past)
        sequencer = self.intake.sequencer
        for reason, count in {**self.intake.counts, "gaps": sequencer.gaps, "jumps": sequencer.jumps}.items():
            total[reason] = total.get(reason, 0) + count
        return total

    def restart(self) -> None:
        """Drop what waits and let the next sample restart the delay lines; what was learned stays."""
        self.flush()
        self.intake.restart()
        self._waiting = self.intake.pairer.waiting
