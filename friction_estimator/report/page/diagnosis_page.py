"""The page of `diagnose`: what the simulation gets wrong, told cause by cause."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.text import LONGEST_NAME, number, shown
from friction_estimator.diagnosis.advice import on_remainder
from friction_estimator.diagnosis.held_out import Gain
from friction_estimator.diagnosis.result import UNDECIDABLE, Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.report.diagnosis_figures import REMAINDER
from friction_estimator.report.page import diagnosis_top as top
from friction_estimator.report.page.content import CAUTION, NEUTRAL, STOP, Bar, Card, Chart, Page, Section
from friction_estimator.report.page.diagnosis_top import plain, sentence
from friction_estimator.report.page.write import is_interactive


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
            [q.worded(sentence(result.remainder.words))],
            facts=[("Where to look", q.worded(sentence(on_remainder(result.remainder))))],
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
        verdict=top.verdict(result, spread, q),
        light=top.light(result),
        advice=top.advice(result, spread, q),
        facts=top.facts(result, spread, q),
        sections=sections,
    )


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
        facts.append(("Where such a thing shows", q.worded(sentence(words.where))))
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
        [q.worded(sentence(words.what)), q.worded(f"Seen in this: {found.evidence}.")],
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
        [q.worded(sentence(words.what)), q.worded(f"Seen in this: {fault.evidence}.")],
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
    named = {one.name for one in top.named(result)}
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
    notes = [q.worded(sentence(text)) for text in (*found.warnings, *found.notes)]
    return Section("What the recordings can show", notes, rows)
