"""How far to trust a replay or a fit: its errors, the light with its reason, and advice where it is not green."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from friction_estimator.core import metrics, sums
from friction_estimator.core.fit.frozen_score import CURVES, FrozenScore
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.online.shortcomings import GOOD_NRMSE, ONE_DIRECTION
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Floats
from friction_estimator.core.text import number
from friction_estimator.report import figures
from friction_estimator.report.page.content import CAUTION, GOOD, STOP, Advice, Light

CLEARLY = 1.05
"""A rival that is closer by less than this factor is as good, not better."""

LEAST_COVERED = 0.8
"""Share of the velocities that occur which data must support."""

MOST_OUTSIDE = 0.01
"""Share of another recording's samples at velocities never learned: a hundredth of them made 98 % of an error there."""


@dataclass(frozen=True)
class Finding:
    """Something that a reader must know before relying on the result."""

    level: str
    reason: str
    advice: Advice


@dataclass(frozen=True)
class Errors:
    """Rms errors over the last fifth of what was learned from, N, and the friction's spread there."""

    model: float
    spread: float
    rivals: Mapping[str, float]

    @property
    def share(self) -> float:
        """The model's error over the spread."""
        return self.model / self.spread if self.spread > 0.0 else float("nan")


def errors_at_the_end(result: Replay) -> Errors:
    """Return the errors over the last fifth: of the model, the mean, the last value, the theory and the known curve."""
    samples = result.samples
    part = slice(len(samples) - max(2, len(samples) // 5), None)
    measured, residual = samples.friction_N[part], result.residual_N[part]

    def rms(error: np.ndarray) -> float:
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.sqrt(np.mean(np.square(error)))) if error.size else float("nan")

    follows = ~samples.restart[part][1:]
    rivals = {"persistence": rms(np.diff(measured)[follows])}
    if result.theory_in is not None:
        rivals["theory"] = rms(measured - result.theory_in(part))
    known = result.learned if result.learned.any() else np.broadcast_to(np.bool_(True), result.learned.shape)
    count = int(np.count_nonzero(known))
    rivals["mean"] = rms(measured - sums.total(sums.chosen(samples.friction_N, known), count) / count)
    if "coulomb_viscous" in result.baseline_curves:
        curve = result.baseline_curves["coulomb_viscous"]
        rivals["coulomb_viscous"] = rms(measured - curve.evaluate(samples.velocity_m_s[part]))
    return Errors(rms(residual), metrics.spread(measured), rivals)


NAMES = {
    "persistence": "the guess that friction stays as it was one sample ago",
    "theory": "the theoretical curve alone",
    "coulomb_viscous": "Coulomb and viscous friction fitted to the same samples",
    "mean": "the mean of what was learned from",
}
"""Rival -> how a sentence calls it."""


def trust(
    result: Replay, scores: list[tuple[str, FrozenScore]], q: Quantities, *, fitted: bool, diverged: bool
) -> tuple[Light, list[Advice]]:
    """Return the light and the advice.

    Parameters
    ----------
    scores : what was predicted without learning, by name. fitted : True for a batch fit, whose samples were all known.
    diverged : as `Replay.figures` has it.
    """
    found = [
        *_ending(result, q, fitted, diverged),
        *_elsewhere(scores, q, metrics.spread(result.samples.friction_N, result.learned)),
        *_theory(result),
        *_direction(result, q),
        *_covered(result, q),
        *(Finding(CAUTION, one.text, Advice(_sentence(one.advice))) for one in result.shortcomings),
    ]
    if not scores:
        found.append(
            Finding(
                CAUTION,
                "it was fitted to these samples and judged by them: nothing says yet how it does on another drive"
                if fitted
                else "every figure is of a model that goes on learning: nothing says yet how it does on another drive",
                Advice(
                    "Judge it without learning, by another recording (--test) or by the second half of this one "
                    "(--freeze-after 0.5).",
                    "--test",
                ),
            )
        )
    stops = [one for one in found if one.level == STOP]
    if stops:
        light = Light(STOP, _reasons(stops))
    elif found:
        light = Light(CAUTION, _reasons(found))
    else:
        light = Light(GOOD, _good(scores))
    return light, [one.advice for one in sorted(found, key=lambda one: one.level != STOP)]


def _good(scores: list[tuple[str, FrozenScore]]) -> str:
    """Return why nothing speaks against it."""
    worst = max(score.nrmse for _, score in scores)
    ratios = [
        score.nrmse / value
        for _, score in scores
        for key in CURVES
        if (value := score.baselines.get(key)) is not None and value > 0.0
    ]
    beside = "no simple curve could be fitted to compare it with"
    if ratios:
        beside = "no simple curve (Coulomb and viscous, Stribeck) is closer"
        beside += f" by more than {100 * (CLEARLY - 1.0):.0f} %" if max(ratios) > 1.0 else ""
    return (
        f"Without learning it errs by at most {number(100 * worst, '.2g')} % of the spread, {beside}, and at most "
        f"{100 * MOST_OUTSIDE:.0f} % of the samples are at velocities that it never saw."
    )


def _reasons(found: list[Finding]) -> str:
    return _sentence("; ".join(one.reason for one in found))


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _ending(result: Replay, q: Quantities, fitted: bool, diverged: bool) -> list[Finding]:
    """Judge the end of what was learned from."""
    errors = errors_at_the_end(result)
    if diverged or not np.isfinite(errors.model):
        text = "Lower the step size of this law, or take the default law, which bounds its steps by itself."
        return [Finding(STOP, "the estimate diverged", Advice(text, "--law rls"))]
    # Not the mean of these samples, which nobody knew: where the drive ends at one speed, only noise is left about it.
    if errors.model >= errors.rivals["mean"]:
        text = "Check which topic, axis, joint and sign are read, and that clocks agree: friction_estimator info tells."
        return [Finding(STOP, "it is no better than always saying the mean", Advice(text))]
    out = []
    known = errors.rivals.get("coulomb_viscous")
    if known is not None and errors.model > CLEARLY * known:
        reason = f"{NAMES['coulomb_viscous']} is closer ({q.text(known, FORCE, '.2g')} rms)"
        text = "Record longer, with speeds that vary within a stroke; until then use the simple curve."
        out.append(Finding(STOP, reason, Advice(text)))
    guess = errors.rivals["persistence"]
    if errors.model > CLEARLY * guess and not fitted:
        reason = f"{NAMES['persistence']} is closer ({q.text(guess, FORCE, '.2g')} rms)"
        text = (
            "Where friction is measured anyway, the last value predicts the next one better. The model serves where "
            "it is not measured: compensation, simulation, watching for change."
        )
        out.append(Finding(CAUTION, reason, Advice(text)))
    return out


def _elsewhere(scores: list[tuple[str, FrozenScore]], q: Quantities, learned_spread_N: float) -> list[Finding]:
    """Judge what was predicted without learning."""
    out = []
    for name, score in scores:
        known = score.baselines.get("coulomb_viscous")
        error = score.nrmse * score.spread_N
        if score.nrmse >= 1.0 and error < GOOD_NRMSE * learned_spread_N:
            reason = f"friction hardly varies on {name}, so its mean, known afterwards, is as close as the model"
            text = "Judge it by a recording whose speed varies: at one speed any curve through that point does as well."
            out.append(Finding(CAUTION, f"{reason} ({q.text(error, FORCE, '.2g')} rms)", Advice(text)))
        elif not score.nrmse < 1.0:
            text = (
                "Learn from a recording with this drive's speeds and pressures; what was learned does not hold there."
            )
            out.append(Finding(STOP, f"without learning it is no better than the mean on {name}", Advice(text)))
        elif known is not None and score.nrmse > CLEARLY * known:
            rms = q.text(known * score.spread_N, FORCE, ".2g")
            text = "Learn from both drives, or export the simple curve for this one."
            out.append(Finding(STOP, f"{NAMES['coulomb_viscous']} is closer on {name} ({rms} rms)", Advice(text)))
        else:
            out += _stribeck(name, score, q)
    return out


def _stribeck(name: str, score: FrozenScore, q: Quantities) -> list[Finding]:
    """Judge by the better one of the two Stribeck curves."""
    known = [value for key in ("stribeck", "stribeck_asymmetric") if (value := score.baselines.get(key)) is not None]
    if not known or score.nrmse <= CLEARLY * min(known):
        return []
    rms = q.text(min(known) * score.spread_N, FORCE, ".2g")
    text = "Learn from both drives, or use the simpler curve there: friction_estimator export writes one."
    return [
        Finding(CAUTION, f"a Stribeck curve fitted to what was learned is closer on {name} ({rms} rms)", Advice(text))
    ]


def _theory(result: Replay) -> list[Finding]:
    """Judge the theoretical curve."""
    if result.theory_in is None:
        return []
    alone = metrics.nrmse(result.samples.friction_N, result.theory_in)
    if alone < 1.0:
        return []
    text = (
        "Set the machine's own data (seal.*, or theory.table), or do without: theory.kind none. The model has learned "
        "to correct the curve, but outside of what it saw it falls back on it."
    )
    error = number(100 * alone, ".3g")
    reason = f"the theoretical curve is not of this machine (alone it errs by {error} % of the spread)"
    return [Finding(CAUTION, reason, Advice(text))]


def _direction(result: Replay, q: Quantities) -> list[Finding]:
    """Judge whether both directions were learned from."""
    if not result.one_way:
        return []
    text = "Record strokes both ways, or tare the {force} sensor before; use the curve in the direction learned only."
    return [Finding(CAUTION, q.worded(ONE_DIRECTION), Advice(q.worded(text)))]


def _covered(result: Replay, q: Quantities) -> list[Finding]:
    """Judge whether data support the velocities that are asked for."""
    out = []
    curve, v = result.outlook, result.samples.velocity_m_s
    inside = (curve.velocity_m_s >= v.min()) & (curve.velocity_m_s <= v.max())
    share = float(figures.supported(curve, result.curve)[inside].mean()) if inside.any() else 1.0
    if share < LEAST_COVERED:
        ends = q.range_text((float(v.min()), float(v.max())), VELOCITY, ".3g")
        text = "Record strokes that pass through all speeds slowly enough; the grey parts of the map are missing."
        out.append(Finding(CAUTION, f"data support only {100 * share:.0f} % of the velocities {ends}", Advice(text)))
    low, high = result.curve.velocity_m_s[0], result.curve.velocity_m_s[-1]
    asked = {other.name: other.samples.velocity_m_s for other in result.others}
    if result.learned.any() and not result.learned.all():
        asked = {"what was not learned from": v[~result.learned], **asked}
    for name, velocity in asked.items():
        beyond = _outside(velocity, low, high)
        if beyond > MOST_OUTSIDE:
            text = "Beyond the velocities learned the curve is a guess: learn from a recording that has them."
            reason = f"{number(100 * beyond, '.2g')} % of {name} is at velocities never learned"
            out.append(Finding(CAUTION, reason, Advice(text)))
    return out


def _outside(velocity_m_s: Floats, low: float, high: float) -> float:
    return float(np.mean((velocity_m_s < low) | (velocity_m_s > high)))
