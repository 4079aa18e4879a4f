"""The plots of `make bench`, from the figures of bench.json: one file a part, named after it."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from bounds import difference, ratio
from matplotlib.ticker import NullLocator
from page import medians

Figures = Mapping[str, Any]

BLUE, RED, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#777777"


def draw(every: Figures, out: Path) -> list[str]:
    """Write the plots of the parts that are there; return their names."""
    matplotlib.use("agg")
    drawn = []
    for name, (panels, height, drawing) in PLOTS.items():
        if name in every:
            figure, axes = plt.subplots(1, panels, figsize=(9.0, height), layout="constrained", squeeze=False)
            drawing(axes[0], every[name])
            for axis in axes[0]:
                axis.grid(alpha=0.3)
            figure.savefig(out / f"{name}.png", dpi=110, metadata={"Software": None})
            plt.close(figure)
            drawn.append(f"{name}.png")
    return drawn


def sized(axis: Any, sizes: Sequence[float], label: str) -> None:
    """Name the sizes themselves on a logarithmic axis."""
    axis.set_xscale("log")
    axis.set_xticks(sizes, [f"{size:.0e}".replace("e+0", "e") if size >= 10_000 else f"{size:g}" for size in sizes])
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel(label)


def sizes(axes: Sequence[Any], figures: Figures) -> None:
    for axis, (name, label) in zip(axes, {"weights": "weights", "taps": "FIR taps"}.items(), strict=True):
        for (law, one), colour in zip(figures[name].items(), (BLUE, RED, GREEN), strict=True):
            axis.loglog(one["size"], medians(one["loop_us"]), "o-", color=colour, label=law, markersize=4)
            if "C_us" in one:
                axis.loglog(
                    one["size"], medians(one["C_us"]), "s--", color=colour, label=f"{law}, C", markersize=3, alpha=0.6
                )
            sized(axis, one["size"], label)
        axis.set_ylabel("processor time, us a sample")
    axes[0].legend(fontsize=8)


def long(axes: Sequence[Any], figures: Figures) -> None:
    grown = figures["growth"]
    count = grown["samples"]
    for name, colour in (("replay, rls", BLUE), ("replay --out", RED)):
        start, found = grown[name]["start"], grown[name]["sizes"]
        took = [median(difference(one["cpu"], start["cpu"])) for one in found]
        axes[0].plot(count, took, "o-", color=colour, label=name, markersize=4)
        axes[1].plot(count, [max(one["memory"]) for one in found], "o-", color=colour, label=name, markersize=4)
        axes[1].axhline(max(start["memory"]), color=colour, linestyle=":", label=f"start of {name}")
    axes[0].set_yscale("log", nonpositive="mask")
    axes[0].set_ylabel("processor time without start, s")
    axes[1].set_ylabel("largest resident set, MB")
    axes[1].set_ylim(bottom=0.0)
    for axis in axes:
        sized(axis, count, "samples")
        axis.legend(fontsize=8)


def node(axes: Sequence[Any], figures: Figures) -> None:
    """Show every round: how far they differ is what a ratio of two can be worth."""
    names = list(figures["variants"])
    for axis, (key, label) in zip(
        axes, {"cpu_us": "processor time a pair, us", "p99_us": "p99 of the round trip, us"}.items(), strict=True
    ):
        for place, name in enumerate(names):
            rounds = figures["variants"][name][key]
            axis.plot(rounds, [place] * len(rounds), "o", color=BLUE, alpha=0.5, markersize=5)
            axis.plot([median(rounds)] * 2, [place - 0.3, place + 0.3], color=RED)
        axis.set_xscale("log")
        axis.set_xlabel(label)
        axis.set_yticks(range(len(names)), names if axis is axes[0] else [])
        axis.invert_yaxis()
        low, high = axis.get_xlim()
        nice = [value for value in (TICKS if high < ROOMY * low else TICKS[::3]) if low <= value <= high]
        axis.set_xticks(nice, [f"{value:g}" for value in nice])
        axis.xaxis.set_minor_locator(NullLocator())


TICKS = [digit * 10**power for power in range(1, 6) for digit in (1, 2, 5)]

ROOMY = 100.0
"""Ends of an axis whose ratio is larger have room for powers of ten alone."""


def many(axes: Sequence[Any], figures: Figures) -> None:
    recordings = figures["recordings"]
    clocks = [median(cost["clock"]) for cost in recordings["costs"]]
    axes[0].plot(recordings["size"], clocks, "o-", color=BLUE, label="diagnose --each, one process", markersize=4)
    axes[0].set_xticks(recordings["size"])
    axes[0].set_xlabel("recordings")
    axes[0].set_ylabel("time by the clock, s")
    axes[0].set_ylim(bottom=0.0)
    axes[0].legend(fontsize=8)
    most = 1
    for (name, verb), colour in zip(figures["verbs"].items(), (BLUE, RED), strict=True):
        one = verb["processes"][0]["clock"]
        counts = verb["workers"]
        most = max(most, *counts)
        faster = [ratio(one, cost["clock"]) for cost in verb["processes"]]
        axes[1].plot(counts, faster, "o-", color=colour, label=name, markersize=4)
        dask = ratio(one, verb["dask"]["clock"])
        axes[1].plot([figures["dask_workers"]], [dask], "x", color=colour, label=f"{name}, Dask", markersize=7)
    axes[1].plot([1, most], [1, most], ":", color=GREY, label="as many times as workers")
    axes[1].set_xticks(counts)
    axes[1].set_xlabel("workers")
    axes[1].set_ylabel("speed over one process")
    axes[1].legend(fontsize=8)


PLOTS: dict[str, tuple[int, float, Callable[[Sequence[Any], Figures], None]]] = {
    "sizes": (2, 3.6, sizes),
    "long": (2, 3.6, long),
    "node": (2, 2.8, node),
    "many": (2, 3.6, many),
}
"""Panels, height (inches) and drawing by part."""
