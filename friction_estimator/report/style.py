"""One look for all figures. Import this before drawing: it selects the backend that needs no screen."""

import os
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

FORMATS = ("png", "svg")
"""What figures may be written as (`--figures`)."""

USUAL = ("png",)

SUFFIXES = tuple(f".{name}" for name in FORMATS)
"""Of the files that figures are written to."""

MEASURED = "#8a8f98"
PREDICTED = "#c8471e"
THEORY = "#2b6cb0"
LEARNED = "#c8471e"
RESIDUAL = "#4a5560"
ACCENT = "#2f855a"
UNSUPPORTED = "#6b7280"

DENSITY = LinearSegmentedColormap.from_list("density", ["#e8eaee", "#8a8f98"])
"""Few samples to many."""

mpl.rcParams.update(
    {
        "figure.dpi": 110,
        "figure.constrained_layout.use": True,
        "font.size": 9,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": "#e3e6ea",
        "grid.linewidth": 0.6,
        "axes.axisbelow": True,
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "legend.frameon": False,
        "lines.linewidth": 1.2,
        "svg.hashsalt": "friction_estimator",
    }
)


def save(figure: Figure, folder: str | os.PathLike[str], name: str, formats: Sequence[str] = USUAL) -> Path:
    """Write a figure to `folder` in each format; return the first file. The same figure gives the same bytes."""
    paths = [Path(folder) / f"{name}.{each}" for each in formats]
    # Each writing would lay it out anew, and draw it once more for that: it is laid out here, and has no engine then.
    # That has to be the default meanwhile, to which every writing returns.
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        if (engine := figure.get_layout_engine()) is not None:
            engine.execute(figure)
            figure.set_layout_engine(None)
        for path, each in zip(paths, formats, strict=True):
            figure.savefig(path, format=each, metadata={"Date": None} if each == "svg" else None)
    return paths[0]


def readable_log(axis: Axis, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Have a logarithmic axis say 0.02, 0.05, 0.1 instead of powers of ten: `steps` of each decade."""
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
