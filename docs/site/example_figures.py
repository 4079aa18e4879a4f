"""Good and bad figures, drawn from the recordings that ship with the project."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.core.online.replay import Replay, replay
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.report import figures, style
from friction_estimator.report.diagnosis_figures import write_diagnosis_figures

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Run:
    """A recording or a table that ships with the project, and the settings with which it is replayed."""

    file: str
    settings: tuple[tuple[str, object], ...] = ()


GOOD = Run("bags/demo")
LOADED = Run("docs/tutorial/monday.csv")
RESTLESS = Run("bags/demo", (("model.law", "lms"), ("lms.step_size", 0.05)))

PAIRS: dict[str, tuple[Run, Run]] = {
    "signals": (GOOD, LOADED),
    "convergence": (GOOD, LOADED),
    "friction_map": (GOOD, LOADED),
    "taps": (GOOD, RESTLESS),
}
"""Figure -> the run that makes a good one, and the run that makes a bad one."""

DRAWN: dict[str, Callable[[Replay], Figure]] = {
    "signals": lambda run: figures.signals(run, run.config.quantities),
    "convergence": figures.convergence,
    "friction_map": lambda run: figures.friction_map(run, run.config.quantities),
    "taps": figures.taps,
}


def markdown(folder: Path, address: str, name: str) -> str:
    """Draw a figure of both runs into `folder`/figures; return the good one and the bad one."""
    drawn = folder / "figures"
    drawn.mkdir(exist_ok=True)
    parts = []
    for kind, run in zip(("good", "bad"), PAIRS[name], strict=True):
        path = style.save(DRAWN[name](_replayed(run)), drawn, f"{name}_{kind}")
        caption = f"{kind.capitalize()}: {run.file}{''.join(f', {key} {value}' for key, value in run.settings)}"
        parts += [f"```{{figure}} {address}/figures/{path.name}", f":alt: {name}, {kind}", "", caption, "```", ""]
    return "\n".join(parts)


def diagnosis(folder: Path, address: str) -> str:
    """Diagnose a recording with a hidden mass, and return the figure of that cause."""
    drawn = folder / "figures"
    drawn.mkdir(exist_ok=True)
    samples = _samples("bags/crank_inertia", Config())
    result = diagnose([samples], Config())
    files = write_diagnosis_figures(result, drawn, Config().quantities)
    name = result.effects[0].name
    return f"![The residual before and after {name} was named]({address}/figures/{files[name].name})"


def _samples(file: str, config: Config) -> Samples:
    if not file.endswith(".csv"):
        return to_samples(read_recording(ROOT / file, config.input), config).samples
    time_ms, position_mm, velocity_mm_s, friction_N = np.loadtxt(ROOT / file, delimiter=",", skiprows=1).T
    stamp_ns = np.round(time_ms * 1e6).astype(np.int64)
    restart = np.arange(time_ms.size) == 0
    return Samples(stamp_ns, 1e-3 * velocity_mm_s, friction_N, restart, position_m=1e-3 * position_mm)


@cache
def _replayed(run: Run) -> Replay:
    config = Config.from_mapping(dict(run.settings))
    return replay(_samples(run.file, config), config)
