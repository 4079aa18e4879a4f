"""What a page says, whoever draws it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bokeh.models import UIElement

GOOD, CAUTION, STOP, NEUTRAL = "good", "caution", "stop", "neutral"
"""Levels of a `Light`."""

LEVELS = {GOOD: ("●", "Good"), CAUTION: ("▲", "With care"), STOP: ("■", "Do not rely on it"), NEUTRAL: ("◆", "Result")}
"""Level -> its sign and word: it must be told without its colour too."""


@dataclass(frozen=True)
class Light:
    """How far to trust what the page shows: one of the levels, the reason in a sentence, and a word of its own."""

    level: str
    reason: str
    word: str = ""

    @property
    def sign(self) -> str:
        """A sign of its own shape for each level."""
        return LEVELS[self.level][0]

    @property
    def name(self) -> str:
        """The word beside it."""
        return self.word or LEVELS[self.level][1]


@dataclass(frozen=True)
class Advice:
    """What to do, and the command that does it."""

    text: str
    command: str = ""


@dataclass(frozen=True)
class Chart:
    """An interactive chart.

    Attributes
    ----------
    title : its heading. caption : how to read it, in a sentence or two.
    build : makes it; called only where bokeh is installed.
    explorer : True for signals over time, which have buttons, a cursor and keys.
    jumps : of an explorer: name of a button -> the piece of time that it shows, s.
    """

    title: str
    caption: str
    build: "Callable[[], UIElement]"
    explorer: bool = False
    jumps: Sequence[tuple[str, float, float]] = ()


@dataclass(frozen=True)
class Bar:
    """A share with its 95 % interval, percent: drawn as a bar from 0 to 100."""

    value: float
    low: float
    high: float
    text: str


@dataclass(frozen=True)
class Whisker:
    """A value with its interval, drawn in a cell of a table.

    Attributes
    ----------
    value, low, high : of the figure. reach : left and right end of the cell, the same in a column.
    text : the same in words, for who cannot see it. quiet : drawn pale.
    """

    value: float
    low: float
    high: float
    reach: tuple[float, float]
    text: str
    quiet: bool = False

    def place(self, value: float) -> float:
        """Return where a value stands in the cell, percent from the left; what is beyond stands at the end."""
        left, right = self.reach
        return 100.0 * min(max((value - left) / (right - left), 0.0), 1.0) if right > left else 50.0


@dataclass(frozen=True)
class Card:
    """One finding of a diagnosis, told as a story.

    Attributes
    ----------
    title, name : in plain words, and its id. level : a level of `Light`.
    paragraphs : what is so, and what it was seen in.
    values : (name, value with unit, interval). gain : what naming it wins, or None.
    facts : (heading, text), such as rivals and the next experiment.
    charts : the figures that show it. files : (figure, caption) where there are no charts.
    """

    title: str
    name: str
    level: str
    paragraphs: Sequence[str] = ()
    values: Sequence[tuple[str, str, str]] = ()
    gain: Bar | None = None
    facts: Sequence[tuple[str, str]] = ()
    charts: Sequence[Chart] = ()
    files: Sequence[tuple[Path, str]] = ()


@dataclass(frozen=True)
class Section:
    """A heading and what is under it; every part may be empty.

    Attributes
    ----------
    table : rows of cells, a `Whisker` is drawn; the first row is the head.
    commands : to be copied. folded : True where only the heading shows until it is asked for.
    files : (figure, caption), shown beside charts too.
    """

    title: str
    paragraphs: Sequence[str] = ()
    table: Sequence[Sequence[object]] = ()
    charts: Sequence[Chart] = ()
    cards: Sequence[Card] = ()
    commands: Sequence[str] = ()
    folded: bool = False
    files: Sequence[tuple[Path, str]] = ()


@dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes
    ----------
    title : what was done. lead : to what. verdict : the result in one sentence, in physical units.
    facts : (name, value, meaning), the figures that stand out.
    files : (figure, caption), shown where there are no charts.
    """

    title: str
    lead: str
    verdict: str
    light: Light
    advice: Sequence[Advice] = ()
    facts: Sequence[tuple[str, str, str]] = ()
    sections: Sequence[Section] = ()
    files: Sequence[tuple[Path, str]] = ()
