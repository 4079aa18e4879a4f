"""A replay, changed as tests want it."""

from dataclasses import replace
from typing import Any

from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.sample import Bools, Samples


def over(
    result: Replay,
    samples: Samples | None = None,
    learned: Bools | None = None,
    starts: tuple[int, ...] | None = None,
    **changes: Any,
) -> Replay:
    """The same model over another record."""
    record = RecordFigures.of(
        result.samples if samples is None else samples,
        result.learned if learned is None else learned,
        result.starts if starts is None else starts,
        result.estimator.model,
    )
    return replace(result, record=record, **changes)
