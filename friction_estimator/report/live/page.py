"""The live page: bokeh's server on this machine only, one document a browser tab.

It binds to 127.0.0.1 and takes websockets of its own address alone, so neither another machine nor a page of another
site that is open in the same browser can read it. All scripts come from this server: no network is asked.
"""

import html
import socket
from collections.abc import Callable
from importlib.resources import files
from types import TracebackType
from typing import Any

import numpy as np
from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, CustomJS, DataRange1d, Div
from bokeh.server.server import Server
from jinja2 import Template
from tornado.ioloop import PeriodicCallback

from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Floats
from friction_estimator.report.live.seen import Look, Seen
from friction_estimator.report.page.look import INKS, Plot, band, chart, ink, line, parted

HERE = "127.0.0.1"

REDRAW_MS = 100

WINDOW_S = 10.0

KEPT_ROWS = 13_000
"""Rows in the browser: the window at the fastest that the node publishes."""

MAP_DOTS = 1500

GAP_S = 0.5
"""Between stamps farther apart no line is drawn."""

BAND_SIGMAS = 1.96

COLUMNS = ("time", "velocity", "measured", "predicted", "low", "high", "residual")

PAINT = """
"use strict";
(() => {  // charts take the style sheet's colours, light or dark
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const set = (model, names, value) => {  // here only: the server has other pages too
    for (const name of names) {
      if (name in model.properties && model[name] != null) model.setv({[name]: value}, {sync: false});
    }
  };
  function dress() {
    for (const drawn of Bokeh.documents) for (const model of drawn._all_models.values()) {
      for (const tag of model.tags) {
        if (String(tag).startsWith("ink:")) set(model, ["line_color", "fill_color"], colour(tag.slice(4)));
      }
      set(model, ["axis_label_text_color", "label_text_color"], colour("text"));
      set(model, ["major_label_text_color", "axis_line_color", "major_tick_line_color"], colour("quiet"));
      set(model, ["grid_line_color", "outline_line_color"], colour("rule"));
      if (model.type === "Legend") {  // a row of names would hang over the edge of a phone
        model.setv({orientation: innerWidth < 700 ? "vertical" : "horizontal"}, {sync: false});
      }
    }
  }
  const begin = setInterval(() => { if (Bokeh.documents.length) { clearInterval(begin); dress(); } }, 50);
  dark.addEventListener("change", dress);
  matchMedia("(max-width: 699px)").addEventListener("change", dress);
})();
"""

