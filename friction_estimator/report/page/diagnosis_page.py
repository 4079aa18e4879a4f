"""The page of `diagnose`: what the simulation gets wrong, told cause by cause."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.text import LONGEST_NAME, number, shown
from friction_estimator.diagnosis.held_out import Gain
from friction_estimator.diagnosis.result import EFFECTS_FOUND, NOTHING_FOUND, UNDECIDABLE, UNEXPLAINED, Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.report.diagnosis_figures import REMAINDER
from friction_estimator.report.page.content import (
    CAUTION,
    GOOD,
    NEUTRAL,
    STOP,
    Advice,
    Bar,
    Card,
    Chart,
    Light,
    Page,
    Section,
)
from friction_estimator.report.page.write import is_interactive

MUCH_LEFT = 50.0
"""Percent of the held-out error above the noise floor that is left, above which the model is not yet explained."""


def diagnosis_page(
    result: Diagnosis,
    bags: Sequence[str],
    q: Quantities,
    files: Mapping[str, Path],
    judged: Sequence[str],
    details: Sequence[Section],
) -> Page:
    """Return the page.

    Parameters
    ----------
    files : effect id, or "remainder" -> its figure. judged : how the extended model is judged, in words and commands.
    details : sections on the run.
    """
    spread = float(np.std(result.record.friction_N[result.record.used])) or 1.0
    cards = [_effect_card(result, found, spread, q, files) for found in result.effects]
    cards += [_fault_card(fault, q, files) for fault in result.faults]
    sections = []
    if cards:
        sections.append(Section("What was found", _told(result, spread, q), cards=cards))
    if is_interactive() and len(result.effects) != 1:
        title = "All effects together" if result.effects else "The model and what it leaves"
        sections.append(Section(title, charts=[_whole(result, q)]))
    if result.remainder is not None:
        left = Card(
            "Something that no name holds for",
            REMAINDER,
            STOP,
            [f"{result.remainder.words[0].upper()}{q.worded(result.remainder.words[1:])}."],
            files=[(files[REMAINDER], "What is left, against what it depends on.")] if REMAINDER in files else [],
        )
        sections.append(Section("What is left", cards=[left]))
    if judged:
        sections.append(_extended(judged))
    if result.verdict != UNDECIDABLE:  # where it is, nothing was looked for
        sections.append(_not_found(result, q))
    sections += [_shown(result, q), *details]
    return Page(
        title="Diagnosis",
        lead="What the model of this friction gets wrong, and why, over "
        + ", ".join(shown(bag, LONGEST_NAME) for bag in bags),
        verdict=_verdict(result, spread, q),
        light=_light(result),
        advice=_advice(result, q),
        facts=_facts(result, spread, q),
        sections=sections,
    )


def _all(result: Diagnosis) -> list[Found | Fault]:
    return [*result.effects, *result.faults]


def plain(name: str) -> str:
    """Return the name of a cause as a heading has it."""
    return name.replace("_", " ").capitalize()


def _verdict(result: Diagnosis, spread: float, q: Quantities) -> str:
    before, floor = (q.text(share * spread, FORCE, ".2g") for share in (result.nrmse_holdout, result.noise_floor))
    names = [plain(found.name).lower() for found in _all(result)]
    if result.verdict == UNDECIDABLE:
        return "These recordings cannot answer; what they lack stands below."
    if result.verdict == NOTHING_FOUND:
        return (
            f"Nothing found: the model errs by ±{before} rms on samples that it never saw, the noise alone is ±{floor}."
        )
    if result.verdict == UNEXPLAINED:
        return (
            f"Something is there that no name holds for: the model errs by ±{before} rms on samples that it never "
            f"saw, and the noise alone is ±{floor}."
        )
    text = f"{_count(len(names))}: {', '.join(names)}."
    if result.total_gain is not None:
        after = q.text(result.total_gain.nrmse_after * spread, FORCE, ".2g")
        text += f" With {'it' if len(result.effects) == 1 else 'them'} in the model its error on samples that it never "
        text += f"saw falls from ±{before} to ±{after} rms; the noise alone is ±{floor}."
    return text


def _count(number: int) -> str:
    words = ("No cause", "One cause", "Two causes", "Three causes", "Four causes", "Five causes")
    return f"{words[number] if number < len(words) else f'{number} causes'} found"


def _light(result: Diagnosis) -> Light:
    if result.verdict == UNDECIDABLE:
        return Light(STOP, "The recordings show too little to tell causes apart.", "Undecidable")
    if result.verdict == NOTHING_FOUND:
        return Light(GOOD, "Nothing above the limits below is missing from the model.", "Nothing found")
    if result.verdict == UNEXPLAINED:
        return Light(
            STOP, "The error is above the noise, and none of the causes that are known explains it.", "Unexplained"
        )
    if result.unexplained_percent > MUCH_LEFT:
        reason = (
            f"Named causes explain a part; {result.unexplained_percent:.0f} % of the error is still above the noise."
        )
        return Light(CAUTION, reason, "Found in part")
    if any(found.rivals for found in result.effects):
        return Light(CAUTION, "A cause is there, but these data cannot tell it from another one.", "Found, not unique")
    return Light(NEUTRAL, f"What is left above the noise is {result.unexplained_percent:.0f} % of the error.", "Found")


def _advice(result: Diagnosis, q: Quantities) -> list[Advice]:
    out = [Advice(f"Next experiment, for {found.experiment}.") for found in result.effects if found.experiment]
    out += [
        Advice(f"Record {channel}: {EFFECTS[name].words.what} may be the cause, and only that tells.")
        for name, channel in result.needs_channel
    ]
    if result.verdict != EFFECTS_FOUND:
        out += [Advice(f"{text[0].upper()}{text[1:]}.") for text in result.excitation.warnings]
    return [Advice(q.worded(one.text)) for one in out]


def _facts(result: Diagnosis, spread: float, q: Quantities) -> list[tuple[str, str, str]]:
    # Nothing was held out of data that cannot answer.
    judged = "error of the fit" if result.verdict == UNDECIDABLE else "error, unseen samples"
    out = [(judged, q.text(result.nrmse_holdout * spread, FORCE, ".3g"), _share(result.nrmse_holdout))]
    if result.total_gain is not None:
        after = result.total_gain.nrmse_after
        out.append(("with what was found", q.text(after * spread, FORCE, ".3g"), _share(after)))
    out.append(("noise floor", q.text(result.noise_floor * spread, FORCE, ".3g"), _share(result.noise_floor)))
    if result.effects or result.faults:
        out.append(("left above the floor", f"{result.unexplained_percent:.1f} %", "of the error on unseen samples"))
    found = result.excitation
    out.append(("reversals", str(found.reversals), f"{found.cycles} cycles"))
    return out


def _share(nrmse: float) -> str:
    return f"{100 * nrmse:.2f} % of the spread"


def _told(result: Diagnosis, spread: float, q: Quantities) -> list[str]:
    if result.total_gain is None or len(result.effects) < 2:
        return []
    return [f"All effects together: {_gained(result.total_gain, spread, q)}"]


def _gained(gain: Gain, spread: float, q: Quantities) -> str:
    before, after = (q.text(share * spread, FORCE, ".3g") for share in (gain.nrmse_before, gain.nrmse_after))
    return (
        f"On samples that the fit never saw the error falls from {before} to {after} rms, by "
        f"{gain.reduction_percent:.1f} % ({gain.low_percent:.1f} to {gain.high_percent:.1f} with 95 % confidence)."
    )


def _effect_card(result: Diagnosis, found: Found, spread: float, q: Quantities, files: Mapping[str, Path]) -> Card:
    words = EFFECTS[found.name].words
    values = [_value(q, name, e.value, e.unit, e.low, e.high) for name, e in found.parameters.items()]
    gain = None
    if found.gain is not None:
        one = found.gain
        gain = Bar(one.reduction_percent, one.low_percent, one.high_percent, _gained(one, spread, q))
    facts = []
    if words.where != found.evidence:
        facts.append(("Where such a thing shows", q.worded(f"{words.where[0].upper()}{words.where[1:]}.")))
    if found.gain is None:
        facts.append(
            ("No gain", "The base model's own memory had taken it up: it is there, but predicts nothing better.")
        )
    if found.p_value is not None:
        facts.append(("By chance", f"A test that looks at all causes at once gives p = {found.p_value:.2g}."))
    if found.rivals:
        rivals = ", ".join(plain(name).lower() for name in found.rivals)
        facts.append(("Cannot be told from", f"{rivals}: with these data both fit."))
    if found.experiment:
        facts.append(("Next experiment", q.worded(f"{found.experiment}.")))
    figure = (
        [(files[found.name], f"{plain(found.name)}: what is left before and after.")] if found.name in files else []
    )
    charts = _charts(result, found, q)
    # A delay is seen at a single reversal, which is a figure of its own.
    still = figure if not charts or EFFECTS[found.name].delays else []
    return Card(
        plain(found.name),
        found.name,
        CAUTION if found.rivals else NEUTRAL,
        [q.worded(f"{words.what[0].upper()}{words.what[1:]}."), q.worded(f"Seen in this: {found.evidence}.")],
        values,
        gain,
        facts,
        charts,
        still,
    )


def _charts(result: Diagnosis, found: Found, q: Quantities) -> list[Chart]:
    if not is_interactive():
        return []
    from friction_estimator.report.page import diagnosis_charts as charts  # noqa: PLC0415

    before, after = result.models[found.term], result.models[found.term + 1]
    words = ("before", f"with {plain(found.name).lower()}")
    out = [] if EFFECTS[found.name].delays else [charts.revealing(result, found, q)]
    return [*out, charts.over_time(result, before, after, words, q)]


def _whole(result: Diagnosis, q: Quantities) -> Chart:
    from friction_estimator.report.page import diagnosis_charts as charts  # noqa: PLC0415

    if not result.effects:
        return charts.model_over_time(result, q)
    return charts.over_time(result, result.models[0], result.models[-1], ("before", "with all of them"), q)


def _value(q: Quantities, name: str, value: float, unit: str, low: float, high: float) -> tuple[str, str, str]:
    told, least, most = (number(q.value(one, unit), ".4g") for one in (value, low, high))
    noun = q.mass_noun if name == "mass" else name.replace("_", " ")
    return noun, f"{told} {q.unit(unit)}".rstrip(), f"{least} to {most} with 95 % confidence"


def _fault_card(fault: Fault, q: Quantities, files: Mapping[str, Path]) -> Card:
    words = EFFECTS[fault.name].words
    figure = [(files[fault.name], f"{plain(fault.name)} in the data.")] if fault.name in files else []
    return Card(
        plain(fault.name),
        fault.name,
        CAUTION,
        [q.worded(f"{words.what[0].upper()}{words.what[1:]}."), q.worded(f"Seen in this: {fault.evidence}.")],
        [_value(q, name, *quantity) for name, quantity in fault.parameters.items()],
        None,
        [("A fault of the data", f"Repaired: {fault.repaired}.")],
        (),
        figure,
    )


def _extended(judged: Sequence[str]) -> Section:
    text, *commands = judged
    return Section(
        "What to do with extended.yaml",
        [
            "It holds the model with what was found, learned from these recordings. It is a parameter file: replay, "
            "simulate, diagnose and the live node take it with --config (the node with --params-file).",
            text,
        ],
        commands=commands,
    )


def _not_found(result: Diagnosis, q: Quantities) -> Section:
    """Return what was looked for and not found, with the limits that are known."""
    named = {one.name for one in _all(result)}
    traces = {trace.name: trace.share_percent for trace in result.traces}
    channels = dict(result.needs_channel)
    rows: list[Sequence[object]] = [("cause", "what it would be", "outcome")]
    limits = result.detection_limit_N
    for name in sorted(EFFECTS, key=lambda one: (one not in traces, limits.get(one, np.inf), one)):
        if name in named:
            continue
        outcome = "not found"
        if name in limits:
            outcome = f"not found; a change above {q.text(limits[name], FORCE, '.2g')} rms would have been named"
        if name in traces:
            outcome = f"a trace: {traces[name]:.2g} % of the error power, too small for a finding"
        if name in channels:
            outcome = f"open: record {channels[name]} to know"
        rows.append((plain(name), q.worded(EFFECTS[name].words.what), outcome))
    text = [] if limits else ["Limits are computed where nothing was found at all."]
    return Section("What was looked for and not found", text, rows, folded=True)


def _shown(result: Diagnosis, q: Quantities) -> Section:
    """Return what the recordings can show."""
    found = result.excitation
    rows: list[Sequence[object]] = [
        ("", ""),
        ("velocities", q.range_text(found.velocity_range, VELOCITY)),
        ("reversals", str(found.reversals)),
        ("cycles", str(found.cycles)),
        ("channels", ", ".join(found.channels)),
    ]
    notes = [q.worded(f"{text[0].upper()}{text[1:]}.") for text in (*found.warnings, *found.notes)]
    return Section("What the recordings can show", notes, rows)
