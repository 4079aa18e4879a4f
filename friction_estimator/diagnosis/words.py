"""Sentences: the experiment that would separate an effect from others, or tell what the drive did not."""

from collections.abc import Callable, Mapping, Sequence

from friction_estimator.diagnosis.causes import Cause
from friction_estimator.diagnosis.intervals import Estimate
from friction_estimator.diagnosis.trials import SEPARATES, Outcome
from friction_estimator.effects.base import EFFECTS

UNTOLD = 0.5
"""Share of an interval from which on what the drive did not tell makes most of it."""

Separation = Callable[[str], Sequence[Outcome]]
"""Name of a rival -> what each candidate drive would tell, the clearest first; empty where none can be simulated."""


def _unknown(_rival: str) -> Sequence[Outcome]:
    """No drive was simulated."""
    return ()


def next_experiment(name: str, rivals: tuple[str, ...], separation: Separation = _unknown) -> str | None:
    """Return the experiment that separates an effect from the first rival for which there is one, or None.

    The effects' own sentence is offered unless it means drives of which none separates the two when it is simulated;
    then the drive that separates them best is.
    """
    for rival in rivals:
        said = next(
            (
                EFFECTS[one].words.confused_with[other]
                for one, other in ((name, rival), (rival, name))
                if other in EFFECTS[one].words.confused_with
            ),
            "",
        )
        outcomes = separation(rival)
        meant = [o for o in outcomes if any(hint in said for hint in o.drive.hints)]
        if said and (not meant or any(o.share <= SEPARATES for o in meant)):
            return f"{name} or {rival}: {said}"
        clear = next((o for o in outcomes if o.share <= SEPARATES), None)
        if clear is not None:
            return f"{name} or {rival}: {clear.drive.words}"
        if not outcomes:
            return f"{name} or {rival}: record two periods, two strokes and two pressures in mixed order"
    return None


def telling_experiment(cause: Cause, fitted: Mapping[str, Estimate]) -> str | None:
    """Return the experiment that tells what the drive did not, where that makes most of an interval; else None."""
    words = EFFECTS[cause.name].words.told_by
    wide = (UNTOLD * (fitted[n].high - fitted[n].low) < most - least for n, (least, most) in cause.untold.items())
    return f"{cause.name}: {words}" if words and any(wide) else None
