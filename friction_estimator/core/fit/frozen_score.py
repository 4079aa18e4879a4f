"""The judge of what was learned: error without learning, beside that of curves known from the textbook."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.baselines import BASELINES, StaticCurve, fit_baselines
from friction_estimator.core.sample import Bools, Floats, Samples

CURVES = ("coulomb_viscous", "stribeck", "stribeck_asymmetric")
"""The fitted curves that a model is read beside."""

RIVALS = (*CURVES, "persistence", "theory")
"""All that it is read beside: with the guess f[k-1], and the theoretical curve alone."""


@dataclass(frozen=True)
class FrozenScore:
    """Errors of a model that does not learn and of its rivals, on the same samples.

    Attributes
    ----------
    samples : number of samples that the figures are of.
    spread_N : standard deviation of the measured friction over them, N: nrmse times this is the rms error.
    nrmse : of the model; NaN where friction is constant.
    baselines : nrmse of each of `RIVALS`; None where there is none: no theory, or nothing that a curve could be
        fitted to.
    """

    samples: int
    spread_N: float
    nrmse: float
    baselines: Mapping[str, float | None]


def curves_learned(
    velocity_m_s: Floats,
    friction_N: Floats,
    learned: Bools | None = None,
    names: Collection[str] = tuple(BASELINES),
) -> dict[str, StaticCurve]:
    """Return the textbook's curves, or some, fitted to the samples (n,) m/s, (n,) N, or to those learned from, (n,).

    Empty where none can be fitted.
    """
    try:
        return fit_baselines(velocity_m_s, friction_N, names, use=learned)
    except UnanswerableError:
        return {}


def frozen_score(
    samples: Samples,
    predicted_N: Floats,
    theory_N: Floats | metrics.Prediction | None,
    scored: Bools,
    curves: Mapping[str, StaticCurve],
) -> FrozenScore:
    """Score a model and its rivals on the same part of a record.

    Parameters
    ----------
    samples : n samples in order; the guess f[k-1] may look at the one before the part that is scored.
    predicted_N, theory_N : (n,), N; theory_N, or what returns it in a part, None where the model has no theory.
    scored : (n,), which samples count. Leave out those whose delay lines are not filled by measurement
        (`metrics.settled`); all rivals are judged on the same ones.
    curves : as `curves_learned` returns them.
    """
    measured, velocity = samples.friction_N, samples.velocity_m_s
    baselines: dict[str, float | None] = dict.fromkeys(RIVALS)
    spread_N = metrics.spread(measured, scored)
    for name in CURVES:
        if name in curves:
            baselines[name] = metrics.nrmse(measured, curves[name].over(velocity), scored, spread_N)
    baselines["persistence"] = metrics.nrmse_persistence(samples.friction_N, samples.restart | ~scored)
    if theory_N is not None:
        baselines["theory"] = metrics.nrmse(measured, theory_N, scored, spread_N)
    return FrozenScore(
        samples=int(np.count_nonzero(scored)),
        spread_N=spread_N,
        nrmse=metrics.nrmse(measured, predicted_N, scored, spread_N),
        baselines=baselines,
    )
