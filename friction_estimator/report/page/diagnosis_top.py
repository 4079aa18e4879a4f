"""The top of a diagnosis page: the verdict in a sentence, the light, what to do, the figures that stand out."""

from friction_estimator.core import metrics
from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.diagnosis.advice import on_unexplained
from friction_estimator.diagnosis.result import EFFECTS_FOUND, NOTHING_FOUND, UNDECIDABLE, UNEXPLAINED, Diagnosis, Found
from friction_estimator.effects.base import EFFECTS
from friction_estimator.effects.detection import Fault
from friction_estimator.report.page.content import CAUTION, GOOD, NEUTRAL, STOP, Advice, Light

MUCH_LEFT = 50.0
"""Percent of the held-out error above the noise floor that is left, above which the model is not yet explained."""

SMOOTH = 0.5
"""White share of what does not repeat (as rms) below which the rest is told: it is smooth from sample to sample, so
that a filter in the sensor made it, or something moved."""


def plain(name: str) -> str:
    """Return the name of a cause as a heading has it."""
    return name.replace("_", " ").capitalize()


def sentence(text: str) -> str:
    """Return a text as a sentence."""
    return f"{text[0].upper()}{text[1:]}."


def named(result: Diagnosis) -> list[Found | Fault]:
    """Return all that was found."""
    return [*result.effects, *result.faults]


def verdict(result: Diagnosis, spread: float, q: Quantities) -> str:
    """Return the result in a sentence or two; `spread` is the standard deviation of the measured force, N."""
    before, floor = (q.text(share * spread, FORCE, ".2g") for share in (result.nrmse_holdout, result.noise_floor))
    names = [plain(found.name).lower() for found in named(result)]
    if result.verdict == UNDECIDABLE:
        return "These recordings cannot answer; what they lack stands below."
    if result.verdict == NOTHING_FOUND:
        return (
            f"Nothing found: the model errs by ±{before} rms on samples that it never saw, and what does not repeat is "
            f"±{floor}."
        )
    if result.verdict == UNEXPLAINED:
        return (
            f"Something is there that no name holds for: the model errs by ±{before} rms on samples that it never "
            f"saw, and what does not repeat is ±{floor}."
        )
    text = f"{_count(len(names))}: {', '.join(names)}."
    if result.total_gain is not None:
        after = q.text(result.total_gain.nrmse_after * spread, FORCE, ".2g")
        text += f" With {'it' if len(result.effects) == 1 else 'them'} in the model its error on samples that it never "
        text += f"saw falls from ±{before} to ±{after} rms; what does not repeat is ±{floor}."
    return text


def _count(number: int) -> str:
    words = ("No cause", "One cause", "Two causes", "Three causes", "Four causes", "Five causes")
    return f"{words[number] if number < len(words) else f'{number} causes'} found"


def light(result: Diagnosis) -> Light:
    """Return how far the result can be relied on."""
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
    if not all(found.sized for found in result.effects):
        return Light(CAUTION, "A cause is there, but these data do not tell how large it is.", "Found, size open")
    return Light(NEUTRAL, f"What is left above the noise is {result.unexplained_percent:.0f} % of the error.", "Found")


def advice(result: Diagnosis, spread: float, q: Quantities) -> list[Advice]:
    """Return what to do next."""
    out = [f"next experiment, for {found.experiment}" for found in result.effects if found.experiment]
    left = on_unexplained(result)
    out += left if result.verdict == UNEXPLAINED else [f"what no name holds for: {text}" for text in left]
    out += [
        f"record {channel}: {EFFECTS[name].words.what} may be the cause, and only that tells"
        for name, channel in result.needs_channel
    ]
    if result.verdict != EFFECTS_FOUND:
        said = result.remainder.words if result.remainder is not None else ""
        out += [text for text in result.excitation.warnings if text != said]
    white = _white_of_smooth(result, spread)
    if white is not None and result.verdict in (NOTHING_FOUND, UNEXPLAINED):
        floor = q.text(result.noise_floor * spread, FORCE, ".2g")
        out.append(
            f"of the ±{floor} that do not repeat only ±{q.text(white, FORCE, '.2g')} are white; the rest is smooth "
            "from sample to sample: a filter in the sensor, or something that moves by itself and follows nothing that "
            "was recorded. Record once with the drive at rest to see which"
        )
    return [Advice(q.worded(sentence(text))) for text in out]


def _white_of_smooth(result: Diagnosis, spread: float) -> float | None:
    """Return the rms of what is white in the measured force, N, where it is little of what does not repeat."""
    white = metrics.white_noise(result.record.friction_N, result.record.restart)
    return white if 0.0 < white < SMOOTH * result.noise_floor * spread else None


def facts(result: Diagnosis, spread: float, q: Quantities) -> list[tuple[str, str, str]]:
    """Return the figures that stand out: (name, value, meaning)."""
    # Nothing was held out of data that cannot answer.
    judged = "error of the fit" if result.verdict == UNDECIDABLE else "error, unseen samples"
    out = [(judged, q.text(result.nrmse_holdout * spread, FORCE, ".3g"), _share(result.nrmse_holdout))]
    if result.total_gain is not None:
        after = result.total_gain.nrmse_after
        out.append(("with what was found", q.text(after * spread, FORCE, ".3g"), _share(after)))
    meaning = f"{_share(result.noise_floor)}: what does not repeat"
    out.append(("noise floor", q.text(result.noise_floor * spread, FORCE, ".3g"), meaning))
    white = _white_of_smooth(result, spread)
    if white is not None:
        out.append(("white noise", q.text(white, FORCE, ".3g"), "of the floor; the rest is smooth"))
    if result.effects or result.faults:
        out.append(("left above the floor", f"{result.unexplained_percent:.1f} %", "of the error on unseen samples"))
    found = result.excitation
    out.append(("reversals", str(found.reversals), f"{found.cycles} cycles"))
    return out


def _share(nrmse: float) -> str:
    return f"{100 * nrmse:.2f} % of the spread"
