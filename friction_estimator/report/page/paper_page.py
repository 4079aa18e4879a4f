"""The page of `reproduce`: the paper's figures, and its claims judged by numbers."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from friction_estimator.core.quantities import Quantities
from friction_estimator.paper.claims import MODES, Claim
from friction_estimator.paper.study import MODELS, Study
from friction_estimator.report.page.content import (
    CAUTION,
    GOOD,
    LEVELS,
    NEUTRAL,
    STOP,
    Card,
    Chart,
    Light,
    Page,
    Section,
)
from friction_estimator.report.page.write import is_interactive
from friction_estimator.report.reproduce_figures import PARTS

VERDICTS = {"confirmed": GOOD, "depends": CAUTION, "refuted": STOP}
"""Verdict of a claim -> level of its card."""

Table = Callable[[Claim], Sequence[Sequence[object]]]


def paper_page(
    study: Study,
    claims: Sequence[Claim],
    table: Table,
    files: Mapping[str, tuple[Path, str]],
    details: Sequence[Section],
) -> Page:
    """Return the page.

    Parameters
    ----------
    table : of a claim's numbers, with a head. files : what `write_figures` returns. details : sections on the run.
    """
    charts: Mapping[str, Sequence[Chart]] = {}
    if is_interactive():
        from friction_estimator.report.page.paper_charts import paper_charts  # noqa: PLC0415

        charts = paper_charts(study, Quantities())
    counts = Counter(claim.verdict for claim in claims)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    sections = [
        Section(
            "Verdicts",
            [
                "Adapted: while learning. Frozen: learned on the first half, judged on the second without learning. "
                "Elsewhere: learned on one drive, judged without learning on drives that differ in kind. Each is "
                "computed from the numbers below, with how many of its cases hold; intervals are 95 %."
            ],
            _verdicts(claims),
            files=[files["judged"]],
        ),
        Section("The claims", cards=[_card(c) for c in claims]),
        Section("Fig. 3: the theoretical curve", PARTS["3"], files=[_bare(files["3"], "Fig. 3")]),
        Section("Fig. 4: the conditions", PARTS["4"], files=[_bare(files["4"], "Fig. 4")]),
    ]
    for number, model in zip(("5", "6"), MODELS, strict=True):
        shown = charts.get(model, ())
        picture = [] if shown else [_bare(files[number], f"Fig. {number}")]
        sections.append(
            Section(f"Fig. {number}: {model.capitalize()} model", PARTS[number], charts=shown, files=picture)
        )
    sections += [
        Section(f"Numbers: {claim.id.replace('_', ' ')}", [claim.experiment], table(claim), folded=True)
        for claim in claims
    ]
    return Page(
        title="The paper, reproduced and put to the test",
        lead=f"Kwak, Yagle and Levitt (1998), over {study.plan}; velocity companded before the basis",
        verdict=f"Of {len(claims)} claims: {told}.",
        light=Light(
            NEUTRAL, "Simulated rigs, the same seeds give the same numbers; the force scale is not the paper's."
        ),
        facts=[
            (f"{LEVELS[level][0]} {verdict}", str(counts[verdict]), "claims") for verdict, level in VERDICTS.items()
        ],
        sections=[*sections, *details],
    )


def _bare(file: tuple[Path, str], name: str) -> tuple[Path, str]:
    """Return a figure whose caption stands in the section already."""
    return file[0], f"Counterpart of the paper's {name}."


def _verdicts(claims: Sequence[Claim]) -> list[tuple[object, ...]]:
    """Return a row a claim: its verdicts by mode, and over all modes in the paper's own basis."""
    rows: list[tuple[object, ...]] = [("claim", "verdict", *MODES, "without companding")]
    for claim in claims:
        by_mode = [_word(claim, mode) for mode in MODES]
        plain = ", ".join(f"{mode} {word}" for mode, word in claim.verdicts_without_companding.items())
        rows.append((claim.id.replace("_", " "), claim.verdict, *by_mode, plain))
    return rows


def _word(claim: Claim, mode: str) -> str:
    """Return the verdict in a mode, with the share of its cases that hold."""
    if mode not in claim.verdicts:
        return "by proof" if claim.theorems and not claim.verdicts else ""
    counts = claim.cases[mode]
    return f"{claim.verdicts[mode]}, {counts['hold']} of {sum(counts.values())}"


def _paragraphs(why: str) -> list[str]:
    """Return the reasons with a paragraph for each mode, and for what is said of all of them."""
    heads = "|".join(("Frozen:", "Elsewhere:", "Of lms", "The head start", r"sign\(v\) alone", "Without companding"))
    return re.split(rf" (?=(?:{heads}))", why)


def _card(claim: Claim) -> Card:
    level = VERDICTS.get(claim.verdict, NEUTRAL)
    theorems = [("Theorem", f"{one.statement} {one.proof} {one.checked}") for one in claim.theorems]
    return Card(
        f"{LEVELS[level][0]} {claim.verdict.capitalize()}: {claim.id.replace('_', ' ')}",
        claim.id,
        level,
        [f"The paper says: {claim.statement}", *_paragraphs(claim.why)],
        facts=[*theorems, ("Experiment", claim.experiment)],
    )
