"""What was learned of the load, for the console and for the page."""

from collections.abc import Sequence

from friction_estimator.cli import common
from friction_estimator.core.fit.load_report import LearnedLoad
from friction_estimator.core.quantities import Quantities
from friction_estimator.report.page.content import Section

HEAD = ("term", "value", "95 % interval", "told from friction and other loads")


def tell(output: common.Outlet, loads: Sequence[LearnedLoad], quantities: Quantities, width: int = 12) -> None:
    """Say what each term is, and what is not told apart."""
    for load in loads:
        output.say(f"{'load':<{width}}{load.term} = {load.text(quantities)}")


def section(loads: Sequence[LearnedLoad], quantities: Quantities) -> list[Section]:
    """Return the section of the page; none where no load was learned."""
    if not loads:
        return []
    rows: list[tuple[object, ...]] = [HEAD]
    for load in loads:
        rows.append((load.term, *load.told(quantities), "yes" if load.separated else f"no: {load.reason}"))
    text = (
        "What the measured effort holds beside friction, learned beside it. The friction curve is without it; measured "
        "and predicted effort hold it. A value that is separated can be given in load.terms: it is then taken off."
    )
    return [Section("Load", [text], rows)]
