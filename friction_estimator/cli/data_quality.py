"""What the data of a run are like, as a table of a page: rates, gaps, stamps, and what was refused."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from friction_estimator.bag.recording import Recorded
from friction_estimator.bag.statistics import StreamStatistics, figures_of
from friction_estimator.core.quantities import FORCE, POSITION, VELOCITY, Quantities
from friction_estimator.core.settings.config import Config
from friction_estimator.core.text import number
from friction_estimator.report.page.content import Section

HEAD = ("input", "topic", "messages", "rate", "jitter", "gaps", "longest step", "stamps", "range")

UNITS = {"velocity": VELOCITY, "friction": FORCE, "position": POSITION, "pressure": "Pa", "temperature": "degC"}

FAULTS = ("zero_stamps", "duplicate_stamps", "backward_stamps", "clock_jumps", "nan", "infinite", "missing")


def data_quality(recordings: Sequence[Recorded], config: Config, q: Quantities, counts: Mapping[str, Any]) -> Section:
    """Return the section; `counts` is `samples` of the JSON."""
    rows: list[Sequence[object]] = [HEAD]
    notes: list[str] = []
    for place_in_order, recording in enumerate(recordings, start=1):
        figures = figures_of(recording, config.sync)
        place = f"{place_in_order}. " if len(recordings) > 1 else ""
        for name, stream in recording.streams.items():
            stamps = "of the header" if stream.stamped else "none: time of recording"
            rows.append((place + name, stream.topic, len(stream), *_figures(figures[name], stamps, name, q)))
        notes += [f"{recording.path}: {note}." for note in recording.notes]
    refused = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts["rejected"].items())
    used = f"{counts['used']} samples used of {counts['read']}; refused: {refused or 'none'}."
    return Section("The data", [used, *notes], rows)


def _figures(figures: StreamStatistics, stamps: str, name: str, q: Quantities) -> tuple[str, ...]:
    found = [f"{getattr(figures, fault)} {fault.replace('_', ' ')}" for fault in FAULTS if getattr(figures, fault)]
    unit = UNITS.get(name, "")
    low, high = (q.value(value, unit) for value in (figures.lowest, figures.highest))
    return (
        _number(figures.rate_hz, "Hz"),
        _number(1e3 * figures.jitter_s, "ms"),
        str(figures.gaps),
        _time(figures.longest_gap_s),
        "; ".join([stamps, *found]),
        f"{number(low, '.4g')} to {number(high, '.4g')} {q.unit(unit)}" if np.isfinite(low) else "-",
    )


def _time(seconds: float) -> str:
    return _number(seconds, "s") if seconds >= 1.0 else _number(1e3 * seconds, "ms")


def _number(value: float, unit: str) -> str:
    return f"{number(value, '.4g')} {unit}" if np.isfinite(value) else "-"
