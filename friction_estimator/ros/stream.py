"""From events to published predictions, as messages arrive; replay does the same over arrays."""

from collections.abc import Callable

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.live import CAPACITY, Events, LiveStep
from friction_estimator.core.settings.config import Config

Publish = Callable[[int, float, float], None]
"""Takes (stamp in ns, predicted friction, measured friction)."""


class SampleStream:
    """Feed events to an estimator and hand on its predictions.

    An event that cannot complete a sample is held back and pushed together with the one that can: the order of
    events, and so every result, is the same, for half the calls.

    Parameters
    ----------
    config : `sync.*`, `input.friction_sign` and `model.adapt` are read.
    estimator : predicts and learns; None while the configuration allows none (samples are counted and dropped).
    publish : takes each prediction.

    Attributes
    ----------
    learn : whether samples are learned from.
    predictions, lost : samples predicted; samples without prediction, for want of a usable configuration or by a fault.
    velocity_seen : lowest and highest velocity of the predicted samples, m/s.
    """

    def __init__(self, config: Config, estimator: Estimator | None, publish: Publish) -> None:
        self.learn = config.model.adapt
        self.predictions = 0
        self.lost = 0
        self.velocity_seen = (float("inf"), float("-inf"))
        self._publish = publish
        self._past: dict[str, int] = {}
        self._connect(Intake(config), estimator)

    def _connect(self, intake: Intake, estimator: Estimator | None) -> None:
        self.intake, self._estimator = intake, estimator
        self._count = 0
        self._pending = [False, False]
        self._waiting = intake.pairer.waiting
        self._step = LiveStep(intake, estimator) if estimator is not None else None
        buffer = self._step or Events()
        self._streams, self._stamps, self._values = buffer.stream, buffer.stamp_ns, buffer.value

    @property
    def estimator(self) -> Estimator | None:
        """The estimator; setting another one keeps pairing and counters."""
        return self._estimator

    @estimator.setter
    def estimator(self, estimator: Estimator | None) -> None:
        self.flush()
        self._connect(self.intake, estimator)

    def event(self, stream: int, stamp_ns: int, value: float) -> None:
        """Take one event; publish the samples that it completes."""
        count = self._count
        self._streams[count] = stream
        self._stamps[count] = stamp_ns
        self._values[count] = value
        self._count = count + 1
        if stream <= FRICTION:
            self._pending[stream] = True
            other = 1 - stream
            if self._pending[other] or self._waiting[other]:
                self.flush()
                return
        if count + 1 == CAPACITY:
            self.flush()

    def flush(self) -> None:
        """Push what was held back."""
        count = self._count
        if not count:
            return
        self._count = 0
        self._pending[0] = self._pending[1] = False
        if self._step is None:
            samples = self.intake.push(self._streams[:count], self._stamps[:count], self._values[:count])
            self.lost += len(samples)
            self._waiting = self.intake.pairer.waiting
            return
        sequencer = self.intake.sequencer
        admitted, predicted = sequencer.admitted, 0
        try:
            for stamp_ns, velocity, friction, forecast in self._step.run(count, learn=self.learn):
                low, high = self.velocity_seen
                if not low <= velocity <= high:
                    self.velocity_seen = (min(low, velocity), max(high, velocity))
                predicted += 1
                self._publish(stamp_ns, forecast, friction)
        finally:
            self.predictions += predicted
            self.lost += sequencer.admitted - admitted - predicted
            self._waiting = self.intake.pairer.waiting

    def reconfigure(self, config: Config) -> None:
        """Pair by other settings from now on; the counters go on."""
        self.flush()
        self.intake.flush()
        self._past = self.counts
        self._connect(Intake(config), self._estimator)

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
