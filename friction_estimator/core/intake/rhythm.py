"""The rhythm of a topic's stamps, and the messages that are missing from it.

Nothing tells a subscriber that the middleware dropped a message; only the stamps of those that came show it.
"""

from collections.abc import Sequence

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Floats

LEAST_STAMPS = 20
"""Stamps from which a period is read."""

TOLERANCE, MOST = 0.35, 0.6
"""A topic has a rhythm where at least this share of its steps lies within the tolerance of their median: a driver that
stamps in bursts has none, one that misses every third message still does."""

FOLLOWED = 0.25
"""A change of the period up to this share of it is followed at once, as is a shorter one."""

SLOWER_LOOKS = 10
"""Looks after which a longer period is the new rhythm: every second message missing looks the same at first."""

UNUSUAL = 0.5
"""Share of the period by which a step must differ from it to say anything."""

PAUSE_S, PAUSE_PERIODS = 1.0, 20.0
"""A longer step is a publisher that paused, and not that many lost messages."""


class Rhythm:
    """How regularly a topic is stamped, and how many of its messages never arrived.

    Attributes
    ----------
    period_ns : time between two stamps, ns; NaN until a rhythm was seen.
    missing : messages that the rhythm asks for and that never came.

    Examples
    --------
    >>> rhythm = Rhythm()
    >>> rhythm.look([k * 1_000_000 for k in range(1, 1000) if k % 10])
    99
    >>> rhythm.period_ns
    1000000.0
    """

    def __init__(self) -> None:
        self.period_ns = float("nan")
        self.missing = 0
        self._waiting: list[int] = []
        self._slower = 0

    def restart(self) -> None:
        """Take the next stamp for the first: some were not handed over."""
        self._waiting = []

    def look(self, stamps_ns: Sequence[int], *, pauses: bool = True) -> int:
        """Return how many messages are missing among these, and between them and the ones before.

        Parameters
        ----------
        stamps_ns : of the messages that came since the last look, in order of arrival; zeros are passed over.
        pauses : False where a long step cannot be the publisher's pause, since the subscriber itself stood still.
        """
        self._waiting += [stamp for stamp in stamps_ns if stamp]
        if len(self._waiting) < LEAST_STAMPS:
            return 0
        stamps = np.array(self._waiting, np.int64)
        jumps = np.flatnonzero(np.diff(stamps) <= -PAUSE_S * NS_PER_S) + 1
        parts = np.split(stamps, jumps)
        self._waiting = [int(parts[-1].max())]
        # In order of time; none across a jump back of the clock, none of zero.
        steps = np.concatenate([np.diff(np.sort(part)) for part in parts]).astype(np.float64)
        steps = steps[steps > 0.0]
        if steps.size < LEAST_STAMPS // 2:
            return 0
        self._follow(steps)
        if np.isnan(self.period_ns):
            return 0
        if pauses:
            steps = steps[steps <= max(PAUSE_S * NS_PER_S, PAUSE_PERIODS * self.period_ns)]
        late = steps / self.period_ns - 1.0
        surplus, deficit = float(late[late > UNUSUAL].sum()), -float(late[late < -UNUSUAL].sum())
        # A stamp that is late makes the one after it early: where both are common, that is jitter.
        if surplus < 2.0 * deficit + UNUSUAL:
            return 0
        missing = max(0, round(float(late.sum())))
        self.missing += missing
        return missing

    def _follow(self, steps: Floats) -> None:
        """Follow the period where these steps have one."""
        usual = np.median(steps)
        near = steps[np.abs(steps - usual) <= TOLERANCE * usual]
        if near.size < MOST * steps.size:
            return
        period = float(near.mean())
        if period > (1.0 + FOLLOWED) * self.period_ns:  # false for NaN
            self._slower += 1
            if self._slower < SLOWER_LOOKS:
                return
        self._slower = 0
        self.period_ns = period
