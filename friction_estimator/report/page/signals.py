"""Signals over time: velocity, friction measured and predicted, and what is left, one time axis under all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, CustomJS, Range1d, Span, UIElement

from friction_estimator.core import metrics, series
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.series import Formed, Series
from friction_estimator.report.page import envelope, look
from friction_estimator.report.page.content import Chart

NORMAL_95 = 1.959964

CLOSE = 8192
"""Samples of a piece that is kept in full, at the most."""


@dataclass(frozen=True)
class Signals:
    """What is drawn over time, series of one length n, SI units.

    Attributes
    ----------
    restart : where a line is interrupted.
    predicted : name of a curve -> (n,), the last one in the colour of the prediction, an earlier one in the theory's.
    residual : the same names -> measured less predicted, (n,).
    deviation_N : (n,), standard deviation of the last prediction; None where there is none.
    close : pieces of it that are kept sample by sample, by the name of their button.
    marks : (time, s; word) of what happens in between.
    """

    time_s: Series
    restart: Bools
    velocity_m_s: Series
    measured_N: Series
    predicted: Mapping[str, Series]
    residual: Mapping[str, Series]
    deviation_N: Series | None = None
    close: Mapping[str, slice] = field(default_factory=dict)
    marks: Sequence[tuple[float, str]] = ()


def cycles_of(velocity_m_s: Floats, error_N: Series, parts: Sequence[slice], worst: str = "worst") -> dict[str, slice]:
    """Return the first, the worst and the last drive cycle (tenths of the record where it has no cycles).

    `worst` is what the one with the largest error is called.
    """
    found: list[slice] = []
    for part in parts:
        inside = metrics.drive_cycles(velocity_m_s[part])
        edges = np.linspace(0, part.stop - part.start, 11).astype(int)
        inside = inside or [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]
        found += [slice(part.start + one.start, part.start + one.stop) for one in inside]
    if not found:
        return {}

    def power_of(error: Floats) -> float:
        return float(np.nanmean(np.square(error)) if np.isfinite(error).any() else 0.0)

    with np.errstate(invalid="ignore", over="ignore"):
        power = [power_of(error_N[one]) for one in found]
    word = "cycle" if any(metrics.drive_cycles(velocity_m_s[part]) for part in parts) else "tenth"
    return {f"first {word}": found[0], f"{worst} {word}": found[int(np.argmax(power))], f"last {word}": found[-1]}


def chart(
    title: str, caption: str, signals: Signals, q: Quantities, rows: int = envelope.FINEST, close: int = CLOSE
) -> Chart:
    """Return the chart, with a button for each piece that is kept in full.

    `rows` are those of the table of the whole, `close` the samples of a piece at the most: what the page has room for.
    """
    jumps = []
    for name, part in signals.close.items():
        jumps.append((name, series.one(signals.time_s, part.start), series.one(signals.time_s, part.stop - 1)))
    return Chart(title, caption, lambda: _build(signals, q, rows, close), explorer=True, jumps=jumps)


def _columns(signals: Signals, q: Quantities) -> dict[str, Series]:
    """Return every line in the reader's units, by the name that the page's script knows."""
    usual = usual_force_N(signals.measured_N)
    out: dict[str, Series] = {
        "velocity": look.shown(q, signals.velocity_m_s, VELOCITY),
        "measured": look.shown(q, signals.measured_N, FORCE),
    }
    names = list(signals.predicted)
    for number, name in enumerate(names):
        end = "" if number == len(names) - 1 else f"_{number}"
        out[f"predicted{end}"] = readable_force(q, signals.predicted[name], usual)
        out[f"residual{end}"] = readable_force(q, signals.residual[name], usual)
    if signals.deviation_N is not None:
        for name, sign in (("band_low", -1.0), ("band_high", 1.0)):
            out[name] = _edge(out["predicted"], signals.deviation_N, sign, usual, q)
    return out


def usual_force_N(measured_N: Series) -> float:
    """Return the size beside which forces that run away are cut, N; above 0."""
    return series.usual_size(measured_N) or 1.0


def readable_force(q: Quantities, values_N: Series, usual_N: float) -> Series:
    """Return forces in the reader's units, cut where they run away (`envelope.readable`)."""
    return look.shown(q, Formed(values_N.size, lambda part: envelope.readable(values_N[part], usual_N)), FORCE)


