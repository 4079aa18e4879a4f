"""The hypotheses of a diagnosis: every effect with a regressor, over its grid."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence, Moments, Rule
from friction_estimator.effects.base import Effect
from friction_estimator.effects.columns import RunningForce
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

AT_ONCE = 12
"""Hypotheses whose inner products are formed together."""


UNKNOWN_WITHOUT = ("pressure",)
"""Channels that nothing can stand in for where they are not recorded; the position is integrated from the velocity."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one point of its grid.

    Attributes
    ----------
    effect : class of the effect. params : its point. moments : of its columns. rule : on its coefficients.
    columns : (n, c), in single precision to save memory.
    """

    effect: type[Effect]
    params: dict[str, float]
    moments: Moments
    rule: Rule
    columns: NDArray[np.float32]

    @property
    def name(self) -> str:
        """Id of the effect."""
        return self.effect.name


def columns_of(effect: type[Effect], params: dict[str, float], features: Features, reference: Reference) -> Floats:
    """Return the columns of an effect over a whole record, (n, c)."""
    return effect.columns(params)(features, reference)


def with_running_force(features: Features, reference: Reference) -> Features:
    """Return the features with the base model's force."""
    return RunningForce(reference)(features)


def hypotheses(
    effect: type[Effect],
    points: Sequence[dict[str, float]],
    features: Features,
    reference: Reference,
    evidence: Evidence,
) -> list[Hypothesis]:
    """Return the hypotheses of one effect at several points, with their inner products."""
    out = []
    for start in range(0, len(points), AT_ONCE):
        part = points[start : start + AT_ONCE]
        groups = [columns_of(effect, params, features, reference) for params in part]
        for params, columns, moments in zip(part, groups, evidence.moments_of_many(groups), strict=True):
            signs = effect.signs if len(effect.signs) == columns.shape[1] else (0,) * columns.shape[1]
            rule = Rule(signs, effect.fixed_gain)
            out.append(Hypothesis(effect, params, moments, rule, columns.astype(np.float32)))
    return out


def build_library(
    catalogue: Mapping[str, type[Effect]],
    features: Features,
    reference: Reference,
    context: Context,
    evidence: Evidence,
    excluded: Iterable[str] = (),
) -> list[Hypothesis]:
    """Return all hypotheses, except those of excluded effects and those that the record lacks the channel for.

    Position-dependent ones are tried with the integrated velocity as well: they then ask for the channel.
    """
    out = set(excluded)
    found: list[Hypothesis] = []
    for name, cls in catalogue.items():
        if name in out or (cls.channel in UNKNOWN_WITHOUT and cls.channel not in context.channels):
            continue
        points = [*cls.grid(context), *cls.peaks(evidence.residual, features, context)]
        found += hypotheses(cls, points, features, reference, evidence)
    return found
