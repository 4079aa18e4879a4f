"""`watch` beside a running node: it shows what the node predicts, is there for this machine only, and neither ends the
other."""

import base64
import contextlib
import http.client
import re
import signal
import socket
import struct
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("bokeh")

import ros_graph
from browser import Browser, needs_browser
from geometry_msgs.msg import WrenchStamped
from ros_graph import Feeder, await_, force, motion
from terminal import Terminal

from friction_estimator.report.live.page import interrupted
from friction_estimator.report.live.seen import Seen

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"

WORDS = """(() => {
  const find = (root, name) => {
    for (const each of root.querySelectorAll("*")) {
      if (each.matches(name)) return each.innerText;
      const inside = each.shadowRoot && find(each.shadowRoot, name);
      if (inside) return inside;
    }
  };
  return [find(document, ".light"), find(document, ".facts")].join("|");
})()"""

DRAWN = "Bokeh.documents[0].get_model_by_name('samples').data.predicted.length"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


class Rig:
    """A node, and samples fed to it in their own time, and no faster than it predicts them.

    Faster than a machine would send them they take the processor from what should show them, and come to their end.
    """

    RATE_HZ = 500.0

    def __init__(self, graph):
        self.graph = graph
        self.node = graph.start_node()
        self.predicted = graph.hear(WrenchStamped, f"{NODE}/friction_predicted", raw=True)
        self.feeder = Feeder(graph)
        self.samples = list(zip(*(values.tolist() for values in motion(100_000, self.RATE_HZ)), strict=True))
        self.sent, self.due_s = 0, 0.0
        self.connected()

    def connected(self):
        self.graph.heard_by(f"{NODE}/friction_predicted")
        self.feeder.matched()

    def feed(self, count=50):
        await_(lambda: time.monotonic() >= self.due_s, "the time of the samples")
        self.due_s = time.monotonic() + count / self.RATE_HZ
        before = len(self.predicted)
        for sample in self.samples[self.sent : self.sent + count]:
            self.feeder.pair(*sample)
        self.sent += count
        await_(lambda: len(self.predicted) >= before + count, "the predictions")
        return True


def watch(graph):
    process = graph.start("-m", "friction_estimator", "watch", "--port", "0")
    process.says("shows")
    return process, re.search(r"http://127\.0\.0\.1:(\d+)/", process.output())[0]


def opened(browser, address):
    browser.call("Page.navigate", url=address)
    await_(lambda: browser.js("typeof Bokeh === 'object' && Bokeh.documents.length"), "the page")


def shows(browser, prediction, limit_s=2.0):
    """Return whether the page comes to show a prediction; those made before it listened to the node never appear."""
    words, end = f"stamp {force(prediction)[0] / 1e9:.3f}", time.monotonic() + limit_s
    while words not in browser.js(WORDS):
        if time.monotonic() > end:
            return False
    return True


def port_of(address):
    return int(address.rsplit(":", 1)[1].strip("/"))


def test_nothing_is_drawn_over_a_gap_wherever_the_batches_end():
    row = np.array([0.0, 0.1, 3.0, 2.9, 0.2])
    times = np.array([0.0, 0.1, 2.0, 2.1])
    rows = row + np.outer(times, [1.0, 0.0, 0.0, 0.0, 0.0])
    for cut in (0, 1, 2, 3):  # the gap lies inside the second batch, between the two, or inside the first
        first = interrupted(rows[:0], rows[:cut])
        second = interrupted(rows[max(0, cut - 1) : cut], rows[cut:])
        drawn = {name: np.concatenate([first[name], second[name]]) for name in first}
        np.testing.assert_allclose(drawn["time"], [0.0, 0.1, 0.1, 2.0, 2.0, 2.1])
        inside = np.isnan(drawn["predicted"])
        assert np.flatnonzero(inside).tolist() == [2, 3]
        for name in ("velocity", "measured", "residual"):
            assert np.array_equal(np.isnan(drawn[name]), inside)
        assert np.array_equal(drawn["low"] == drawn["high"], inside)


@needs_browser
def test_the_page_shows_what_the_node_predicts_whoever_dies(graph, tmp_path):
    rig = Rig(graph)
    process, address = watch(graph)
    with Browser(tmp_path / "profile", local=True) as browser:
        opened(browser, address)
        await_(lambda: rig.feed() and "newest sample" in browser.js(WORDS), "rows on the page")
        stamp_ns, value = force(rig.predicted[-1])
        await_(lambda: f"stamp {stamp_ns / 1e9:.3f}" in browser.js(WORDS), "the newest sample")
        assert f"{value:.4g} N" in browser.js(WORDS)
        await_(lambda: browser.js(DRAWN) > 10, "lines")

        rig.node.stop(signal.SIGKILL)
        await_(lambda: "no node publishes" in browser.js(WORDS), "that the node is gone")
        rig.node = graph.start_node()
        rig.connected()
        await_(lambda: rig.feed() and "no node" not in browser.js(WORDS), "the next node")
        await_(lambda: rig.feed() and shows(browser, rig.predicted[-1]), "its samples")

        harmless = (
            "asks for http://127.0.0.1",
            "favicon",
            "could not set initial ranges",
        )  # the last: nothing to draw yet
        assert not [line for line in browser.complaints() if not any(words in line for words in harmless)]
        process.stop(signal.SIGKILL)
        await_(lambda: graph.probe.count_subscribers(f"{NODE}/monitor") == 0, "that nobody looks")
        for _ in range(5):
            rig.feed()
    assert rig.node.stop() == 0
    assert "error" not in rig.node.output().lower()