TEMPLATE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{{ title }}</title>
{{ bokeh_css }}
{{ bokeh_js }}
<style>{{ css }}</style>
</head>
<body>
<main>
<h1>{{ title }}</h1>
<p class="lead">{{ topic }}; the last 10 s, until a chart is moved (reset follows again).</p>
{% from macros import embed %}{% for root in doc.roots %}{{ embed(root) }}{% endfor %}
</main>
{{ plot_script }}
<script>{{ js }}</script>
</body>
</html>""")


class LivePage:
    """A server of the live page; use as a context manager.

    Parameters
    ----------
    look : returns what is known now; called by the server's loop ten times a second for each page.
    topic : of the monitor, for the reader.
    port : 0 takes any that is free.

    Attributes
    ----------
    address : of the page.

    Raises
    ------
    InputError : the port is taken, or not for this user.
    """

    def __init__(self, look: Look, topic: str, port: int) -> None:
        port = port or _free_port()
        self.address = f"http://{HERE}:{port}/"

        def modify(document: Document) -> None:
            _Page(document, look, topic)

        try:
            self._server = Server(
                {"/": Application(FunctionHandler(modify))},
                address=HERE,
                port=port,
                allow_websocket_origin=[f"{HERE}:{port}", f"localhost:{port}"],
                num_procs=1,
            )
        except OSError as error:
            raise InputError(
                f"port {port} of {HERE}: {error.strerror or error}; choose another one with --port"
            ) from error

    def __enter__(self) -> "LivePage":
        self._server.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def serve_until(self, condition: Callable[[], bool]) -> None:
        """Serve pages until a condition holds; it is asked ten times a second."""
        loop = self._server.io_loop

        def ask() -> None:
            if condition():
                loop.stop()

        asking = PeriodicCallback(ask, REDRAW_MS)
        asking.start()
        loop.start()
        asking.stop()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HERE, 0))
        return int(probe.getsockname()[1])


class _Page:
    """One browser tab."""

    def __init__(self, document: Document, look: Look, topic: str) -> None:
        self._look, self._topic, self._document = look, topic, document
        seen = look()
        self._quantities = seen.quantities
        self._last: Floats = seen.rows[:0]
        self._round, self._count, self._begin_s = seen.round, max(0, seen.count - len(seen.rows)), 0.0
        self._source = ColumnDataSource({name: [] for name in COLUMNS}, name="samples")
        self._curve = ColumnDataSource({name: [] for name in ("velocity", "friction", "low", "high")})
        self._map = ColumnDataSource({name: [] for name in ("velocity", "measured")})
        self._words = Div(text="", sizing_mode="stretch_width", name="0")
        # The browser answers what it has taken: see `follow`.
        self._turn = 0
        answer = CustomJS(args={"words": self._words}, code="words.name = String(words.tags[0])")
        self._words.js_on_change("tags", answer)
        document.title = "Friction, live"
        document.template = TEMPLATE
        css = (files("friction_estimator.report.page") / "templates" / "page.css").read_text(encoding="utf-8")
        # A part of the page of its own, which would be as narrow as its text.
        self._words.stylesheets = [css, ".bk-clearfix { display: block !important; width: 100%; }"]
        document.template_variables.update(topic=html.escape(topic), css=css, js=PAINT)
        self._plots = self._charts()
        document.add_root(column(self._words, *self._plots, sizing_mode="stretch_width"))
        document.on_event(DocumentReady, self._begin)

    def _begin(self, _: DocumentReady) -> None:
        """Begin to send when there is somebody to answer."""
        self._document.add_periodic_callback(self.follow, REDRAW_MS)

    def _charts(self) -> list[Plot]:
        q, source = self._quantities, self._source
        labels = _labels(q.unit(FORCE), q.unit(VELOCITY))
        time = DataRange1d(follow="end", follow_interval=WINDOW_S, range_padding=0.0)
        first = chart(*labels[0], x_range=time)
        band(first, "time", "low", "high", "predicted", "95 % of the predictions", source=source)
        line(first, "time", "measured", "measured", "measured", source=source)
        line(first, "time", "predicted", "predicted", "predicted before it was measured", source=source)
        second = chart(*labels[1], height=200, x_range=time)
        line(second, "time", "residual", "residual", source=source)
        third = chart(*labels[2], height=200, x_range=time)
        line(third, "time", "velocity", "known", source=source)
        for each in (first, second, third):
            each.y_range.only_visible = True
        last = chart(*labels[3], height=380)
        ink(
            last.scatter("velocity", "measured", source=self._map, size=2, color=INKS["measured"], alpha=0.4).glyph,
            "measured",
        )
        band(last, "velocity", "low", "high", "predicted", "its 95 % band", source=self._curve)
        line(last, "velocity", "friction", "predicted", "learned curve", source=self._curve)
        return [first, second, third, last]

    def follow(self) -> None:
        """Show what is new, once the browser has taken what was sent before.

        A browser that cannot keep pace draws less often; sent on and on, it would show what was true ever longer ago.
        """
        if self._words.name != str(self._turn):
            return
        seen = self._look()
        if seen.quantities != self._quantities:
            self._rename(seen.quantities)
        if seen.round != self._round:
            self._round, self._count = seen.round, max(self._count, seen.count - len(seen.rows))
            self._last = seen.rows[:0]
        rows = seen.since(self._count)[-KEPT_ROWS:]
        if len(rows):
            thin = rows[:: max(1, round(KEPT_ROWS / MAP_DOTS))]
            dots = {"velocity": thin[:, 1], "measured": thin[:, 2]}
            if len(self._last):
                self._source.stream(self._columns(rows), KEPT_ROWS)
                self._map.stream(dots, MAP_DOTS)
            else:  # of a new round; replaced in one step, since charts of nothing would flash
                self._begin_s = float(rows[0, 0])
                self._source.data, self._map.data = self._columns(rows), dots
        self._count = seen.count
        if seen.curve is not None and not np.array_equal(seen.curve[:, 1], self._curve.data["friction"]):
            self._curve.data = dict(zip(("velocity", "friction", "low", "high"), seen.curve.T, strict=True))
        words = _words(seen, self._begin_s)
        if words != self._words.text:
            self._words.text = words
        self._turn += 1
        self._words.tags = [self._turn]

    def _columns(self, rows: Floats) -> dict[str, Any]:
        """Return what is drawn of rows that follow those before."""
        drawn = interrupted(self._last, rows)
        self._last = rows[-1:]
        drawn["time"] -= self._begin_s
        return drawn

    def _rename(self, quantities: Quantities) -> None:
        """Write the units of a drive that turned out to be another one."""
        self._quantities = quantities
        labels = _labels(quantities.unit(FORCE), quantities.unit(VELOCITY))
        for plot, (x, y) in zip(self._plots, labels, strict=True):
            plot.xaxis.axis_label, plot.yaxis.axis_label = x, y


def interrupted(last: Floats, rows: Floats) -> dict[str, Floats]:
    """Return the columns that are drawn of rows (n, 5), parted at gaps (see `look.parted`).

    Parameters
    ----------
    last : (1, 5), the row drawn last, or (0, 5): a gap may lie between it and the first row.
    """
    time, velocity, measured, predicted, stddev = np.vstack([last, rows]).T
    gaps = np.flatnonzero(np.diff(time) > GAP_S) + 1
    lines = (velocity, measured, predicted, measured - predicted)
    half = BAND_SIGMAS * stddev
    drawn = parted(gaps, time, lines, predicted - half, predicted + half)
    names = ("time", "velocity", "measured", "predicted", "residual", "low", "high")
    return {name: values[len(last) :].copy() for name, values in zip(names, drawn, strict=True)}


def _labels(force: str, velocity: str) -> list[tuple[str, str]]:
    """Return the labels of the charts' axes."""
    return [
        ("time [s]", f"friction [{force}]"),
        ("time [s]", f"measured - predicted [{force}]"),
        ("time [s]", f"velocity [{velocity}]"),
        (f"velocity [{velocity}]", f"friction [{force}]"),
    ]


