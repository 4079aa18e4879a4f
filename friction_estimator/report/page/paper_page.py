"""The page of `reproduce`: the paper's figures, and its claims judged by numbers."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from friction_estimator.core.quantities import Quantities
from friction_estimator.paper.claims import Claim
from friction_estimator.paper.study import Study
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

VERDICTS = {"confirmed": GOOD, "depends": CAUTION, "refuted": STOP}
"""Verdict of a claim -> level of its card."""

Table = Callable[[Claim], Sequence[Sequence[object]]]


def paper_page(
    study: Study, claims: Sequence[Claim], table: Table, files: Sequence[tuple[Path, str]], details: Sequence[Section]
) -> Page:
    """Return the page.

    Parameters
    ----------
    table : of a claim's numbers, with a head. files : the four figures in the paper's order, with captions.
    details : sections on the run.
    """
    charts: Mapping[str, Sequence[Chart]] = {}
    if is_interactive():
        from friction_estimator.report.page.paper_charts import paper_charts  # noqa: PLC0415

        charts = paper_charts(study, Quantities())
    counts = Counter(claim.verdict for claim in claims)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    theory, conditions = files[:2], files[2:]
    sections = [
        Section(
            "The claims",
            ["Each verdict is computed from the numbers below it; intervals are 95 %."],
            cards=[_card(c) for c in claims],
        ),
        Section("Figs. 3 and 4: the theoretical curve and the conditions", files=[*theory]),
    ]
    for number, (model, picture) in enumerate(zip(charts or ("hammerstein", "parallel"), conditions, strict=True)):
        shown = charts.get(model, ())
        sections.append(
            Section(f"Fig. {5 + number}: {model.capitalize()} model", charts=shown, files=[] if shown else [picture])
        )
    sections += [
        Section(f"Numbers: {claim.id.replace('_', ' ')}", [claim.experiment], table(claim), folded=True)
        for claim in claims
    ]
    return Page(
        title="The paper, reproduced and put to the test",
        lead=f"Kwak, Yagle and Levitt (1998), over {study.plan}",
        verdict=f"Of {len(claims)} claims: {told}.",
        light=Light(
            NEUTRAL, "Simulated rigs, the same seeds give the same numbers; the force scale is not the paper's."
        ),
        facts=[
            (f"{LEVELS[level][0]} {verdict}", str(counts[verdict]), "claims") for verdict, level in VERDICTS.items()
        ],
        sections=[*sections, *details],
    )


def _card(claim: Claim) -> Card:
    level = VERDICTS.get(claim.verdict, NEUTRAL)
    return Card(
        f"{LEVELS[level][0]} {claim.verdict.capitalize()}: {claim.id.replace('_', ' ')}",
        claim.id,
        level,
        [f"The paper says: {claim.statement}", claim.why],
        facts=[("Experiment", claim.experiment)],
    )
