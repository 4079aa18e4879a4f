"""Time of a playback: rate, pause, jump, single steps, and what /clock tells meanwhile."""

import random
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.sample import NS_PER_S

pytest.importorskip("rclpy")  # its room imports it elsewhere

from friction_estimator.ros.playback_clock import PlaybackClock
from friction_estimator.ros.playback_control import PlaybackControl, Turn

ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("wait"), st.floats(0.0, 100.0)),
        st.tuples(st.just("set_rate"), st.floats(0.01, 1000.0)),
        st.tuples(st.sampled_from(["pause", "resume"])),
    ),
    max_size=30,
)


@given(ACTIONS)
def test_time_is_the_sum_of_what_ran(actions):
    now = 0.0
    clock = PlaybackClock(5, rate=1.0, steady_s=lambda: now)
    expected, rate, paused = 5.0, 1.0, True
    for name, *argument in actions:
        if name == "wait":
            now += argument[0]
            expected += 0.0 if paused else argument[0] * rate * NS_PER_S
        else:
            getattr(clock, name)(*argument)
            rate = argument[0] if argument else rate
            paused = paused if argument else name == "pause"
    assert clock.now_ns == pytest.approx(expected, rel=1e-9, abs=10 * len(actions) + 1)


def test_what_a_pause_held_up_does_not_come_in_a_burst():
    now = 0.0
    clock = PlaybackClock(0, rate=2.0, steady_s=lambda: now)
    clock.resume()
    clock.pause()
    now = 100.0
    clock.resume()
    assert clock.left_s(NS_PER_S) == pytest.approx(0.5)


class Run:
    """A playback of messages at 100 Hz, which notes what is told and played, in this order."""

    def __init__(self, seconds=1.0, rate=10.0, **options):
        self.events = []
        self.messages = [k * NS_PER_S // 100 for k in range(round(100 * seconds))]
        self.end = round(seconds * NS_PER_S)
        self.loop = options.get("loop", False)
        self.control = PlaybackControl(
            PlaybackClock(0, rate), 0, self.end, tick_hz=200.0,
            tell_time=lambda now: self.events.append(("clock", now)), **options,
        )  # fmt: skip
        self.thread = threading.Thread(target=self.play)

    def play(self):
        control, turn = self.control, Turn.MOVED
        control.begin()
        while turn is Turn.MOVED:
            turn = Turn.DUE
            for stamp in [stamp for stamp in self.messages if stamp >= control.from_ns]:
                turn = control.wait_until(stamp)
                if turn is not Turn.DUE:
                    break
                self.events.append(("message", stamp))
                control.played()
            if turn is Turn.DUE:
                turn = control.wait_until(self.end - 1, end=True)
            if turn is Turn.DUE and self.loop:
                control.rewind()
                turn = Turn.MOVED
            if turn is Turn.MOVED:
                self.events.append(("jump", control.from_ns))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.control.stop()
        self.thread.join(10.0)
        assert not self.thread.is_alive()

    def played(self):
        return [stamp for kind, stamp in self.events if kind == "message"]

    def await_begun(self):
        deadline = time.monotonic() + 30.0
        while not self.control.begun:
            assert time.monotonic() < deadline
            time.sleep(0.002)

    def await_played(self, count):
        deadline = time.monotonic() + 30.0
        while len(self.played()) < count:
            assert time.monotonic() < deadline
            time.sleep(0.002)


def test_it_plays_all_of_it_once_and_ends():
    with Run() as run:
        run.thread.join(30.0)
        assert run.played() == run.messages
        ticks = [stamp for kind, stamp in run.events if kind == "clock"]
        assert ticks == [k * NS_PER_S // 20 for k in range(20)]  # 200 Hz at ten times the speed


def test_steps_play_one_message_each_and_tell_its_time_before():
    run = Run()
    run.control.pause()
    with run:
        assert run.played() == []
        assert [run.control.play_next() for _ in range(5)] == [True] * 5
        assert run.played() == run.messages[:5]
        for k, (kind, stamp) in enumerate(run.events):
            if kind == "message":
                assert [event for event in run.events[:k] if event[0] == "clock"][-1] == ("clock", stamp)
        assert run.control.position_ns == run.messages[4]
        run.control.resume()
        assert not run.control.play_next()
        run.thread.join(30.0)
        assert run.played() == run.messages  # none twice, none left out


def test_a_jump_in_a_pause_stays_paused_there():
    run = Run()
    run.control.pause()
    with run:
        assert run.control.seek(NS_PER_S // 2)
        assert run.control.play_next()
        assert run.played() == [NS_PER_S // 2]  # the message at that very time is the first
        assert run.control.seek(-1)  # before the start is the start, as in rosbag2
        assert run.control.play_next()
        assert run.played()[1:] == [0]
        assert not run.control.seek(NS_PER_S)
        assert run.control.seek(NS_PER_S - 1)  # after the last message
        assert not run.control.play_next()
        run.control.resume()
        run.thread.join(30.0)
        assert not run.thread.is_alive()


def test_what_is_asked_in_vain_is_not_done_later():
    """A step that is asked for before the playback begins, and a jump after its end."""
    run = Run(step_s=0.5)
    run.control.pause()
    assert not run.control.play_next()
    with run:
        run.await_begun()
        assert run.control.play_next()
        assert run.played() == [0]
    assert not run.control.seek(0)


def test_steps_go_round_in_a_loop():
    run = Run(seconds=0.02, loop=True)
    run.control.pause()
    with run:
        assert all(run.control.play_next() for _ in range(5))
        assert run.played() == [0, 10_000_000, 0, 10_000_000, 0]


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e7])
def test_a_rate_that_is_none_is_refused(rate):
    run = Run()
    assert not run.control.set_rate(rate)
    assert run.control.rate == 10.0


@pytest.mark.parametrize("seed", range(4))
def test_the_clock_never_goes_back_but_for_a_jump_nor_lags_a_message(seed):
    """Loop, pause, steps, rates and jumps in any order."""
    rng = random.Random(seed)
    with Run(loop=True) as run:
        for _ in range(60):
            act = rng.choice(["pause", "resume", "toggle_paused", "play_next", "set_rate", "seek"])
            argument = {"set_rate": [rng.uniform(1.0, 30.0)], "seek": [rng.randrange(-10, run.end)]}.get(act, [])
            getattr(run.control, act)(*argument)
            time.sleep(rng.uniform(0.0, 0.01))  # anywhere in a message's time
        run.control.resume()
        run.await_played(len(run.played()) + 150)
    told = last_message = None
    for (kind, stamp), following in zip(run.events, [*run.events[1:], ("", 0)], strict=True):
        if kind == "jump":
            last_message = None
        elif kind == "clock":
            # A jump is told before the player goes there.
            assert told is None or stamp >= told or following == ("jump", stamp)
            told = stamp
        else:
            assert told <= stamp <= told + 30.0 * NS_PER_S / 200.0
            assert last_message is None or stamp == last_message + NS_PER_S // 100  # none left out, none twice
            last_message = stamp
