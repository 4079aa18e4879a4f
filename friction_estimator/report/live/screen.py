"""The live view as text, for people on ssh: signals and the learned curve in braille dots, rates and errors beside."""

import math
import threading
from collections.abc import Sequence

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.segment import Segment, Segments
from rich.style import Style
from rich.table import Table
from rich.text import Text

from friction_estimator.core.quantities import FORCE, VELOCITY
from friction_estimator.core.sample import Floats
from friction_estimator.core.text import shown
from friction_estimator.report.live.seen import Look, Seen

REDRAW_S = 0.2

WINDOW_S = 10.0

MEASURED, PREDICTED, CURVE = Style(color="bright_black"), Style(color="yellow"), Style(color="cyan")

ROOMY = 60
"""Columns below which names and numbers stand close."""

LEAST_FACTS = 3

LEAST_PANEL = 5
"""Rows of the smallest panel, its frame among them."""

LEVELS = ("green", "yellow", "red", "red")

DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bit of a braille character by row and column of its dots (Unicode, from U+2800)."""


class Canvas:
    """Lines in braille dots: two columns and four rows of dots a character.

    Parameters
    ----------
    columns, rows : characters.
    x, y : the ranges that it shows; what lies outside is left out.

    Examples
    --------
    >>> canvas = Canvas(4, 1, (0.0, 7.0), (0.0, 3.0))
    >>> canvas.draw(np.array([0.0, 3.0, 4.0, 7.0]), np.array([0.0, 3.0, 3.0, 0.0]), Style())
    >>> canvas.text()
    ['⡠⠊⠑⢄']
    """

    def __init__(self, columns: int, rows: int, x: tuple[float, float], y: tuple[float, float]) -> None:
        self._bits = np.zeros((rows, columns), np.uint8)
        self._style = np.full((rows, columns), None, object)
        self._x, self._y = x, y

    def draw(self, x: Floats, y: Floats, style: Style, *, dots: bool = False) -> None:
        """Draw a line, or dots; what is not finite interrupts it."""
        rows, columns = self._bits.shape
        (left, right), (low, high) = self._x, self._y
        across = (x - left) / ((right - left) or 1.0) * (2 * columns - 1)
        down = (high - y) / ((high - low) or 1.0) * (4 * rows - 1)
        if not dots:
            across, down = _joined(across, down)
        usable = np.isfinite(across) & np.isfinite(down)
        i, j = np.rint(down[usable]).astype(int), np.rint(across[usable]).astype(int)
        inside = (i >= 0) & (i < 4 * rows) & (j >= 0) & (j < 2 * columns)
        for row, column in zip(i[inside].tolist(), j[inside].tolist(), strict=True):
            self._bits[row // 4, column // 2] |= DOTS[row % 4][column % 2]
            self._style[row // 4, column // 2] = style

    def text(self) -> list[str]:
        """Return the characters, row by row."""
        return ["".join(chr(0x2800 + int(bits)) for bits in row) for row in self._bits]

    def __rich__(self) -> Segments:
        segments = []
        for line, styles in zip(self.text(), self._style, strict=True):
            segments += [Segment(character, style) for character, style in zip(line, styles, strict=True)]
            segments.append(Segment.line())
        return Segments(segments)


def _joined(across: Floats, down: Floats) -> tuple[Floats, Floats]:
    """Return the points of a line with all between them, so that each dot touches the next."""
    parts = [(across[:1], down[:1])]
    for k in range(1, across.size):
        longest = max(abs(across[k] - across[k - 1]), abs(down[k] - down[k - 1]))
        if math.isfinite(longest):
            share = np.linspace(0.0, 1.0, 1 + math.ceil(min(longest, 4000.0)))[1:]
            start_x, start_y = across[k - 1], down[k - 1]
            parts.append((start_x + share * (across[k] - start_x), start_y + share * (down[k] - start_y)))
        else:
            parts.append((across[k : k + 1], down[k : k + 1]))
    return np.concatenate([x for x, _ in parts]), np.concatenate([y for _, y in parts])


def draw_screen(look: Look, topic: str, ended: threading.Event) -> None:
    """Draw what is known again and again, on a screen of its own, until `ended`; the terminal is as before then."""
    console = Console()
    with Live(console=console, screen=True, auto_refresh=False) as live:
        while not ended.is_set():
            live.update(picture(look(), topic, console.width, console.height), refresh=True)
            ended.wait(REDRAW_S)


def picture(seen: Seen, topic: str, columns: int, rows: int) -> RenderableType:
    """Return the picture of one moment, for a screen of so many characters."""
    q = seen.quantities
    level = 1 if seen.silence else min(seen.level, len(LEVELS) - 1)
    status = Text(shown(seen.silence or seen.status or "waiting for the node's first diagnostics"), LEVELS[level])
    room = rows - 1 - math.ceil(len(status) / columns)
    told = _facts(seen)[: max(LEAST_FACTS, room - LEAST_PANEL)]
    between = 3 if columns >= ROOMY else 1
    facts = Table.grid(padding=(0, between))
    # Where there is no room for both, names are cut rather than numbers.
    facts.add_column(no_wrap=True, max_width=columns - between - max((len(value) for _, value in told), default=0))
    for name, value in told:
        facts.add_row(name, Text(value, "bold"))
    wide = max(10, columns - 4)
    room -= facts.row_count
    both = room >= 2 * LEAST_PANEL
    high = max(LEAST_PANEL, room // (1 + both)) - 2
    parts: list[RenderableType] = [status, facts]
    if len(seen.rows):
        time_s, _, measured, predicted, _ = seen.rows.T
        begin = time_s[-1] - WINDOW_S
        recent = time_s >= begin
        canvas = Canvas(wide, high, (begin, time_s[-1]), _span(measured[recent], predicted[recent]))
        canvas.draw(time_s[recent], measured[recent], MEASURED)
        canvas.draw(time_s[recent], predicted[recent], PREDICTED)
        unit = q.unit(FORCE)
        titles: tuple[str, ...] = (
            f"friction, the last {WINDOW_S:.0f} s: measured (grey), predicted (yellow) [{unit}]",
            f"measured (grey), predicted (yellow) [{unit}]",
            f"measured, predicted [{unit}]",
            f"[{unit}]",
        )
        parts.append(Panel(canvas, title=_ranged(titles, _span(measured[recent], predicted[recent]), columns)))
    if seen.curve is not None and (both or not len(seen.rows)):
        velocity, friction, low, top = seen.curve.T
        reach = (float(velocity[0]), float(velocity[-1]))
        span = _span(low, top)
        canvas = Canvas(wide, high, reach, span)
        canvas.draw(velocity, low, MEASURED, dots=True)
        canvas.draw(velocity, top, MEASURED, dots=True)
        canvas.draw(velocity, friction, CURVE)
        unit = q.unit(FORCE)
        titles = (
            f"learned curve and 95 % band [{unit}], {q.range_text(reach, VELOCITY)}",
            f"curve and band [{unit}]",
            f"curve [{unit}]",
        )
        parts.append(Panel(canvas, title=_ranged(titles, span, columns)))
    head = Text(f"{shown(topic)}   (Ctrl-C ends)", "dim", no_wrap=True, overflow="ellipsis")
    return Group(head, *parts)


def _facts(seen: Seen) -> list[tuple[str, str]]:
    q, facts = seen.quantities, []
    if len(seen.rows):
        _, velocity, measured, predicted, stddev = seen.rows[-1]
        facts.append(("velocity", q.text(velocity, VELOCITY)))
        facts.append(("measured", q.text(measured, FORCE)))
        facts.append(("predicted", q.text(predicted, FORCE)))
        facts.append(("standard deviation", q.text(stddev, FORCE)))
    return facts + [(shown(name), shown(value)) for name, value in seen.told]


def _span(*values: Floats) -> tuple[float, float]:
    """Return the range of all that is finite, with a little room."""
    every = np.concatenate(values)
    every = every[np.isfinite(every)]
    if not every.size:
        return (-1.0, 1.0)
    low, high = float(every.min()), float(every.max())
    margin = 0.02 * (high - low) or max(abs(high), 1.0) * 1e-3
    return (low - margin, high + margin)


def _ranged(titles: Sequence[str], span: Sequence[float], columns: int) -> Text:
    """Return the longest of some titles that has room on the screen, with the range that is shown."""
    told = [f"{title}  {span[0]:.3g} to {span[1]:.3g}" for title in titles]
    return Text(next((text for text in told if len(text) <= columns - 6), told[-1]))
