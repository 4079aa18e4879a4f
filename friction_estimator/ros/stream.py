"""From events to published predictions, as messages arrive; replay does the same over arrays."""

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from friction_estimator.core.errors import FrictionEstimatorError
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, PRESSURE, TEMPERATURE, VELOCITY
from friction_estimator.core.model.theory_choice import has_pressure
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.live import CAPACITY, Events, LiveStep, Prediction
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.ros.load import Load
from friction_estimator.ros.quality import INPUT_DEPTH

Publish = Callable[[int, float, float, float, float], None]
"""Takes (stamp in ns, velocity, predicted friction, measured friction, standard deviation of the prediction)."""

Build = Callable[[Config], Estimator]

WORK_OFF_HZ = 5000.0
"""Samples a second that are worked off of what waited, beside twice as many as arrive: new ones still get in between,
and a subscriber keeps up with what comes out."""

LARGEST_PIECE = 256
"""Samples of them at once: their predictions fit into any queue."""

LONGEST_PIECE_S = 0.01
"""Processor time that such a piece may take, where that is more than one sample: services and diagnostics wait."""

REMEMBERED = 0.9
"""Share of the time that a sample took in the last piece which the next one takes at the least."""

QUEUES = 2
"""Samples that wait at the most where they come faster than they can be predicted, in depths of the inputs' queues: a
full queue is taken over at once, after the machine stood still, while new ones come. Then the oldest go, are counted,
and the delay lines restart. What waited for the first contact may be more."""

SLOWEST_BREATH_S = 0.15
"""Samples are predicted as their messages are handed over while timers are served at least so often; see `breathe`."""


