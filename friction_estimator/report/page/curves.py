"""Friction against velocity, and what is left against each channel."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bokeh.models import UIElement

from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.report import figures
from friction_estimator.report.page import look
from friction_estimator.report.page.content import Chart

CELLS = (200, 110)
"""Cells across and along in which samples are counted."""

FEWEST_IN_BIN = 25
"""Samples whose mean tells something."""

BINS = (24, 400)
"""Fewest and most bins of a mean: many, since a ripple finer than the bins would show as one that is not there."""

BRIDGED = 2
"""Bins in a row with too few samples that a mean is drawn across."""


def friction_map(result: Replay, q: Quantities) -> Chart:
    """Return the learned curve with its band over the measured samples, beside what it competes with."""
    return Chart(
        figures.conditions(result, result.outlook),
        "The darker, the more samples. The band holds the curve with 95 % probability. Dashed and grey is what no data "
        "support: do not use it. Click a name above the chart to hide or show it; Ctrl and the wheel zoom.",
        lambda: _map(result, q),
    )


def _map(result: Replay, q: Quantities) -> UIElement:
    samples, curve = result.samples, result.outlook
    v = look.in_units(q, curve.velocity_m_s, VELOCITY)
    alone = figures.friction_alone(result)
    velocity, friction = look.in_units(q, samples.velocity_m_s, VELOCITY), look.in_units(q, alone, FORCE)
    ends = min(v[0], velocity.min()), max(v[-1], velocity.max())
    reach = 1.2 * float(q.value(figures.usual_size(alone), FORCE))
    target = look.chart(
        f"velocity ({q.velocity})", f"friction ({q.force})", 460, x_range=look.spanning(*ends, 0.02),
        y_range=look.spanning(-reach, reach, 0.0),
    )  # fmt: skip
    counted(target, velocity, friction, ends, (-reach, reach))
    middle, low, high = (look.in_units(q, x, FORCE) for x in (curve.friction_N, curve.low_N, curve.high_N))
    supported = figures.supported(curve, result.curve)
    for where, name, label in ((supported, "predicted", "95 % band"), (~supported, "unsupported", "band, no data")):
        for number, (start, stop) in enumerate(_runs(figures.reaching(where))):
            part = slice(start, stop)
            look.band(target, v[part], low[part], high[part], name, "" if number else label)
    theory = figures.theory_curve(result, curve.velocity_m_s, curve)
    if theory is not None:
        look.line(target, v, look.in_units(q, theory, FORCE), "theory", "theoretical curve", line_dash="dotted")
    if "coulomb_viscous" in result.baseline_curves and not result.loads:  # fitted to the effort, load and all
        known = result.baseline_curves["coulomb_viscous"].evaluate(curve.velocity_m_s)
        look.line(
            target, v, look.in_units(q, known, FORCE), "known", "Coulomb and viscous, fitted", line_dash="dotdash"
        )
    drawn = []
    for where, name, label in ((supported, "predicted", "learned"), (~supported, "unsupported", "learned, no data")):
        if where.any():
            shown = np.where(figures.reaching(where), middle, np.nan)
            dash = "solid" if name == "predicted" else "dashed"
            line = look.line(target, v, shown, name, label, line_width=2.2, line_dash=dash)
            line.data_source.add(low, "low")
            line.data_source.add(high, "high")
            drawn.append(line)
    tips = [("velocity", f"@x{{0.00000}} {q.velocity}"), ("friction", f"@y{{0.0000}} {q.force}")]
    tips.append(("95 % band", f"@low{{0.0000}} to @high{{0.0000}} {q.force}"))
    look.hover(target, drawn, tips, "vline")
    return target


def _runs(where: Bools) -> list[tuple[int, int]]:
    """Return begin and end of each run of True."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(change[::2], change[1::2], strict=True)]


def counted(target: look.Plot, x: Floats, y: Floats, across: tuple[float, float], along: tuple[float, float]) -> None:
    """Draw the density of samples; fewer cells where samples are few."""
    seen = np.isfinite(x) & np.isfinite(y)
    fewer = min(1.0, max(0.4, float(np.sqrt(x.size / 20_000))))
    span = across if across[1] > across[0] else (across[0] - 0.5, across[1] + 0.5)
    count, _, _ = np.histogram2d(
        x[seen], y[seen], bins=(int(CELLS[0] * fewer), int(CELLS[1] * fewer)), range=(span, along)
    )
    look.density(target, count.T, span, along)


@dataclass(frozen=True)
class Channel:
    """A variable that a residual may depend on: its name with the unit, and its values (n,) in the reader's units."""

    label: str
    values: Floats


