"""The diagnosis as plain data (`diagnose --json`) and as sentences for a test engineer."""

from collections.abc import Mapping, Sequence
from typing import Any

from friction_estimator.diagnosis.diagnose import Diagnosis, Found
from friction_estimator.effects.base import EFFECTS

SCHEMA = "friction_estimator/diagnosis/1"


def as_json(
    result: Diagnosis, bags: Sequence[str], figures: Mapping[str, str], extended_model: str | None
) -> dict[str, Any]:
    """Return the JSON of INTERFACE section 2.

    Parameters
    ----------
    bags : as they were given. figures : effect id -> file; missing ones become "". extended_model : file or None.
    """
    excitation = result.excitation
    return {
        "schema": SCHEMA,
        "bags": list(bags),
        "verdict": result.verdict,
        "excitation": {
            "cycles": excitation.cycles,
            "velocity_range": list(excitation.velocity_range),
            "reversals": excitation.reversals,
            "channels": list(excitation.channels),
            "warnings": list(excitation.warnings),
        },
        "base": {"nrmse_holdout": result.nrmse_holdout, "noise_floor": result.noise_floor},
        "effects": [_effect(found, figures.get(found.name, "")) for found in result.effects],
        "needs_channel": [{"name": name, "channel": channel} for name, channel in result.needs_channel],
        "unexplained_percent": result.unexplained_percent,
        "extended_model": extended_model,
    }


def _effect(found: Found, figure: str) -> dict[str, Any]:
    gain = found.gain
    return {
        "name": found.name,
        "p_value": found.p_value,
        "parameters": {
            name: {"value": e.value, "unit": e.unit, "ci95": [e.low, e.high]} for name, e in found.parameters.items()
        },
        "gain": {
            "nrmse_before": gain.nrmse_before,
            "nrmse_after": gain.nrmse_after,
            "reduction_percent": gain.reduction_percent,
            "ci95_percent": [gain.low_percent, gain.high_percent],
        },
        "indistinguishable_from": list(found.rivals),
        "next_experiment": found.experiment,
        "figure": figure,
    }


def sentence(found: Found) -> str:
    """Return what was found, in one or two sentences."""
    words = EFFECTS[found.name].words
    values = ", ".join(
        f"{name.replace('_', ' ')} {e.value:.4g}{' ' + e.unit if e.unit else ''} ({e.low:.4g} to {e.high:.4g})"
        for name, e in found.parameters.items()
    )
    text = f"{words.what[0].upper()}{words.what[1:]}: {values}. Seen in this: {found.evidence}."
    gain = found.gain
    if gain.reduction_percent > 0.0:
        text += (
            f" On data that the fit never saw the error falls from {100 * gain.nrmse_before:.2f} to "
            f"{100 * gain.nrmse_after:.2f} % of the friction's spread, by {gain.reduction_percent:.1f} % "
            f"({gain.low_percent:.1f} to {gain.high_percent:.1f})."
        )
    if found.rivals:
        text += f" These data cannot tell it from {', '.join(found.rivals)}."
    if found.experiment:
        text += f" Next experiment: {found.experiment}."
    return text


def sentences(result: Diagnosis) -> list[str]:
    """Return the whole diagnosis in sentences."""
    lines = []
    if result.verdict == "undecidable":
        lines.append("These recordings cannot answer.")
    elif result.verdict == "nothing_found":
        limits = sorted(result.detection_limit_N.items(), key=lambda item: item[1])
        lines.append(
            f"Nothing found: the base model leaves {100 * result.nrmse_holdout:.2f} % of the friction's spread, and "
            f"the noise alone is {100 * result.noise_floor:.2f} %. {len(limits)} causes were tried."
        )
        if limits:
            shown = "; ".join(f"{name} {value:.2g} N" for name, value in limits)
            lines.append(f"Changes larger than this (rms) would have been named: {shown}.")
    else:
        lines += [f"{i}. {found.name}: {sentence(found)}" for i, found in enumerate(result.effects, 1)]
        lines.append(f"Left above the noise floor: {result.unexplained_percent:.1f} % of the held-out error.")
    lines += [f"{EFFECTS[n].words.what} may be the cause: record {c} to know" for n, c in result.needs_channel]
    lines += [f"Note: {text}." for text in result.excitation.warnings]
    return lines
