"""Which of the causes that a search has found gain where everything is refitted on other samples."""

from dataclasses import replace

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.causes import Cause, Search
from friction_estimator.diagnosis.held_out import gain_between, held_out_errors
from friction_estimator.diagnosis.joint_fit import JointFit
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.features import Context


def gaining(found: Search, record: Record, context: Context, spread: float) -> tuple[Search, list[Floats], list[Cause]]:
    """Return a search without the causes that do not gain where all is refitted on other samples, its errors, and them.

    The search judges by a fit that is linear about its optimum; the gains that are told come from whole refits. One
    that does not gain before the later causes stays if it does beside them.
    """

    def doubted(before: Floats, after: Floats, term: Term) -> bool:
        return gain_between(before, after, record, spread, [term.effect]).low_percent <= 0.0

    errors = [held_out_errors(found.problem, context, m) for m in found.models]
    beside: set[str] = set()
    refuted: list[Cause] = []
    while True:
        doubtful = [
            i
            for i, cause in enumerate(found.causes)
            if cause.p_value is not None and cause.name not in beside
            if doubted(errors[i], errors[i + 1], found.models[i + 1].terms[-1])
        ]
        if not doubtful:
            return found, errors, refuted
        i = doubtful[-1]
        fewer = _without(found, i, context)
        left = errors[: i + 1] + [held_out_errors(fewer.problem, context, m) for m in fewer.models[i + 1 :]]
        if i + 1 < len(found.causes) and not doubted(left[-1], errors[-1], found.models[-1].terms[i]):
            beside.add(found.causes[i].name)
        else:
            refuted.append(found.causes[i])
            found, errors = fewer, left


def _without(found: Search, i: int, context: Context) -> Search:
    """Return the search without one of its causes, the later models fitted anew from where they are."""
    fit = JointFit(found.problem, context)
    later = [fit.without(model, i) for model in found.models[i + 2 :]]
    causes = (*found.causes[:i], *found.causes[i + 1 :])
    return replace(found, causes=causes, models=(*found.models[: i + 1], *later))
