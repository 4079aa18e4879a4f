"""The time in a recording while it is played: rate, pause, jump."""

import time
from collections.abc import Callable

from friction_estimator.core.sample import NS_PER_S


class PlaybackClock:
    """Maps a steady clock to the time in the recording.

    t = t_a + R (s - s_a) from an anchor (s_a, t_a) that each change of rate, pause and jump sets anew, so that the time
    in the recording is continuous but for a jump, and what a pause has held up does not come in a burst after it.

    Parameters
    ----------
    start_ns : time in the recording to begin at; the clock stands until `resume`.
    rate : seconds of the recording in a second.
    steady_s : the steady clock, s.

    Examples
    --------
    >>> s = 0.0
    >>> clock = PlaybackClock(1_000, rate=2.0, steady_s=lambda: s)
    >>> clock.resume(); s = 1.0; clock.now_ns
    2000001000
    >>> clock.set_rate(0.5); s = 2.0; clock.now_ns, clock.left_s(3_000_001_000)
    (2500001000, 1.0)
    >>> clock.pause(); s = 9.0; clock.now_ns
    2500001000
    """

    def __init__(self, start_ns: int, rate: float, steady_s: Callable[[], float] = time.perf_counter) -> None:
        self._steady_s = steady_s
        self._rate = rate
        self._paused = True
        self._anchor_s, self._anchor_ns = steady_s(), start_ns

    @property
    def rate(self) -> float:
        """Seconds of the recording in a second."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether the clock stands."""
        return self._paused

    @property
    def now_ns(self) -> int:
        """Time in the recording, ns."""
        if self._paused:
            return self._anchor_ns
        return self._anchor_ns + round((self._steady_s() - self._anchor_s) * self._rate * NS_PER_S)

    def left_s(self, until_ns: int) -> float:
        """Return how long it is to this time of the recording at the present rate, s; past: not above zero."""
        return (until_ns - self._anchor_ns) / (self._rate * NS_PER_S) - (self._steady_s() - self._anchor_s)

    def jump(self, to_ns: int) -> None:
        """Go to another time in the recording."""
        self._anchor_s, self._anchor_ns = self._steady_s(), to_ns

    def set_rate(self, rate: float) -> None:
        """Go on at another rate."""
        self.jump(self.now_ns)
        self._rate = rate

    def pause(self) -> None:
        """Stand still."""
        self.jump(self.now_ns)
        self._paused = True

    def resume(self) -> None:
        """Go on from where it stands."""
        self.jump(self.now_ns)
        self._paused = False
