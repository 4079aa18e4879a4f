"""The one way from messages to samples: pairing, sign, admission, turns. Used by the live node and by replay alike."""

import numpy as np
from numpy.typing import ArrayLike

from friction_estimator.core.intake.encoder import Encoder
from friction_estimator.core.intake.pairing import POSITION, PRESSURE, USED, Pairer, Pairs, Sequencer
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config


class Intake:
    """Turn stamped events in arrival order into admitted `Samples`.

    A JointState message is two events of equal stamp, so it needs no path of its own.

    Parameters
    ----------
    config : `sync.*` and `input.friction_sign` are read.
    capacity : messages kept per stream while they wait for a partner; `sync.queue` unless given.

    Attributes
    ----------
    sign : 1 or -1, what measured friction is multiplied with.

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
        self.encoder = Encoder()
        self.sign = float(config.input.friction_sign)

    def retune(self, config: Config) -> None:
        """Take over other settings; nothing that waits, was counted or is known of the past is lost.

        What holds on to `Pairer.arguments` or `Sequencer.arguments` has to ask for them again.
        """
        self.pairer.retune(config.sync)
        self.sequencer.retune(config.sync)
        self.sign = float(config.input.friction_sign)

    def push(self, stream: ArrayLike, stamp_ns: ArrayLike, value: ArrayLike) -> Samples:
        """Take events (see `Pairer.push`); return the samples that they complete and that are admitted.

        Channels that have brought no value yet are NaN.
        """
        return self.admit(self.pairer.push(stream, stamp_ns, value))

    def admit(self, pairs: Pairs) -> Samples:
        """Return what is admitted of joined samples, in order."""
        status, restart = self.sequencer.admit(pairs.stamp_ns, pairs.velocity_m_s, pairs.friction_N)
        used = status == USED
        held = pairs.held[used]
        stamp_ns, velocity_m_s, begins = pairs.stamp_ns[used], pairs.velocity_m_s[used], restart[used]
        position_m = held[:, POSITION - PRESSURE].copy()
        return Samples(
            stamp_ns=stamp_ns,
            velocity_m_s=velocity_m_s,
            friction_N=self.sign * pairs.friction_N[used],
            restart=begins,
            pressure_Pa=np.ascontiguousarray(held[:, 0]),
            temperature_degC=np.ascontiguousarray(held[:, 1]),
            position_shift_m=self.encoder.push(stamp_ns, velocity_m_s, begins, position_m),
            position_m=position_m,
        )

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
