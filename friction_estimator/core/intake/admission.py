"""The one way from messages to samples: pairing, sign, admission, turns, load. The live node and replay go it alike."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from friction_estimator.core.intake.acceleration import AccelerationFilter
from friction_estimator.core.intake.encoder import Encoder
from friction_estimator.core.intake.pairing import AGE, POSITION, PRESSURE, USED, Pairer, Pairs, Sequencer
from friction_estimator.core.intake.position import CarriedPosition, PositionIntegral
from friction_estimator.core.model.load import LoadTerms
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config


class Intake:
    """Turn stamped events in arrival order into admitted `Samples`.

    A JointState message is two events of equal stamp, so it needs no path of its own.

    Parameters
    ----------
    config : `sync.*`, `input.friction_sign`, `input.velocity_from`, `input.velocity_gain` and `load.*` are read.
    capacity : messages kept per stream while they wait for a partner; `sync.queue` unless given.

    Attributes
    ----------
    sign : 1 or -1, what measured friction is multiplied with.
    load : the load terms; what is known of them is taken off the measured effort.

    Examples
    --------
    >>> from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
    >>> intake = Intake(Config())
    >>> len(intake.push(VELOCITY, 5, 0.1)), len(intake.push(FRICTION, 5, 3.0))
    (0, 1)
    >>> intake.counts
    {'used': 1}
    """

    def __init__(self, config: Config, capacity: int | None = None) -> None:
        self.pairer = Pairer(config.sync, capacity)
        self.sequencer = Sequencer(config.sync)
        self.encoder, self.carried = Encoder(), CarriedPosition()
        self.sign = float(config.input.friction_sign)
        self.pairer.follow(config.input)
        self.load = LoadTerms(config)
        self._position = PositionIntegral() if self.load.needs("position") else None
        width = config.load.half_width
        self._acceleration = AccelerationFilter(width) if self.load.needs("acceleration") else None

    @property
    def admitted(self) -> int:
        """Samples handed out: those that wait for their acceleration are not among them."""
        return self.sequencer.admitted - (self._acceleration.waiting if self._acceleration else 0)

    @property
    def plain(self) -> bool:
        """Whether samples are handed out as they are paired: there is no load."""
        return not (self.load.unknown or self.load.known)

    def retune(self, config: Config) -> None:
        """Take over other settings; nothing that waits, was counted or is known of the past is lost.

        What holds on to `Pairer.arguments` or `Sequencer.arguments` has to ask for them again.
        """
        self.pairer.retune(config.sync)
        self.sequencer.retune(config.sync)
        self.sign = float(config.input.friction_sign)
        self.pairer.follow(config.input)

    def push(self, stream: ArrayLike, stamp_ns: ArrayLike, value: ArrayLike) -> Samples:
        """Take events (see `Pairer.push`); return the samples that they complete and that are admitted.

        Channels that have brought no value yet are NaN.
        """
        return self.admit(self.pairer.push(stream, stamp_ns, value))

    def admit(self, pairs: Pairs) -> Samples:
        """Return what is admitted of joined samples, in order."""
        status, restart = self.sequencer.admit(pairs.stamp_ns, pairs.velocity_m_s, pairs.friction_N)
        used = status == USED
        stamp_ns, velocity_m_s, friction_N, held = pairs.stamp_ns, pairs.velocity_m_s, pairs.friction_N, pairs.held
        begins = restart
        if not used.all():
            stamp_ns, velocity_m_s, friction_N, held = (each[used] for each in vars(pairs).values())
            begins = restart[used]
        position_m, age_s = held[:, POSITION - PRESSURE].copy(), held[:, AGE].copy()
        samples = Samples(
            stamp_ns=stamp_ns,
            velocity_m_s=velocity_m_s,
            friction_N=self.sign * friction_N,
            restart=begins,
            pressure_Pa=np.ascontiguousarray(held[:, 0]),
            temperature_degC=np.ascontiguousarray(held[:, 1]),
            position_shift_m=self.encoder.push(stamp_ns, velocity_m_s, begins, position_m),
            position_m=position_m,
        )
        self.carried.push(stamp_ns, velocity_m_s, begins, position_m, age_s)
        if self._position is not None:
            self._position.fill(stamp_ns, velocity_m_s, begins, position_m)
        return self._unloaded(samples if self._acceleration is None else self._acceleration.push(samples))

    def drain(self) -> Samples | None:
        """Return the samples that wait for their acceleration, at the end of a recording; None where none can wait."""
        return None if self._acceleration is None else self._unloaded(self._acceleration.drain())

    def _unloaded(self, samples: Samples) -> Samples:
        """Return the samples with the known load taken off."""
        if not self.load.known:
            return samples
        return replace(samples, friction_N=samples.friction_N - self.load.known_N(samples))

    def flush(self) -> None:
        """Count what still waits for a partner as dropped (end of a recording, reset)."""
        self.pairer.flush()

    def restart(self) -> None:
        """Let the next sample restart the delay lines (reset); the counters stay."""
        self.pairer.flush()
        self.sequencer.forget()

    @property
    def counts(self) -> dict[str, int]:
        """Samples by reason, `used` among them: each joined sample counts once, each message never joined once."""
        total = dict(self.sequencer.counts)
        for reason, count in self.pairer.dropped.items():
            total[reason] = total.get(reason, 0) + count
        return total
