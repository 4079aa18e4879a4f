"""`play` on a terminal: a bar, keys, and a terminal that is as it was, however the playback ends."""

import os
import signal
import sys
import termios
import tty

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_graph import ROOT
from terminal import Terminal

pytestmark = pytest.mark.ros
DEMO = str(ROOT / "bags" / "demo")
PLAY = [sys.executable, "-m", "friction_estimator", "play", DEMO, "--wait", "0"]


@pytest.fixture
def environment(tmp_path):
    with ros_graph.reserved_domain() as domain:
        yield {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(tmp_path),
        }


def place(screen):
    """Return the seconds of the recording that the bar shows last, as they are written."""
    return screen.rsplit(" of ", 1)[0].rsplit(" ", 1)[1]


def is_raw(terminal):
    return not terminal.mode()[tty.LFLAG] & termios.ICANON


def test_keys_pause_step_and_change_the_rate(environment):
    with Terminal([*PLAY, "--start-paused"], environment) as terminal:
        terminal.await_(lambda screen: "paused 1x" in screen and "0.000 of 22.0 s" in screen, "the bar")
        for count in range(1, 4):  # velocity, friction, position, ... of each of the samples, 5 ms apart
            terminal.press(b"n\x1b[Cn" * 5)
            terminal.await_(lambda screen, count=count: float(place(screen)) >= 0.02 * count, "steps")
        assert float(place(terminal.screen())) < 0.1
        terminal.press(b"++-\x1b[A")
        terminal.await_(lambda screen: "paused 1.21x" in screen, "another rate")
        terminal.press(b" ")
        terminal.await_(lambda screen: "playing 1.21x" in screen and float(place(screen)) > 0.3, "motion")
        terminal.press(b"q?\x1b[5~ ")  # what has no meaning does nothing
        terminal.await_(lambda screen: "paused" in screen[screen.rindex("playing 1.21x") :], "a pause")
        terminal.press(b"\x03")  # Ctrl-C
        assert terminal.ended() == 130
        assert terminal.mode() == terminal.untouched
        unheard = terminal.screen().split("nobody listens to")[1].splitlines()[0]
        assert "/friction, /position, /pressure" in unheard


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_the_terminal_is_given_back(environment, number):
    with Terminal([*PLAY, "--start-paused"], environment) as terminal:
        terminal.await_(lambda screen: "paused 1x" in screen, "the bar")
        assert is_raw(terminal)
        terminal.process.send_signal(number)
        assert terminal.ended() in (130, 128 + number, -number)
        assert terminal.mode() == terminal.untouched


def test_suspended_and_back(environment, tmp_path):
    """Ctrl-Z gives the terminal to the shell as the shell had it; `fg` takes it again."""
    line = f"{' '.join(PLAY)} --start-paused; stty -a > {tmp_path}/mode; fg"
    with Terminal(["bash", "-mc", line], {**environment}) as terminal:
        terminal.await_(lambda screen: "paused 1x" in screen, "the bar")
        assert is_raw(terminal)
        terminal.press(b"\x1a")
        terminal.await_(lambda _: (tmp_path / "mode").exists() and is_raw(terminal), "the return")
        assert " icanon" in (tmp_path / "mode").read_text()
        terminal.press(b" ")
        terminal.await_(lambda screen: "playing 1x" in screen, "a key's effect")
        terminal.press(b"\x03")
        terminal.ended()
        assert terminal.mode() == terminal.untouched


def test_in_the_background_it_plays_and_leaves_the_terminal_alone(environment):
    """Reading there would stop the process (SIGTTIN), and so would changing the mode (SIGTTOU)."""
    line = f"{' '.join(PLAY)} --duration 1 & wait; echo ended $?"
    with Terminal(["bash", "-mc", line], environment) as terminal:
        terminal.await_(lambda screen: "ended 0" in screen or is_raw(terminal), "the end")
        assert "ended 0" in terminal.screen()
        assert "played 620 messages" in terminal.screen()


def test_the_keyboard_may_be_left_alone(environment):
    with Terminal([*PLAY, "--duration", "1", "--disable-keyboard-controls"], environment) as terminal:
        terminal.await_(lambda screen: "playing 1x" in screen or is_raw(terminal), "the bar")
        assert not is_raw(terminal)
        assert "space" not in terminal.screen()
        assert terminal.ended() == 0


def test_quiet_is_quiet(environment):
    """As the demonstration plays, which prints lines of its own."""
    with Terminal([*PLAY, "--duration", "1", "--quiet"], environment) as terminal:
        assert terminal.ended() == 0
        assert terminal.screen() == ""
