"""What may be asked of a playback while it runs, from any thread, and the wait for what is due."""

import threading
import time
from collections.abc import Callable
from enum import Enum, auto

from friction_estimator.core.sample import NS_PER_S
from friction_estimator.ros.playback_clock import PlaybackClock

NAP_S = 0.1
"""Longest wait at a time: bounds how late a wish to stop is noticed."""

STEP_S = 5.0
"""Longest wait of whoever asks for the next message; reading it may take that long on a damaged or distant disk."""

FASTEST = 1e6
"""Highest rate, as fast as messages can be read and sent."""


class Turn(Enum):
    """How a wait ended."""

    DUE = auto()
    MOVED = auto()
    """Somebody jumped: go on with the messages from `PlaybackControl.from_ns`."""
    STOPPED = auto()


class PlaybackControl:
    """Pause, rate, jump and single steps of one playback.

    The player waits here for every message (`wait_until`) and says when it is out (`played`); all else may be called by
    any thread. The time is told on a grid of the recording's own time, anew from each jump; while the clock stands the
    same time is told again and again, and a single step tells the time of its message before that is out. So a
    subscriber never sees a stamp ahead of the clock, nor a clock that goes back but for a jump.

    Parameters
    ----------
    clock : stands until `begin`.
    start_ns, end_ns : part of the recording that is played.
    loop : whether the start follows the end.
    tick_hz : how often the time is told, 0 for never.
    tell_time : takes the time in the recording, ns.
    step_s : longest wait of whoever asks for the next message.

    Attributes
    ----------
    from_ns : where the last jump led to, or the start.
    """

    def __init__(
        self,
        clock: PlaybackClock,
        start_ns: int,
        end_ns: int,
        *,
        loop: bool = False,
        tick_hz: float = 0.0,
        tell_time: Callable[[int], None] = lambda _: None,
        step_s: float = STEP_S,
    ) -> None:
        self._clock, self._start_ns, self._end_ns, self._loop = clock, start_ns, end_ns, loop
        self._tick_hz, self._tell_time, self._step_s = tick_hz, tell_time, step_s
        self._next_tick_ns, self._tell_again_s = start_ns, 0.0
        self.from_ns = start_ns
        self._changed = threading.Condition()
        self._begun = self._stopping = self._at_end = False
        self._hold = False
        self._seek_ns: int | None = None
        self._asked = self._stepped = 0

    # --- asked by anybody --------------------------------------------------------------------------------------

    @property
    def rate(self) -> float:
        """Seconds of the recording in a second."""
        return self._clock.rate

    @property
    def paused(self) -> bool:
        """Whether nothing is played until `resume`, but for single steps."""
        return self._hold

    @property
    def stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._stopping

    @property
    def begun(self) -> bool:
        """Whether the first message is due, or was."""
        return self._begun

    @property
    def position_ns(self) -> int:
        """Time in the recording, ns."""
        with self._changed:
            return min(self._clock.now_ns, self._end_ns)

    def stop(self) -> None:
        """End the playback at the next message; may be called by a signal handler.

        A flag, not an exception: one that is raised while a message is being published or an object is cleared away
        can get lost there.
        """
        self._stopping = True

    def pause(self) -> None:
        """Stand still."""
        self._pause(True)

    def resume(self) -> None:
        """Go on."""
        self._pause(False)

    def toggle_paused(self) -> None:
        """Stand still, or go on."""
        with self._changed:
            self._pause(not self._hold)

    def _pause(self, hold: bool) -> None:
        with self._changed:
            self._hold = hold
            self._asked = self._stepped
            if self._begun:
                (self._clock.pause if hold else self._clock.resume)()
            self._changed.notify_all()

    def set_rate(self, rate: float) -> bool:
        """Play at another speed; False, and no change, where it is none."""
        if not 0.0 < rate <= FASTEST:
            return False
        with self._changed:
            self._clock.set_rate(rate)
            self._changed.notify_all()
        return True

    def seek(self, to_ns: int) -> bool:
        """Go on with the messages from this time, from the start where it is before that; False beyond the end.

        False, too, where the playback has ended.
        """
        if to_ns >= self._end_ns or self._stopping:
            return False
        with self._changed:
            self._seek_ns = max(to_ns, self._start_ns)
            self._changed.notify_all()
        return True

    def play_next(self) -> bool:
        """Play the next message; return when it is out, False where there is none or nothing is paused."""
        with self._changed:
            if not self._hold:
                return False
            self._asked += 1
            ticket = self._asked
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._stepped >= ticket or self._refuses_steps, self._step_s)
            done = self._stepped >= ticket
            if not done:  # withdrawn: what was refused shall not be played later
                self._asked = max(self._stepped, self._asked - 1)
            return done

    @property
    def _refuses_steps(self) -> bool:
        return self._stopping or not self._hold or self._at_end

    # --- asked by the player -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Let the time run, unless it is to stand."""
        with self._changed:
            self._begun = True
            self._clock.jump(self._start_ns)
            self._pause(self._hold)

    def rewind(self) -> None:
        """Jump to the start."""
        with self._changed:
            self._jump(self._start_ns)

    def wait_until(self, due_ns: int, *, end: bool = False) -> Turn:
        """Wait for this time in the recording, and tell the time meanwhile.

        Parameters
        ----------
        due_ns : of the next message.
        end : there is no next message; `due_ns` is where the playback ends.
        """
        clock = self._clock
        with self._changed:
            self._at_end = end and not self._loop
            while not self._stopping:
                if self._seek_ns is not None:
                    to_ns, self._seek_ns = self._seek_ns, None
                    self._jump(to_ns)
                    return Turn.MOVED
                if clock.paused:
                    if clock.now_ns > due_ns:  # the machine is late: the clock shall not be ahead of what is not out
                        clock.jump(due_ns)
                    if self._asked > self._stepped:
                        if not end:
                            clock.jump(due_ns)
                            self._tick(due_ns)
                            return Turn.DUE
                        if self._loop:
                            return Turn.DUE
                        self._asked = self._stepped
                        self._changed.notify_all()
                    wait_s = self._tell_standing()
                else:
                    next_ns = min(due_ns, self._tell_passed(due_ns))
                    wait_s = clock.left_s(next_ns)
                    if next_ns == due_ns and wait_s <= 0.0:
                        return Turn.DUE
                self._changed.wait(min(max(wait_s, 0.0), NAP_S))
            return Turn.STOPPED

    def played(self) -> None:
        """Note that the message that was due is out."""
        if self._asked > self._stepped:
            with self._changed:
                self._stepped += 1
                self._changed.notify_all()

    # --- the time that is told ---------------------------------------------------------------------------------

    def _jump(self, to_ns: int) -> None:
        self._clock.jump(to_ns)
        self._next_tick_ns = self.from_ns = to_ns
        self._tick(to_ns)

    def _tick(self, now_ns: int) -> None:
        """Tell the time; the next tick is the first on the grid after it."""
        if not self._tick_hz:
            return
        self._tell_time(now_ns)
        self._tell_again_s = time.monotonic() + 1.0 / self._tick_hz
        period_ns = max(1, round(NS_PER_S * self._clock.rate / self._tick_hz))
        if self._next_tick_ns <= now_ns:
            self._next_tick_ns += ((now_ns - self._next_tick_ns) // period_ns + 1) * period_ns

    def _tell_passed(self, until_ns: int) -> int:
        """Tell each time of the grid that has passed, up to this one; return the next that has not."""
        if not self._tick_hz:
            return until_ns
        while self._next_tick_ns <= until_ns and self._clock.left_s(self._next_tick_ns) <= 0.0 and not self._stopping:
            self._tick(self._next_tick_ns)
        return self._next_tick_ns

    def _tell_standing(self) -> float:
        """Tell the time again where that is due while it stands; return how long nothing is to be told, s."""
        if not self._tick_hz:
            return NAP_S
        if time.monotonic() >= self._tell_again_s:
            self._tick(self._clock.now_ns)
        return self._tell_again_s - time.monotonic()
