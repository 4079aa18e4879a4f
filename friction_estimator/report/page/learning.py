"""How the error fell, and what was learned."""

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Span, UIElement

from friction_estimator.core import metrics, series, sums
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.sample import Floats
from friction_estimator.report import figures
from friction_estimator.report.page import look
from friction_estimator.report.page.content import Chart


def error_by_cycle(result: Replay, q: Quantities, fitted: bool) -> Chart:
    """Return the error of each cycle beside what it must be read beside."""
    when = " of the fit" if fitted else " while learning" if result.learned.all() else ""
    frozen = "" if figures.learning_stops(result) is None else " Nothing is learned behind the line that says so."
    return Chart(
        f"Error{when}, cycle by cycle",
        f"Rms error of each drive cycle (tenths of the record where the drive is not periodic).{frozen} The noise "
        "floor is what is white in the measured friction, found without a model: no honest prediction goes below it.",
        lambda: _errors(result, q),
    )


def _errors(result: Replay, q: Quantities) -> UIElement:
    samples, merit = result.samples, result.figures()
    spread = metrics.spread(samples.friction_N)
    errors = look.in_units(q, spread * np.array(merit["nrmse_by_cycle"]), FORCE)
    number = np.arange(1.0, errors.size + 1.0)
    levels = [
        ("noise floor", metrics.white_noise(samples.friction_N, samples.restart), "measured", "dotted"),
        ("guess: as one sample ago", spread * merit["nrmse_persistence"], "unsupported", "dashed"),
        ("theoretical curve alone", spread * (merit["theory_nrmse"] or np.nan), "theory", "dashed"),
        ("always the mean", spread, "known", "dotdash"),
    ]
    if "coulomb_viscous" in result.baseline_curves:
        known = result.baseline_curves["coulomb_viscous"].over(samples.velocity_m_s)
        power = sums.mean_square(lambda part: samples.friction_N[part] - known(part), len(samples))
        rms = float(np.sqrt(power))
        levels.insert(2, ("Coulomb and viscous, fitted", rms, "known", "solid"))
    shown = [(word, float(q.value(level, FORCE)), name, dash) for word, level, name, dash in levels if level > 0.0]
    values = np.array([*errors[np.isfinite(errors) & (errors > 0.0)], *(level for _, level, _, _ in shown)])
    target = look.chart(
        "drive cycle" if any(metrics.drive_cycles(samples.velocity_m_s[part]) for part in result.parts) else "tenth",
        f"rms error ({q.force})", 320, y_axis_type="log", x_range=look.spanning(1.0, float(max(errors.size, 2)), 0.03),
        y_range=(0.7 * float(values.min()), 1.5 * float(values.max())) if values.size else (0.1, 1.0),
    )  # fmt: skip
    ends = np.array([0.0, errors.size + 1.0])
    for word, level, name, dash in shown:
        look.line(target, ends, np.full(2, level), name, f"{word}, {level:.3g} {q.force}", line_dash=dash)
    drawn = look.line(target, number, errors, "predicted", "predicted", line_width=1.6)
    drawn.data_source.add(100.0 * np.array(merit["nrmse_by_cycle"]), "nrmse")
    if errors.size <= 200:
        points = target.scatter(number, errors, size=5, color=look.INKS["predicted"])
        look.ink(points.glyph, "predicted")
    for recording, begin in enumerate(figures.cycles_before(result), start=2):
        look.mark(target, begin + 0.5, f"recording {recording}")
    stop = figures.learning_stops(result)
    if stop is not None:
        look.mark(target, stop, "learning stops")
    tips = [("cycle", "@x"), ("rms error", f"@y{{0.0000}} {q.force}"), ("of the spread", "@nrmse{0.00} %")]
    look.hover(target, [drawn], tips, "vline")
    return target


def taps(result: Replay, title: str, values: list[Floats], behind: str) -> Chart:
    """Return taps over time and at the end, each with its lag."""
    rate = result.samples.sample_rate_hz
    one = f" One sample is {1e3 / rate:.3g} ms." if np.isfinite(rate) else ""
    return Chart(
        title,
        f"Weights of the present and the past samples of {behind}. A single 1 at lag 0 is no memory at all: the "
        f"friction follows at once. Weights at later lags are lag, delay or smoothing.{one}",
        lambda: _taps(series.at(result.time_s, result.snapshot_index), np.array(values)),
    )


def _taps(seconds: Floats, values: Floats) -> UIElement:
    over = look.chart("time (s)", "tap (1)", 260)
    for lag in range(values.shape[1]):
        look_of = {"line_color": look.LAGS[lag % len(look.LAGS)], "line_dash": look.DASHES[lag // len(look.LAGS) % 3]}
        drawn = over.line(seconds, values[:, lag], line_width=1.5, **look_of)
        look.labelled(over, drawn, f"lag {lag}")
    last = values[-1]
    lags = np.arange(last.size)
    ends = look.chart("lag (samples)", "tap at the end (1)", 220)
    source = ColumnDataSource({"lag": lags, "zero": np.zeros(last.size), "tap": last})
    stems = ends.segment("lag", "zero", "lag", "tap", source=source, line_width=2, line_color=look.INKS["predicted"])
    dots = ends.scatter("lag", "tap", source=source, size=8, color=look.INKS["predicted"])
    for glyph in (stems.glyph, dots.glyph):
        look.ink(glyph, "predicted")
    ends.add_layout(look.ink(Span(location=0.0, dimension="width", line_width=1), "unsupported"))
    ends.xaxis.ticker.desired_num_ticks = int(min(10, last.size))
    ends.xaxis.ticker.min_interval = 1
    look.hover(ends, [dots], [("lag", "@lag samples"), ("tap", "@tap{0.0000}")])
    return column(over, ends, sizing_mode="stretch_width", spacing=4)