LIGHTS = ("good", "caution", "stop", "stop")
SIGNS = ("\u25cf", "\u25b2", "\u25a0", "\u25a0")


def _words(seen: Seen, begin_s: float) -> str:
    """Return the state in words: the node's own, and the newest sample."""
    level = 1 if seen.silence else min(seen.level, len(LIGHTS) - 1)
    told = seen.silence or seen.status or "waiting for the node's first diagnostics"
    facts = []
    q = seen.quantities
    if len(seen.rows):
        time_s, velocity, measured, predicted, stddev = seen.rows[-1]
        facts = [
            ("newest sample", f"{time_s - begin_s:.2f} s", f"stamp {time_s:.3f}"),
            ("velocity", q.text(velocity, VELOCITY), ""),
            ("measured", q.text(measured, FORCE), ""),
            ("predicted", q.text(predicted, FORCE), f"\u00b1 {q.text(BAND_SIGMAS * stddev, FORCE)}"),
        ]
    facts += [(name, value, "") for name, value in seen.told]
    cells = "".join(
        f"<div><dt>{html.escape(a)}</dt><dd>{html.escape(b)}</dd><dd>{html.escape(c)}</dd></div>" for a, b, c in facts
    )
    return (
        f'<div class="light {LIGHTS[level]}"><span class="sign" aria-hidden="true">{SIGNS[level]}</span> '
        f'<strong>{html.escape(told)}</strong></div><dl class="facts">{cells}</dl>'
    )
