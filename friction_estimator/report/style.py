"""One look for all figures. Import this before drawing: it selects the backend that needs no screen."""

import os
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

SUFFIXES = (".png",)
"""Formats of the figures."""

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
    }
)


def save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure as PNG; return its path."""
    target = Path(path)
    figure.savefig(target, format="png")
    return target
