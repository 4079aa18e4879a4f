"""The diagnosis as plain data (`diagnose --json`) and as sentences for a test engineer."""

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.text import number
from friction_estimator.diagnosis.advice import on_unexplained
from friction_estimator.diagnosis.held_out import Gain
from friction_estimator.diagnosis.result import NOTHING_FOUND, UNDECIDABLE, UNEXPLAINED, Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault

SCHEMA = "friction_estimator/diagnosis/2"


def as_json(
    result: Diagnosis,
    bags: Sequence[str],
    figures: Mapping[str, str],
    extended_model: str | None,
    quantities: Quantities,
) -> dict[str, Any]:
    """Return the JSON of a diagnosis.

    Parameters
    ----------
    bags : as they were given. figures : effect id -> file; missing ones become "". extended_model : file or None.
    quantities : of the drive; the JSON is in SI units whatever the reader chose.
    """
    q, excitation = quantities.si, result.excitation
    return {
        "schema": SCHEMA,
        "bags": list(bags),
        "units": q.names,
        "verdict": result.verdict,
        "excitation": {
            "cycles": excitation.cycles,
            "velocity_range": list(excitation.velocity_range),
            "reversals": excitation.reversals,
            "channels": list(excitation.channels),
            "warnings": [q.worded(text) for text in excitation.warnings],
            "notes": [q.worded(text) for text in excitation.notes],
        },
        "base": {"nrmse_holdout": result.nrmse_holdout, "noise_floor": result.noise_floor},
        "faults": [_fault(fault, figures.get(fault.name, ""), q) for fault in result.faults],
        "effects": [_effect(found, figures.get(found.name, ""), q) for found in result.effects],
        "total_gain": _gain(result.total_gain),
        "traces": [{"name": trace.name, "share_percent": trace.share_percent} for trace in result.traces],
        "needs_channel": [{"name": name, "channel": channel} for name, channel in result.needs_channel],
        "unexplained_percent": result.unexplained_percent,
        "extended_model": extended_model,
    }


def _fault(fault: Fault, figure: str, quantities: Quantities) -> dict[str, Any]:
    return {
        "name": fault.name,
        "evidence": quantities.worded(fault.evidence),
        "parameters": {
            name: {"value": value, "unit": quantities.unit(unit), "ci95": [low, high]}
            for name, (value, unit, low, high) in fault.parameters.items()
        },
        "repaired": quantities.worded(fault.repaired),
        "figure": figure,
    }


def _effect(found: Found, figure: str, quantities: Quantities) -> dict[str, Any]:
    return {
        "name": found.name,
        "p_value": found.p_value,
        "parameters": {
            name: {"value": e.value, "unit": quantities.unit(e.unit), "ci95": [e.low, e.high]}
            for name, e in found.parameters.items()
        },
        "gain": _gain(found.gain),
        "indistinguishable_from": list(found.rivals),
        "next_experiment": found.experiment and quantities.worded(found.experiment),
        "figure": figure,
    }


