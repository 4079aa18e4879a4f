"""Friction against velocity, and what is left against each channel."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from bokeh.models import UIElement

from friction_estimator.core import series, sums
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.series import Formed, Series
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
    points = Points(look.shown(q, samples.velocity_m_s, VELOCITY), look.shown(q, alone, FORCE))
    slowest, fastest = series.ends(points.x)
    ends = min(v[0], slowest), max(v[-1], fastest)
    reach = 1.2 * float(q.value(figures.usual_size(alone), FORCE))
    target = look.chart(
        f"velocity ({q.velocity})", f"friction ({q.force})", 460, x_range=look.spanning(*ends, 0.02),
        y_range=look.spanning(-reach, reach, 0.0),
    )  # fmt: skip
    counted(target, points, ends, (-reach, reach))
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


@dataclass(frozen=True)
class Points:
    """Pairs of numbers, looked at piece by piece; those of which one is not finite are passed over.

    Attributes
    ----------
    x, y : (n,). begin : index of the first pair that counts.
    """

    x: Series
    y: Series
    begin: int = 0

    def pieces(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield what counts."""
        for part in sums.parts(self.x.size):
            part = slice(max(part.start, self.begin), part.stop)  # noqa: PLW2901 - cut
            x, y = self.x[part], self.y[part]
            finite = np.isfinite(x) & np.isfinite(y)
            yield sums.some(x, finite), sums.some(y, finite)

    @cached_property
    def size(self) -> int:
        """How many count."""
        return sum(x.size for x, _ in self.pieces())

    @cached_property
    def ends(self) -> tuple[float, float]:
        """The lowest and the highest x; (0, 1) where there is none."""
        found = [(float(x.min()), float(x.max())) for x, _ in self.pieces() if x.size]
        return (min(low for low, _ in found), max(high for _, high in found)) if found else (0.0, 1.0)


def counted(target: look.Plot, points: Points, across: tuple[float, float], along: tuple[float, float]) -> None:
    """Draw the density of samples; fewer cells where samples are few."""
    fewer = min(1.0, max(0.4, float(np.sqrt(points.size / 20_000))))
    span = across if across[1] > across[0] else (across[0] - 0.5, across[1] + 0.5)
    cells = int(CELLS[0] * fewer), int(CELLS[1] * fewer)
    count = np.zeros(cells)
    for x, y in points.pieces():
        count += np.histogram2d(x, y, bins=cells, range=(span, along))[0]
    look.density(target, count.T, span, along)


@dataclass(frozen=True)
class Channel:
    """A variable that a residual may depend on: its name with the unit, and its values (n,) in the reader's units."""

    label: str
    values: Series


def against(channel: Channel, residual: Series, begin: int, q: Quantities, which: str) -> Chart:
    """Return the residual (n,), in the reader's units, against a channel: density, mean and scatter in bins.

    `which` says in words which samples are used: those from `begin` on.
    """
    name = channel.label.split(" (", maxsplit=1)[0]
    return Chart(
        f"Against {name}",
        f"What is left, by {name}: {which}, their mean, and the range of one standard deviation about it. A mean "
        "that leaves zero is friction that the model does not know.",
        lambda: _against(channel.label, Points(channel.values, residual, begin), q),
    )


def _against(label: str, points: Points, q: Quantities) -> UIElement:
    sizes = (np.abs(y) for _, y in points.pieces())
    edge = 1.15 * sums.upper_quantile(sizes, points.size, 0.998) if points.size else 1.0
    edge = edge or 1.0
    ends = points.ends
    target = look.chart(
        label, f"measured - predicted ({q.force})", 280, x_range=look.spanning(*ends, 0.02),
        y_range=look.spanning(-edge, edge, 0.0),
    )  # fmt: skip
    if not points.size or ends[1] <= ends[0]:
        return target
    counted(target, points, ends, (-edge, edge))
    drawn = mean_line(target, binned(points), "residual", "mean")
    look.hover(target, [drawn], [(label, "@x{0.0000}"), ("mean", f"@y{{0.0000}} {q.force}")], "vline")
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


def binned(points: Points, bins: int = 0) -> Bins:
    """Return the mean of y in even bins of x that hold enough samples.

    Parameters
    ----------
    bins : how many at least, for a ripple that is known; as many as the samples allow unless given.
    """
    fewest, most = BINS
    size, (lowest, highest) = points.size, points.ends
    count = int(np.clip(size // (4 * FEWEST_IN_BIN), fewest, most)) if not bins else int(np.clip(bins, fewest, most))
    number = np.zeros(count, np.int64)
    sum_x, sum_y, squares = np.zeros((3, count))
    for x, y in points.pieces():
        cell = np.minimum(((x - lowest) / ((highest - lowest) or 1.0) * count).astype(int), count - 1)
        number += np.bincount(cell, minlength=count)
        # One by one, in order: the sums do not depend on where one piece ends and the next begins.
        for total, values in ((sum_x, x), (sum_y, y), (squares, np.square(y))):
            np.add.at(total, cell, values)
    keep = number >= min(FEWEST_IN_BIN, max(2, size // (2 * count)))
    many = np.maximum(number, 1)
    middle, mean, square = sum_x / many, sum_y / many, squares / many
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
    out = [Channel(f"velocity ({q.velocity})", look.shown(q, samples.velocity_m_s, VELOCITY))]
    acceleration = _acceleration(result)
    count = sum(int(np.count_nonzero(np.isfinite(piece))) for piece in series.pieces(acceleration))
    if count:
        known = (np.abs(piece[np.isfinite(piece)]) for piece in series.pieces(acceleration))
        limit = sums.upper_quantile(known, count, 0.999)

        def usual(part: slice) -> Floats:
            values = acceleration[part]
            values[np.abs(values) > limit] = np.nan
            return look.in_units(q, values, "m/s2")

        out.append(Channel(f"acceleration ({q.unit('m/s2')})", Formed(len(samples), usual)))
    recorded = (
        (samples.position_m, f"position ({q.position})", lambda x: look.in_units(q, x, "m")),
        (samples.pressure_Pa, "absolute pressure (bar)", lambda x: x * 1e-5),
        (samples.temperature_degC, "temperature (°C)", lambda x: x),
    )
    for values, label, shown in recorded:
        if values is not None and np.isfinite(values).any() and np.nanmax(values) > np.nanmin(values):
            out.append(Channel(label, _as_shown(values, shown)))
    out.append(Channel("time (s)", result.time_s))
    return out


def _as_shown(values: Floats, shown: Callable[[Floats], Floats]) -> Series:
    return Formed(values.size, lambda part: shown(values[part]))


def _acceleration(result: Replay) -> Series:
    """Return the slope of the velocity from the sample before, m/s2; NaN at restarts and where no time passed."""
    samples, time_s = result.samples, result.time_s

    def of(part: slice) -> Floats:
        before = slice(max(0, part.start - 1), part.stop)
        nothing = [np.nan] * (part.start == 0)
        steps = [np.diff(values[before], prepend=nothing) for values in (samples.velocity_m_s, time_s)]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.where(samples.restart[part], np.nan, steps[0] / steps[1])
        slope[~np.isfinite(slope)] = np.nan
        return slope

    return Formed(len(samples), of)
