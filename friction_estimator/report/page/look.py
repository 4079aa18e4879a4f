"""How charts look: every colour is a name that the page's style sheet gives a value, light or dark."""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from bokeh.models import (
    BasicTicker,
    ColorBar,
    CustomJSTickFormatter,
    FixedTicker,
    HoverTool,
    Label,
    Legend,
    LegendItem,
    LogColorMapper,
    Range1d,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure

from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.series import Formed, Series

Plot: TypeAlias = figure

INKS = {
    "measured": "#5f6b7a",
    "predicted": "#c2410c",
    "theory": "#0b6bb3",
    "known": "#00795c",
    "residual": "#7a3e9d",
    "unsupported": "#8a929e",
    "text": "#1d232a",
}
"""Name of a colour -> its value on a light page without our script; Okabe and Ito's hues, darkened to be read on white.
The style sheet (templates/page.css) has both sets; what carries the tag `ink:NAME` is coloured by it."""

LAGS = ("#c2410c", "#0b6bb3", "#00795c", "#7a3e9d", "#9a6b00")
"""Colours of taps in turn, middle tones that are read on white and on black; dashes tell the rounds apart."""

DASHES = ("solid", "dashed", "dotted")

DENSITY = [f"#7c8796{round(48 + 207 * k / 15):02x}" for k in range(16)]
"""Few samples to many: one grey, the more opaque the more samples, so that it serves both pages."""

PLAIN = """
const far = Math.abs(tick) >= 1e5 || (tick !== 0 && Math.abs(tick) < 1e-4);
return far ? tick.toExponential(0) : String(+tick.toPrecision(3));
"""
"""Ticks of a logarithmic axis as numbers that one reads: 0.02, not 2 times ten to the minus two."""


def in_units(q: Quantities, values: Floats, unit: str) -> Floats:
    """Return values in SI units as the reader's; `unit` is that of a linear drive."""
    return values * q.value(1.0, unit)


def shown(q: Quantities, values: Series, unit: str) -> Series:
    """Return the same of a series."""
    return Formed(values.size, lambda part: in_units(q, values[part], unit))


def readable_ticks(low: float, high: float) -> list[float]:
    """Return ticks of a logarithmic axis: 1, 2 and 5 of each decade, or decades only where there are many.

    >>> readable_ticks(0.03, 2.0)
    [0.05, 0.1, 0.2, 0.5, 1.0, 2.0]
    """
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    steps = (1, 2, 5) if last - first <= 4 else (1,)
    ticks = [float(f"{step}e{power}") for power in range(first, last + 1) for step in steps]
    return [tick for tick in ticks if low <= tick <= high]


def ink(model: Any, name: str) -> Any:
    """Have the style sheet colour a model: its lines, fills and text."""
    model.tags = [*model.tags, f"ink:{name}"]
    return model


def chart(x_label: str, y_label: str, height: int = 320, **options: Any) -> Plot:
    """Return an empty figure as wide as the page, with units in its labels, pan, zoom and a button that saves it."""
    out = figure(
        sizing_mode="stretch_width",
        height=height,
        x_axis_label=x_label,
        y_axis_label=y_label,
        tools="pan,box_zoom,reset,save",
        toolbar_location="above",
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        outline_line_alpha=0.25,
        min_border_right=16,
        **options,
    )
    # With the key held, as on maps: a page that is scrolled must not zoom what comes under the pointer.
    out.add_tools(WheelZoomTool(modifiers={"ctrl": True}))
    out.toolbar.active_drag = out.tools[1]
    out.toolbar.logo = None
    for axis in (out.xaxis, out.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "12px"
        axis.minor_tick_line_color = None
    out.grid.grid_line_alpha = 0.35
    if options.get("y_axis_type") == "log":
        low, high = options["y_range"]
        out.yaxis.ticker = FixedTicker(ticks=readable_ticks(low, high))
        out.yaxis.formatter = CustomJSTickFormatter(code=PLAIN)
    else:
        out.yaxis.ticker = BasicTicker(desired_num_ticks=6, num_minor_ticks=0)
    return out


def line(target: Plot, x: Floats | str, y: Floats | str, name: str, label: str = "", **options: Any) -> Any:
    """Draw a line in the colour `name`; NaN interrupts it. With `source` in the options, x and y name its columns."""
    options = {"line_width": 1.6, "line_color": INKS[name]} | options
    drawn = target.line(x, y, **options)
    ink(drawn.glyph, name)
    return labelled(target, drawn, label)


def band(
    target: Plot,
    x: Floats | str,
    low: Floats | str,
    high: Floats | str,
    name: str,
    label: str = "",
    alpha: float = 0.22,
    **options: Any,
) -> Any:
    """Fill between two lines."""
    drawn = target.varea(x, low, high, **options, fill_color=INKS[name], fill_alpha=alpha)
    ink(drawn.glyph, name)
    return labelled(target, drawn, label)


def labelled(target: Plot, drawn: Any, label: str) -> Any:
    """Put a drawn glyph into the legend, which stands above the chart and never over data."""
    if label:
        if not target.legend:
            legend = Legend(
                orientation="horizontal",
                ncols="auto",
                background_fill_alpha=0.0,
                border_line_alpha=0.0,
                label_text_font_size="12px",
                padding=2,
                margin=2,
                click_policy="hide",
            )
            target.add_layout(legend, "above")
        target.legend[0].items = [*target.legend[0].items, LegendItem(label=label, renderers=[drawn])]
    return drawn


def parted(gaps: Ints, x: Floats, lines: Sequence[Floats], low: Floats, high: Floats) -> list[Floats]:
    """Return x, lines, low and high (n,) with two rows more at each gap, one at either end of it.

    In them a line is NaN, which interrupts it. A fill goes on over NaN: it has no height there instead. (page.js does
    the same for what it chooses to draw.)

    Parameters
    ----------
    gaps : rows before which a gap lies, above 0.

    >>> [y.tolist() for y in parted(np.array([1]), np.array([0.0, 9.0]), [np.ones(2)], np.zeros(2), np.full(2, 2.0))]
    [[0.0, 0.0, 9.0, 9.0], [1.0, nan, nan, 1.0], [0.0, 1.0, 1.0, 0.0], [2.0, 1.0, 1.0, 2.0]]
    """
    ends, places = np.column_stack([gaps - 1, gaps]).ravel(), np.repeat(gaps, 2)
    middle = (0.5 * (low + high))[ends]
    nothing = np.full(ends.size, np.nan)
    filled = [(x, x[ends]), *((one, nothing) for one in lines), (low, middle), (high, middle)]
    return [np.insert(values, places, inside) for values, inside in filled]


def mark(target: Plot, x: float, word: str = "") -> None:
    """Draw a dashed line across a chart at a place, and what it is."""
    target.add_layout(ink(Span(location=x, dimension="height", line_dash="dashed"), "unsupported"))
    if word:
        # Neighbours stand above each other: a recording may begin where learning stops.
        row = len(target.select({"type": Label})) % 3
        named = Label(x=x, y=4 + 13 * row, y_units="screen", x_offset=4, text=word, text_font_size="11px")
        named.text_color = INKS["text"]
        target.add_layout(ink(named, "text"))


def density(target: Plot, count: Floats, span: tuple[float, float], reach: tuple[float, float]) -> None:
    """Draw how many samples lie where, (cells of y, cells of x), with its colour bar."""
    mapper = LogColorMapper(palette=DENSITY, low=1, high=max(2.0, float(count.max())), low_color="#00000000")
    target.image(
        [count.astype("uint16" if count.max() < 65536 else "uint32")],
        x=span[0], y=reach[0], dw=span[1] - span[0], dh=reach[1] - reach[0],
        color_mapper=mapper, level="image",
    )  # fmt: skip
    bar = ColorBar(
        color_mapper=mapper,
        title="samples",
        width=10,
        label_standoff=6,
        background_fill_alpha=0.0,
        ticker=FixedTicker(ticks=[float(10**k) for k in range(9) if 10**k <= mapper.high]),
        formatter=CustomJSTickFormatter(code=PLAIN),
        title_text_font_style="normal",
        title_text_font_size="12px",
    )
    target.add_layout(bar, "right")


def hover(target: Plot, drawn: Sequence[Any], tips: Sequence[tuple[str, str]], mode: str = "mouse") -> None:
    """Show values under the pointer."""
    target.add_tools(HoverTool(renderers=list(drawn), tooltips=list(tips), mode=mode, line_policy="nearest"))


def spanning(low: float, high: float, room: float = 0.05) -> Range1d:
    """Return a range with room at both ends; its reset is the same."""
    margin = room * (high - low) or 1e-3
    return Range1d(low - margin, high + margin)
