"""The hypotheses of a diagnosis: every effect with a regressor, over its grid."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Evidence, Moments, Rule
from friction_estimator.effects.base import EFFECTS, Effect, RunningForce
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference

AT_ONCE = 12
"""Hypotheses whose inner products are formed together."""

LINES = 4
"""Spectral lines that are tried as periodic disturbances."""

LINE_LEVEL = 0.002


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
    for name, cls in EFFECTS.items():
        if name in out or (cls.channel == "pressure" and "pressure" not in context.channels):
            continue
        found += hypotheses(cls, cls.grid(context), features, reference, evidence)
    if "periodic_disturbance" in EFFECTS and "periodic_disturbance" not in out:
        lines = EFFECTS["periodic_disturbance"]
        peaks = spectral_lines(evidence.residual, features.time_s, context.step_s)
        found += hypotheses(lines, [{"frequency": f} for f in peaks], features, reference, evidence)
    return found


def spectral_lines(
    residual: Floats, time_s: Floats, step_s: float, count: int = LINES, level: float = LINE_LEVEL
) -> list[float]:
    """Return the frequencies of spectral lines, Hz, the clearest first.

    The spectrum is padded to twice the length. A peak's power is measured against the mean of its surroundings (from
    the median of 101 groups of neighbours, so that a coloured floor has no peaks); it is a line where noise, whose
    power is exponentially distributed, would exceed it anywhere with a probability below `level`. Gaps are filled
    with zeros where the recording is mostly whole.
    """
    place = np.round((time_s - time_s[0]) / step_s).astype(np.int64)
    if place[-1] < 2 * residual.size and np.all(np.diff(place) >= 0):
        even = np.zeros(int(place[-1]) + 1)
        even[place] = residual
        residual = even
    n = residual.size
    duration_s = n * step_s
    size = 1 << int(np.ceil(np.log2(2 * n)))
    power = np.square(np.abs(np.fft.rfft(residual, size)))
    frequency = np.fft.rfftfreq(size, step_s)
    group = max(1, size // (2 * n))
    coarse = power[: power.size // group * group].reshape(-1, group).mean(axis=1)
    padded = np.pad(coarse, 50, mode="reflect")
    floor = np.median(np.lib.stride_tricks.sliding_window_view(padded, 101), axis=1) / np.log(2.0)
    height = power[: floor.size * group] / np.maximum(np.repeat(floor, group), 1e-300)
    height[frequency[: height.size] < 3.0 / duration_s] = 0.0
    chosen: list[float] = []
    reach = 4 * size // n
    for _ in range(count):
        top = int(np.argmax(height))
        if height[top] < np.log(2.0 * n / level):
            break
        chosen.append(float(frequency[top]))
        height[max(0, top - reach) : top + reach + 1] = 0.0
    return chosen