def _gain(gain: Gain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {
        "nrmse_before": gain.nrmse_before,
        "nrmse_after": gain.nrmse_after,
        "reduction_percent": gain.reduction_percent,
        "ci95_percent": [gain.low_percent, gain.high_percent],
    }


def judged_by(
    bags: Sequence[str], extended_model: str | None, config: str | None, options: Sequence[str] = ()
) -> list[str]:
    """Return in words how the extended model is judged on a recording that it has not seen, nothing where none is.

    Parameters
    ----------
    bags : that were diagnosed. extended_model : file or None. config : of the diagnosis, or None.
    options : others that say how the recordings are read, such as --topic.
    """
    if extended_model is None:
        return []
    learned = shlex.join(["friction_estimator", "replay", *bags, "--test", "OTHER", *options])
    given = f" --config {shlex.quote(config)}" if config else ""
    return [
        "To judge the extended model on a recording OTHER that neither has seen, compare the test errors of these two:",
        f"{learned}{given}",
        f"{learned} --config {shlex.quote(extended_model)}",
    ]


UNSIZED = "Its interval reaches 0: it is there, but how large it is these data do not tell."


def sentence(found: Found, quantities: Quantities) -> str:
    """Return what was found, in one or two sentences."""
    words = EFFECTS[found.name].words
    values = ", ".join(
        _quantity(quantities, name, e.value, e.unit, e.low, e.high) for name, e in found.parameters.items()
    )
    text = f"{words.what[0].upper()}{words.what[1:]}: {values}. Seen in this: {found.evidence}."
    if found.gain is not None:
        text += f" {_gained(found.gain)}"
    if not found.sized:
        text += f" {UNSIZED}"
    if found.rivals:
        text += f" These data cannot tell it from {', '.join(found.rivals)}."
    if found.experiment:
        text += f" Next experiment: {found.experiment}."
    return quantities.worded(text)


def fault_sentence(fault: Fault, quantities: Quantities) -> str:
    """Return a fault of the data in a sentence or two."""
    words = EFFECTS[fault.name].words
    values = ", ".join(_quantity(quantities, name, *value) for name, value in fault.parameters.items())
    what = f"{words.what[0].upper()}{words.what[1:]}"
    return quantities.worded(f"{what}: {values}. Seen in this: {fault.evidence}. Repair: {fault.repaired}.")


def _quantity(quantities: Quantities, name: str, value: float, unit: str, low: float, high: float) -> str:
    told, *ends = (number(quantities.value(one, unit), ".4g") for one in (value, low, high))
    noun = quantities.mass_noun if name == "mass" else name.replace("_", " ")
    return f"{noun} {told} {quantities.unit(unit)}".rstrip() + f" ({' to '.join(ends)})"


def _gained(gain: Gain) -> str:
    return (
        f"On data that the fit never saw the error falls from {100 * gain.nrmse_before:.2f} to "
        f"{100 * gain.nrmse_after:.2f} % of the friction's spread, by {gain.reduction_percent:.1f} % "
        f"({gain.low_percent:.1f} to {gain.high_percent:.1f})."
    )


def sentences(result: Diagnosis, quantities: Quantities) -> list[str]:
    """Return the whole diagnosis in sentences, in the units of `quantities`."""
    lines = []
    error, floor = 100 * result.nrmse_holdout, 100 * result.noise_floor
    if result.verdict == UNDECIDABLE:
        lines.append("These recordings cannot answer.")
    elif result.verdict == NOTHING_FOUND:
        limits = sorted(result.detection_limit_N.items(), key=lambda item: item[1])
        lines.append(
            f"Nothing found: the base model leaves {error:.2f} % of the friction's spread, and what does not repeat is "
            f"{floor:.2f} %. {len(limits)} causes were tried."
        )
        if limits:
            shown = "; ".join(f"{name} {quantities.text(value, FORCE, '.2g')}" for name, value in limits)
            lines.append(f"Changes larger than this (rms) would have been named: {shown}.")
    elif result.verdict == UNEXPLAINED:
        lines.append(
            f"Something is there that no name holds for: the base model leaves {error:.2f} % of the friction's spread, "
            f"and what does not repeat is {floor:.2f} %."
        )
    lines += [f"Data: {fault.name}: {fault_sentence(fault, quantities)}" for fault in result.faults]
    lines += [f"{i}. {found.name}: {sentence(found, quantities)}" for i, found in enumerate(result.effects, 1)]
    if result.total_gain is not None:
        lines.append(f"All effects together: {_gained(result.total_gain)}")
    if result.effects or result.faults:
        lines.append(f"Left above the noise floor: {result.unexplained_percent:.1f} % of the held-out error.")
    if result.traces:
        shown = "; ".join(f"{trace.name} {trace.share_percent:.2g} %" for trace in result.traces)
        lines.append(f"Traces, too small for a finding (share of the error power): {shown}.")
    lines += [f"{EFFECTS[n].words.what} may be the cause: record {c} to know" for n, c in result.needs_channel]
    lines += [f"To find it: {text}." for text in on_unexplained(result)]
    lines += [f"Note: {text}." for text in (*result.excitation.warnings, *result.excitation.notes)]
    return [quantities.worded(line) for line in lines]
