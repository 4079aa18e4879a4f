"""The charts of a diagnosis: before and after, over time and over the variable that shows the effect."""

from collections.abc import Mapping, Sequence

import numpy as np
from bokeh.layouts import column
from bokeh.models import UIElement

from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.sample import Bools, Floats, Ints
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.result import Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.report import diagnosis_figures as figures
from friction_estimator.report.page import curves, look, signals
from friction_estimator.report.page.content import Chart

ROWS, SHARED_ROWS = 8_000, 12_000
"""Rows of extremes of a chart over time, and of all of them together: a page has one a cause, and one for them all.
What is kept sample by sample is fewer in the same measure."""

PER_RIPPLE = 12
"""Bins to a wavelength of a ripple that was found: fewer would show another one."""

WAVELENGTHS = ("wavelength", "period", "pitch")
"""Parameters that say how fine a ripple is."""


def over_time(result: Diagnosis, before: Joint, after: Joint, words: tuple[str, str], q: Quantities) -> Chart:
    """Return measured force beside two models, and what each leaves."""
    text = (
        f"Measured, and predicted by the model {words[0]} and {words[1]}. Both were fitted to these samples; the gain "
        "above is measured on samples that the fit never saw. Gaps count as one sample."
    )
    models = dict(zip(words, (before, after), strict=True))
    return _time_chart(result, models, "Over time, before and after", text, q)


def model_over_time(result: Diagnosis, q: Quantities) -> Chart:
    """Return measured force beside the base model, and what it leaves."""
    text = "Measured, and as the model has it, which was fitted to these samples. Gaps count as one sample."
    return _time_chart(result, {"model": result.models[0]}, "Over time", text, q)


def _time_chart(result: Diagnosis, models: Mapping[str, Joint], title: str, text: str, q: Quantities) -> Chart:
    record = result.record
    time = record.features.active_time_s
    order: Ints = np.flatnonzero(np.diff(time, prepend=-np.inf) >= 0.0)
    force = record.friction_N
    predicted = {word: (force - model.residual_N)[order] for word, model in models.items()}
    left = {word: model.residual_N[order] for word, model in models.items()}
    residuals = list(left.values())
    worst, error = "largest change,", residuals[0] - residuals[-1]
    if len(residuals) == 1:
        worst, error = "worst", residuals[0]
    velocity = record.features.velocity_m_s[order]
    drawn = signals.Signals(
        time[order],
        record.restart[order],
        velocity,
        force[order],
        predicted,
        left,
        None,
        signals.cycles_of(velocity, error, [slice(0, order.size)], worst),
    )
    charts = len(result.effects) + (len(result.effects) > 1)
    rows = min(ROWS, SHARED_ROWS // max(1, charts))
    return signals.chart(title, text, drawn, q, rows, signals.CLOSE * rows // ROWS)


def revealing(result: Diagnosis, found: Found, q: Quantities) -> Chart:
    """Return the residual against the variable that reveals the effect, before and after."""
    number = found.term
    before, after = result.models[number], result.models[number + 1]
    name = EFFECTS[found.name].reveals
    values = after.features.force_N if name == "force_N" else getattr(after.features, name)
    used = result.record.used & np.isfinite(values)
    used &= values <= figures.reach_of(name, found, result)
    across = figures.axis_of(name, q, values[used])
    turns = EFFECTS[found.name].turns
    folded = np.sign(result.record.features.velocity_m_s) if turns else np.ones(values.size)
    first, last = (look.in_units(q, model.residual_N * folded, FORCE) for model in (before, after))
    words = " in the direction of motion" if turns else ""
    return Chart(
        f"Where it shows: over {across.label.split(' (', maxsplit=1)[0]}",
        f"What the model leaves{words}, before and after; the darker, the more samples. The dashed line is what the "
        "effect takes off. Afterwards the mean should lie on zero.",
        lambda: _pair(across, values, (first, last), used, q, _bins(found, values[used])),
    )


def _bins(found: Found, values: Floats) -> int:
    """Return how many bins show a ripple of the found length; 0 where there is none."""
    lengths = [e.value for name, e in found.parameters.items() if name in WAVELENGTHS and e.value > 0.0]
    return int(PER_RIPPLE * np.ptp(values) / min(lengths)) if lengths and values.size else 0


def _pair(
    across: figures.Axis, values: Floats, left: Sequence[Floats], used: Bools, q: Quantities, bins: int
) -> UIElement:
    x = across(values)[used]
    before, after = (one[used] for one in left)
    if not x.size:
        return look.chart(across.label, f"residual ({q.force})", 200)
    ends = float(x.min()), float(x.max())
    edge = 1.1 * float(np.quantile(np.abs(np.concatenate([before, after])), 0.998)) or 1.0
    shared_x, shared_y = look.spanning(*ends, 0.02), look.spanning(-edge, edge, 0.0)
    panels = []
    for word, y in (("before", before), ("after", after)):
        target = look.chart(
            across.label, f"left {word} ({q.force})", 260, x_range=shared_x, y_range=shared_y, name=f"{word}_left"
        )
        if ends[1] > ends[0]:
            curves.counted(target, curves.Points(x, y), ends, (-edge, edge))
            name = "theory" if word == "before" else "predicted"
            drawn = curves.mean_line(target, curves.binned(curves.Points(x, y), bins), name, f"mean, {word}")
            if word == "before":
                off = curves.binned(curves.Points(x, before - after), bins)
                look.line(target, off.at, off.mean, "text", "what the effect takes off", line_dash="dashed")
            look.hover(target, [drawn], [(across.label, "@x{0.0000}"), ("mean", f"@y{{0.0000}} {q.force}")], "vline")
        panels.append(target)
    return column(*panels, sizing_mode="stretch_width", spacing=2)
