"""The list of the decisions.

They stand in no table of contents: the theme would repeat all of them beside every page, a third of the time that the
site takes to build.
"""

from pathlib import Path
from typing import Any

FOLDER = "docs/decisions/"
INDEX = f"{FOLDER}README"


def markdown(pictures: Path, _address: str) -> str:
    """Return a list of the pages of the decisions, oldest first."""
    pages = sorted((pictures.parents[1] / FOLDER).glob("[0-9]*.md"))
    titles = (page.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ") for page in pages)
    return "\n".join(f"- [{title}]({page.name})" for title, page in zip(titles, pages, strict=True))


def stands_alone(app: Any, _doctree: Any) -> None:
    """Tell Sphinx that a decision is in no table of contents."""
    page = app.env.docname
    if page.startswith(FOLDER) and page != INDEX:
        app.env.metadata[page]["orphan"] = True


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("doctree-read", stands_alone)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
