"""Sentences: the experiment that would separate an effect from what the data cannot tell it from."""

from friction_estimator.effects.base import EFFECTS


def next_experiment(name: str, rivals: tuple[str, ...]) -> str | None:
    """Return the experiment that separates an effect from its first rival, or None where there is none."""
    for rival in rivals:
        for one, other in ((name, rival), (rival, name)):
            said = EFFECTS[one].words.confused_with.get(other)
            if said:
                return f"{name} or {rival}: {said}"
    if rivals:
        return f"{name} or {rivals[0]}: record two periods, two strokes and two pressures in mixed order"
    return None