class SampleStream:
    """Feed events to an estimator and hand on its predictions.

    An event that cannot complete a sample is held back and pushed together with the one that can: the order of
    events, and so every result, is the same, for half the calls.

    Parameters
    ----------
    config : `sync.*`, `input.friction_sign` and `model.adapt` are read; units and range, if it says them.
    build : makes the estimator when the first contact has ended; where it cannot, samples are counted and dropped.
    publish : takes each prediction.
    load : is told how long each sample took.

    Attributes
    ----------
    learn : whether samples are learned from.
    predictions, lost : samples predicted; samples without prediction, for want of a usable configuration or by a fault.
    overrun : samples let go because the node is too slow for them.
    queue_depth : of the inputs; see `QUEUES`.
    on_backlog : called where samples begin to wait; `work_off` has to be called then.
    sample_s : processor time that a sample took when samples were last worked off, s; 0 where none were.
    velocity_seen : lowest and highest velocity of the predicted samples, m/s.
    """

    def __init__(self, config: Config, build: Build, publish: Publish, load: Load | None = None) -> None:
        self.learn = config.model.adapt
        self.predictions = 0
        self.lost = 0
        self.overrun = 0
        self.queue_depth = INPUT_DEPTH
        self.on_backlog: Callable[[], None] = lambda: None
        self.velocity_seen = (float("inf"), float("-inf"))
        self._build, self._publish = build, publish
        self._load = load or Load()
        self._breath = time.perf_counter_ns()
        self._breathless = False
        self._arrived: deque[int] = deque()
        self.sample_s = 0.0
        self._dropped = 0
        self._worked_off_at, self._admitted_then = time.monotonic(), 0
        self._held = [float("nan"), float("nan")]
        self.intake = Intake(config)
        self._connect(None)

    def _connect(self, step: LiveStep | None) -> None:
        self._step = step
        self._breathless = False
        self._arrived.clear()
        self._room = QUEUES * self.queue_depth
        self._count = 0
        self._pending = [False, False]
        self._look()
        buffer = step or Events()
        self._streams, self._stamps, self._values = buffer.stream, buffer.stamp_ns, buffer.value

    # --- the estimator -----------------------------------------------------------------------------------------

    @property
    def estimator(self) -> Estimator | None:
        """The estimator; None while the first contact lasts, and where the configuration allows none."""
        return self._step.estimator if self._step is not None else None

    @property
    def running(self) -> bool:
        """Whether samples are predicted, or wait to be."""
        return self._step is not None

    @property
    def meeting(self) -> bool:
        """Whether samples wait for the end of the first contact."""
        return self._step is not None and self._step.contact is not None

    @property
    def held_back(self) -> int:
        """Samples that wait to be predicted."""
        if self._step is None:
            return 0
        return self._step.behind + (len(self._step.contact) if self._step.contact is not None else 0)

    @property
    def working_off(self) -> bool:
        """Whether `work_off` has something to do."""
        return self._breathless or (self._step is not None and self._step.behind > 0)

    @property
    def dropped(self) -> int:
        """Samples that waited and were let go: too many, or the wait was given up."""
        contact = self._step.contact if self._step is not None else None
        return self._dropped + (contact.dropped if contact is not None else 0)

    @property
    def has_pressure(self) -> bool:
        """Whether a pressure is recorded: with the samples of the first contact while it lasts, then at all."""
        contact = self._step.contact if self._step is not None else None
        if contact is not None:
            return has_pressure(contact.queue()[: contact.chosen_from or None])
        return bool(np.isfinite(self._held[0]))

    @property
    def conditions(self) -> Samples:
        """The last pressure and temperature, as the one sample that `Estimator.curve` takes them from."""
        nothing = np.zeros(1)
        pressure, temperature = (np.array([value]) for value in self._held)
        return Samples(np.ones(1, np.int64), nothing, nothing, np.ones(1, np.bool_), pressure, temperature)

    def begin(self, config: Config | None, estimator: Estimator | None = None) -> None:
        """Start anew; pairing and counters go on, samples that waited are let go.

        Parameters
        ----------
        config : where it leaves range and units open, the next samples decide; None: samples are counted and dropped.
        estimator : to go on with.
        """
        self.flush()
        self._dropped = self.dropped + self.held_back
        self._connect(None if config is None else LiveStep(self.intake, config, self._build, estimator))

    def go_on(self, estimator: Estimator) -> None:
        """End the first contact with this estimator: samples that wait are its first."""
        self.flush()
        if self._step is None:
            self.begin(estimator.config, estimator)
        else:
            self._dropped = self.dropped
            self._step.begin(estimator)
            self._room = self._step.behind + QUEUES * self.queue_depth

    # --- samples -----------------------------------------------------------------------------------------------

    def event(self, stream: int, stamp_ns: int, value: float) -> None:
        """Take one event; publish the samples that it completes."""
        count = self._count
        self._streams[count] = stream
        self._stamps[count] = stamp_ns
        self._values[count] = value
        self._count = count + 1
        if stream == POSITION and self._tracks:
            stream = VELOCITY  # it may complete a sample as a velocity does
        if stream <= FRICTION:
            self._pending[stream] = True
            other = 1 - stream
            if self._pending[other] or self._waiting[other]:
                self.flush()
                return
        elif stream <= TEMPERATURE:
            self._held[stream - PRESSURE] = value
        if count + 1 == CAPACITY:
            self.flush()

    def flush(self) -> None:
        """Push what was held back."""
        count = self._count
        if not count:
            return
        self._count = 0
        self._pending[0] = self._pending[1] = False
        step = self._step
        if step is None:
            samples = self.intake.push(self._streams[:count], self._stamps[:count], self._values[:count])
            self.lost += len(samples)
            self._look()
        elif step.contact is None and not step.behind and not self._breathless:
            admitted, predictions = self._admitted, self.predictions
            begin = time.perf_counter_ns()
            try:
                self._hand_on(step.run(count, learn=self.learn))
            finally:
                self._look()
                self.lost += self._admitted - admitted - (self.predictions - predictions)
            if self.predictions != predictions:
                now = time.perf_counter_ns()
                self._load.note(now - self._load.arrived(begin))
                if now - self._breath > 1e9 * SLOWEST_BREATH_S:
                    self.sample_s = min(1e-9 * (now - begin), LONGEST_PIECE_S)  # one at a time, to begin with
                    self._breathless = True
                    self.on_backlog()
            if not step.settled:  # its sample is published, those that come meanwhile wait
                with self._load.other_work():
                    step.settle()
        else:
            self._wait(step, count)

    def _hand_on(self, predictions: list[Prediction]) -> None:
        handed_on = 0
        try:
            for stamp_ns, velocity, friction, predicted, deviation in predictions:
                low, high = self.velocity_seen
                if not low <= velocity <= high:
                    self.velocity_seen = (min(low, velocity), max(high, velocity))
                handed_on += 1
                self._publish(stamp_ns, velocity, predicted, friction, deviation)
        finally:
            self.predictions += handed_on

    def _wait(self, step: LiveStep, count: int) -> None:
        """Let the samples that `count` events complete wait; where that ends the first contact, begin with them."""
        intake, contact, behind = self.intake, step.contact, step.behind
        admitted = intake.admitted - self.held_back - self.dropped - self.overrun
        try:
            step.run(count, learn=self.learn, most=0)
            if contact is None:
                self._arrived.extend([time.perf_counter_ns()] * (step.behind - behind))
                self._let_go(step)
            elif step.contact is None:
                self._room = step.behind + QUEUES * self.queue_depth
        except FrictionEstimatorError:
            self._connect(None)  # no estimator, nothing to wait for; the builder says why
        finally:
            if contact is not None and (self._step is None or step.contact is None):
                self._dropped += contact.dropped
            self.lost += intake.admitted - self.held_back - self.dropped - self.overrun - admitted
            self._look()
        if contact is not None:
            self.work_off()

    def _let_go(self, step: LiveStep) -> None:
        """Drop the oldest of a backlog that has outgrown its room; what it is worked off by is room no more."""
        surplus = step.behind - self._room
        if surplus > 0:
            step.let_go(surplus)
            self.overrun += surplus
            for _ in range(len(self._arrived) - step.behind):
                self._arrived.popleft()
        least = QUEUES * self.queue_depth
        self._room = max(least, min(self._room, step.behind + least))

    def _look(self) -> None:
        """Note how many samples were admitted, what waits for a partner, and whether positions are velocities."""
        self._admitted, pairer = self.intake.admitted, self.intake.pairer
        self._waiting, self._tracks = pairer.waiting, pairer.tracks

    def breathe(self) -> None:
        """Note that timers are served; to be called ten times a second or more.

        The executor hands over all messages of a topic that wait before it turns to timers and services. Where each
        takes longer than the next is away, that would never end: so if this is not called for a while, samples are
        only paired as they come and predicted by `work_off`, in pieces that leave time for everything else.
        """
        self._breath = time.perf_counter_ns()

    def work_off(self) -> None:
        """Predict some of the samples that waited; to be called again and again while `working_off`."""
        self._breath = time.perf_counter_ns()
        step = self._step
        now, admitted = time.monotonic(), self.intake.admitted
        piece = 1 + round((now - self._worked_off_at) * WORK_OFF_HZ) + 2 * (admitted - self._admitted_then)
        self._worked_off_at, self._admitted_then = now, admitted
        if step is None or not step.behind:
            self._breathless = False
            return
        behind, predictions = step.behind, self.predictions
        began = time.thread_time()
        most = min(piece, LARGEST_PIECE, int(LONGEST_PIECE_S / max(self.sample_s, 1e-9)))
        try:
            self._hand_on(step.work_off(max(most, 1), learn=self.learn))
        finally:
            self.lost += behind - step.behind - (self.predictions - predictions)
        done, ended = behind - step.behind, time.perf_counter_ns()
        # Of the processor, not of the clock: a thread that was kept from it while others ran would take its samples for
        # slow, work off one at a time, and fall behind where it has time for thousands. The first samples after a gap
        # are not learned from, and say nothing of the time that the others take.
        self.sample_s = max((time.thread_time() - began) / max(done, 1), REMEMBERED * self.sample_s)
        # What waited for the first contact is not late, and comes first.
        for _ in range(len(self._arrived) - step.behind):
            self._load.note(ended - self._arrived.popleft())

    # --- settings and counters ---------------------------------------------------------------------------------

    def retune(self, config: Config) -> None:
        """Pair by other settings from now on; whatever waits goes on waiting, whatever was counted stays."""
        self.flush()
        self.intake.retune(config)
        if self._step is not None:
            self._step.retuned()
        self._look()

    @property
    def counts(self) -> dict[str, int]:
        """Samples by reason (`used` among them), and the breaks in time: `gaps` and `jumps`."""
        total: dict[str, int] = {}
        sequencer = self.intake.sequencer
        for reason, count in {**self.intake.counts, "gaps": sequencer.gaps, "jumps": sequencer.jumps}.items():
            total[reason] = total.get(reason, 0) + count
        return total

    def restart(self) -> None:
        """Let the next sample restart the delay lines; what was learned stays."""
        self.flush()
        self.intake.restart()
        self._look()
