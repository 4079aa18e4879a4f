"""The charts of `replay`, of the demonstration and of `identify`."""

import numpy as np

from friction_estimator.core import series
from friction_estimator.core.online.replay import Judged, Replay
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.series import RunningTime
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.report.page import curves, envelope, learning, signals
from friction_estimator.report.page.content import Chart

OTHERS_ROWS, OTHERS_CLOSE = 12_000, 5_000
"""Rows of extremes, and samples of a cycle kept in full, of all other recordings together."""

MOST_OTHERS = 3
"""Other recordings that are drawn over time; the table has all."""


def replay_charts(result: Replay, q: Quantities, fitted: bool) -> dict[str, list[Chart]]:
    """Return the charts of a replay by the part of the page: time, map, error, left, taps."""
    return {
        "time": _over_time(result, q, fitted),
        "map": [curves.friction_map(result, q)],
        "error": [learning.error_by_cycle(result, q, fitted)],
        "left": _left(result, q),
        "taps": _taps(result),
    }


def _over_time(result: Replay, q: Quantities, fitted: bool) -> list[Chart]:
    seconds = result.time_s
    marks = [(series.one(seconds, s), f"recording {k}") for k, s in enumerate(result.starts[1:], start=2)]
    held = np.flatnonzero(result.learned[:-1] > result.learned[1:])  # >: and not
    marks += [(series.one(seconds, k + 1), "learning stops") for k in held[:1].tolist()]
    main = signals.Signals(
        seconds,
        result.samples.restart,
        result.samples.velocity_m_s,
        result.samples.friction_N,
        {"fitted" if fitted else "predicted": result.predicted_N},
        {"fitted" if fitted else "predicted": result.residual_N},
        result.deviation_N,
        signals.cycles_of(result.samples.velocity_m_s, result.residual_N, result.parts),
        marks,
    )
    said = (
        "All samples were known to the fit. "
        if fitted
        else "Every prediction was made before its measurement was used. "
    )
    rows = envelope.FINEST if not result.others else envelope.FINEST - OTHERS_ROWS
    out = [signals.chart("What was fitted" if fitted else "What was learned from", said + _HOW, main, q, rows)]
    for other in result.others[:MOST_OTHERS]:
        out.append(_other(other, q, min(len(result.others), MOST_OTHERS)))
    return out


_HOW = (
    "Drag to move, hold Ctrl and turn the wheel to zoom, or use the buttons; with the chart in focus the arrow keys "
    "move, + and - zoom, , and . step the cursor, 0 shows all. Gaps in the recording are gaps in the lines."
)


def _other(other: Judged, q: Quantities, number: int) -> Chart:
    samples = other.samples
    residual = series.difference(samples.friction_N, other.predicted_N)
    seconds = RunningTime(samples.stamp_ns)
    shown_signals = signals.Signals(
        seconds,
        samples.restart,
        samples.velocity_m_s,
        samples.friction_N,
        {"predicted": other.predicted_N},
        {"predicted": residual},
        None,
        signals.cycles_of(samples.velocity_m_s, residual, [slice(0, len(samples))]),
    )
    return signals.chart(
        f"Without learning: {shown(other.name, LONGEST_NAME)}",
        "Another recording, predicted with what was learned; nothing of it was used.",
        shown_signals,
        q,
        OTHERS_ROWS // number,
        OTHERS_CLOSE // number,
    )


def _left(result: Replay, q: Quantities) -> list[Chart]:
    residual = signals.readable_force(q, result.residual_N, signals.usual_force_N(result.samples.friction_N))
    late = residual.size // 5  # the first fifth shows how it was learned, not what the model cannot know
    which = "all samples after the first fifth of the record"
    return [curves.against(channel, residual, late, q, which) for channel in curves.channels(result, q)]


def _taps(result: Replay) -> list[Chart]:
    last = result.parameters
    out = []
    if last.theory_taps.size:
        values = [p.theory_taps for p in result.snapshots]
        out.append(learning.taps(result, "Theory taps: behind the theoretical curve", values, "the theoretical curve"))
    values = [p.fir_taps for p in result.snapshots]
    return [*out, learning.taps(result, "FIR taps: behind the learned curve g", values, "the learned curve g")]