def test_it_is_there_for_this_machine_only(graph):
    """One socket at 127.0.0.1; a page of another site may not read it through the browser."""
    process, address = watch(graph)
    port = port_of(address)
    listening = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{process.pid}/net/{table}").read_text().splitlines()[1:]:
            local, state = line.split()[1], line.split()[3]
            if state == "0A" and int(local.split(":")[1], 16) == port:
                listening.add(local.split(":")[0])
    assert listening == {f"{struct.unpack('<I', socket.inet_aton('127.0.0.1'))[0]:08X}"}

    def answer(origin):
        """Return the status with which a websocket for a page of this origin is answered."""
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ros_graph.LIMIT_S)
        wish = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
        key = base64.b64encode(bytes(16)).decode()
        with contextlib.closing(connection):
            connection.request("GET", "/ws", headers={**wish, "Sec-WebSocket-Key": key, "Origin": origin})
            return connection.getresponse().status

    for origin in ("http://example.com", "http://127.0.0.1:1", f"https://localhost.example:{port}"):
        assert answer(origin) == 403
    assert answer(f"http://127.0.0.1:{port}") == answer(f"http://localhost:{port}") == 101
    assert process.stop() == 0


def test_a_taken_port_is_one_line(graph):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        process = graph.start("-m", "friction_estimator", "watch", "--port", str(port))
        assert process.popen.wait(ros_graph.LIMIT_S) == 2
    assert f"port {port} of 127.0.0.1" in process.output()
    assert "--port" in process.output()
    assert len(process.output().strip().splitlines()) == 1


def test_the_screen_of_text(graph):
    pytest.importorskip("rich")
    rig = Rig(graph)
    command = [sys.executable, "-m", "friction_estimator", "watch", "--terminal"]
    with Terminal(command, graph.environment()) as terminal:
        terminal.await_(lambda screen: "has not predicted anything yet" in screen, "the node")
        terminal.await_(lambda screen: rig.feed() and "predicted (yellow)" in screen, "signals")
        terminal.await_(lambda screen: rig.feed() and "learned curve" in screen, "the curve")
        terminal.await_(lambda screen: rig.feed() and "running error rms" in screen, "the error")
        assert any(0x2800 < ord(character) < 0x2900 for character in terminal.screen())
        terminal.press(b"\x03")
        assert terminal.ended() == 0
        assert terminal.mode() == terminal.untouched
        assert "\x1b[?1049l" in terminal.screen()  # back from a screen of its own
    assert rig.node.stop() == 0


@pytest.mark.parametrize(("columns", "rows"), [(120, 40), (80, 25), (60, 20), (36, 18), (24, 12)])
def test_the_screen_of_text_fits_into_its_terminal(columns, rows):
    console = pytest.importorskip("rich.console").Console(width=columns)
    from friction_estimator.report.live.screen import picture

    time_s = 1.7e9 + np.arange(0.0, 30.0, 0.01)
    velocity = 0.0989512 * np.sin(time_s)
    measured = 3.0 * np.tanh(velocity / 0.005)
    seen = Seen(
        rows=np.column_stack([time_s, velocity, measured, measured, np.full(time_s.size, 0.1)]),
        silent_s=0.1,
        curve=np.column_stack([np.linspace(-0.1, 0.1, 50)] * 4),
        status="learning; the velocity range grew twice",
        values={"samples per second": "200.0", "learned part of the velocity range": "0.93", "other": "x"},
        publishers=1,
    )
    if rows == 40:  # what docs/first_rig.md asks to look at is there, on both views
        assert dict(seen.told) == {name: value for name, value in seen.values.items() if name != "other"}
    lines = console.render_lines(picture(seen, "/left/friction_estimator/elbow/monitor", columns, rows))
    text = ["".join(part.text for part in line) for line in lines]
    assert len(text) <= rows
    assert max(map(len, text)) <= columns
    assert any(line.rstrip().endswith(f"{velocity[-1]:.4g} m/s") for line in text)  # numbers are whole
    assert any("[N]" in line and " to " in line for line in text)  # and the range of what is drawn is told
    assert columns < 60 or any("measured (grey), predicted (yellow)" in line for line in text)


def test_a_rotary_drive_has_its_units_and_a_pipe_no_screen(graph):
    from friction_estimator.ros.monitor_feed import MonitorFeed

    graph.start_node({"input.motion": "rotary"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(graph.domain))
        with MonitorFeed("friction_estimator") as feed:
            assert feed.look().quantities.force == "N"
            await_(lambda: feed.look().quantities.force == "N m", "the unit of a torque")
            assert feed.look().silence == "the node is there, and has not predicted anything yet"
    piped = graph.start("-m", "friction_estimator", "watch", "--terminal")
    assert piped.popen.wait(ros_graph.LIMIT_S) == 2
    assert "stdout is none" in piped.output()
