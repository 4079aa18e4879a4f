"""The list of the decisions.

They stand in no table of contents: the theme would repeat all of them beside every page, a third of the time that the
site takes to build.
"""

from pathlib import Path
from typing import Any

DECISIONS = Path(__file__).parents[1] / "decisions"

NAMED = "docs/decisions/"
"""How the names of their pages begin for Sphinx."""

INDEX = f"{NAMED}README"


def markdown(_pictures: Path, _address: str) -> str:
    """Return a list of the pages of the decisions, oldest first."""
    return "\n".join(f"- [{_title(page)}]({page.name})" for page in sorted(DECISIONS.glob("[0-9]*.md")))


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")


def stands_alone(app: Any, _doctree: Any) -> None:
    """Tell Sphinx that a decision is in no table of contents."""
    page = app.env.docname
    if page.startswith(NAMED) and page != INDEX:
        app.env.metadata[page]["orphan"] = True


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", stands_alone)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