def against(channel: Channel, residual: Floats, used: Bools, q: Quantities, which: str) -> Chart:
    """Return the residual (n,), in the reader's units, against a channel: density, mean and scatter in bins.

    `which` says in words which samples are `used`.
    """
    name = channel.label.split(" (", maxsplit=1)[0]
    return Chart(
        f"Against {name}",
        f"What is left, by {name}: {which}, their mean, and the range of one standard deviation about it. A mean "
        "that leaves zero is friction that the model does not know.",
        lambda: _against(channel, residual, used, q),
    )


def _against(channel: Channel, residual: Floats, used: Bools, q: Quantities) -> UIElement:
    use = used & np.isfinite(channel.values) & np.isfinite(residual)
    x, y = channel.values[use], residual[use]
    edge = 1.15 * float(np.quantile(np.abs(y), 0.998)) if y.size else 1.0
    edge = edge or 1.0
    ends = (float(x.min()), float(x.max())) if x.size else (0.0, 1.0)
    target = look.chart(
        channel.label, f"measured - predicted ({q.force})", 280, x_range=look.spanning(*ends, 0.02),
        y_range=look.spanning(-edge, edge, 0.0),
    )  # fmt: skip
    if not x.size or ends[1] <= ends[0]:
        return target
    counted(target, x, y, ends, (-edge, edge))
    drawn = mean_line(target, binned(x, y), "residual", "mean")
    look.hover(target, [drawn], [(channel.label, "@x{0.0000}"), ("mean", f"@y{{0.0000}} {q.force}")], "vline")
    return target


@dataclass(frozen=True)
class Bins:
    """The mean in bins, and the range of one standard deviation about it, parted where bins are missing (`parted`).

    Attributes
    ----------
    at, mean, low, high : (rows,); the middle of each bin, and what it holds.
    """

    at: Floats
    mean: Floats
    low: Floats
    high: Floats


def binned(x: Floats, y: Floats, bins: int = 0) -> Bins:
    """Return the mean of y in even bins of x that hold enough samples.

    Parameters
    ----------
    bins : how many at least, for a ripple that is known; as many as the samples allow unless given.
    """
    fewest, most = BINS
    count = int(np.clip(x.size // (4 * FEWEST_IN_BIN), fewest, most)) if not bins else int(np.clip(bins, fewest, most))
    cell = np.minimum(((x - x.min()) / (np.ptp(x) or 1.0) * count).astype(int), count - 1)
    number = np.bincount(cell, minlength=count)
    keep = number >= min(FEWEST_IN_BIN, max(2, x.size // (2 * count)))
    many = np.maximum(number, 1)
    middle, mean = (np.bincount(cell, weights=w, minlength=count) / many for w in (x, y))
    square = np.bincount(cell, weights=np.square(y), minlength=count) / many
    scatter = np.sqrt(np.maximum(square - np.square(mean), 0.0))
    gaps = np.flatnonzero(np.diff(np.flatnonzero(keep)) > BRIDGED + 1) + 1
    middle, mean, scatter = middle[keep], mean[keep], scatter[keep]
    return Bins(*look.parted(gaps, middle, [mean], mean - scatter, mean + scatter))


def mean_line(target: look.Plot, bins: Bins, name: str, label: str, alpha: float = 0.2) -> Any:
    """Draw the mean in bins with the range of a standard deviation about it; return the line."""
    look.band(target, bins.at, bins.low, bins.high, name, "± one standard deviation", alpha)
    return look.line(target, bins.at, bins.mean, name, label, line_width=2.0)


def channels(result: Replay, q: Quantities) -> Sequence[Channel]:
    """Return what a replay's residual is shown against: what was recorded, and the acceleration."""
    samples = result.samples
    out = [Channel(f"velocity ({q.velocity})", look.in_units(q, samples.velocity_m_s, VELOCITY))]
    step = np.diff(result.time_s, prepend=np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        acceleration = np.where(samples.restart, np.nan, np.diff(samples.velocity_m_s, prepend=np.nan) / step)
    acceleration[~np.isfinite(acceleration)] = np.nan
    known = acceleration[np.isfinite(acceleration)]
    if known.size:
        limit = float(np.quantile(np.abs(known), 0.999))
        acceleration[np.abs(acceleration) > limit] = np.nan
        out.append(Channel(f"acceleration ({q.unit('m/s2')})", look.in_units(q, acceleration, "m/s2")))
    recorded = (
        (samples.position_m, f"position ({q.position})", lambda x: look.in_units(q, x, "m")),
        (samples.pressure_Pa, "absolute pressure (bar)", lambda x: x * 1e-5),
        (samples.temperature_degC, "temperature (°C)", lambda x: x),
    )
    for values, label, shown in recorded:
        if values is not None and np.isfinite(values).any() and np.nanmax(values) > np.nanmin(values):
            out.append(Channel(label, shown(values)))
    out.append(Channel("time (s)", result.time_s))
    return out