def _edge(middle: Series, deviation_N: Series, sign: float, usual: float, q: Quantities) -> Series:
    """Return an edge of the 95 % band about a line, in the reader's units."""

    def of(part: slice) -> Floats:
        half = NORMAL_95 * envelope.readable(deviation_N[part], usual)
        return middle[part] + sign * look.in_units(q, half, FORCE)

    return Formed(middle.size, of)


def _build(signals: Signals, q: Quantities, rows: int, most: int) -> UIElement:
    columns = _columns(signals, q)
    gap = envelope.gaps(signals.time_s, signals.restart)
    n = signals.time_s.size
    if n <= (envelope.WHOLE if rows >= envelope.FINEST else rows):
        tables = [envelope.piece(signals.time_s, columns, gap, slice(0, n))]
    else:
        close = envelope.pieces_of(n, list(signals.close.values()), most)
        tables = [envelope.table(signals.time_s, columns, gap, rows)]
        tables += [envelope.piece(signals.time_s, columns, gap, part) for part in close]
    stores = [
        ColumnDataSource(dict(one.columns), tags=[{"steps": dict(one.steps), "samples": one.samples_per_row}])
        for one in tables
    ]
    shown = ColumnDataSource({name: np.zeros(0) for name in ("time_s", *columns)}, name="shown")
    time = Range1d(series.one(signals.time_s, 0), series.one(signals.time_s, n - 1) or 1.0, name="time")
    panels = [
        _panel("velocity", f"velocity ({q.velocity})", 170, time),
        _panel("friction", f"friction ({q.force})", 300, time),
        _panel("residual", f"measured - predicted ({q.force})", 190, time),
    ]
    _draw(panels, shown, list(signals.predicted), "band_low" in columns)
    for panel in panels:
        panel.add_layout(
            look.ink(Span(dimension="height", line_width=1, line_dash="dotted", name=f"cursor_{panel.name}"), "text")
        )
        for seconds, word in signals.marks:
            look.mark(panel, seconds, word if panel is panels[0] else "")
    panels[0].xaxis.visible = panels[1].xaxis.visible = False
    panels[2].xaxis.axis_label = "time (s)"
    # What holds the tables is never drawn: it must hang on something to get into the page.
    keep = CustomJS(args={f"store_{k}": store for k, store in enumerate(stores)}, code="", name="stores")
    panels[0].js_on_event("reset", keep)
    for panel in panels[1:]:
        panel.toolbar_location = None
    return column(*panels, sizing_mode="stretch_width", spacing=0)


def _panel(name: str, label: str, height: int, time: Range1d) -> look.Plot:
    panel = look.chart("", label, height, x_range=time, y_range=Range1d(0.0, 1.0), name=name)
    panel.min_border_left = 76  # as wide in each, so that the times stand one under another
    panel.yaxis.ticker.desired_num_ticks = 4 if height < 200 else 6
    return panel


def _draw(panels: Sequence[look.Plot], shown: ColumnDataSource, names: Sequence[str], banded: bool) -> None:
    """Draw all lines from the source that the page's script fills for the time in sight."""

    def draw(panel: look.Plot, name: str, ink: str, label: str, **options: float | str) -> None:
        look.line(panel, "time_s", name, ink, label, source=shown, **options)

    draw(panels[0], "velocity", "theory", "")
    draw(panels[1], "measured", "measured", "measured", line_width=2.6, line_alpha=0.75)
    if banded:
        look.band(panels[1], "time_s", "band_low", "band_high", "predicted", "95 % band", 0.18, source=shown)
    for number, name in enumerate(names):
        last = number == len(names) - 1
        end, ink = ("", "predicted") if last else (f"_{number}", "theory")
        draw(panels[1], f"predicted{end}", ink, name, line_width=1.2)
        draw(panels[2], f"residual{end}", "residual" if len(names) == 1 else ink, "" if len(names) == 1 else name)
    panels[2].add_layout(look.ink(Span(location=0.0, dimension="width", line_width=1), "unsupported"))
