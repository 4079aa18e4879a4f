"""What the site makes of the code while it is built: a mark in a page is replaced by generated text.

A mark is an HTML comment alone on its line, so that a git host shows nothing in its place::

    <!-- site: effects -->
    <!-- site: figure friction_map -->

The first word chooses a function of `MAKERS`, the others are its arguments.
"""

import re
from collections.abc import Callable
from pathlib import Path

import decision_list
import effect_catalogue
import example_figures
import parameter_reference
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

PICTURES = Path("docs/generated")
"""Where pictures are made, from the project's folder."""

MARK = re.compile(r"^<!-- site: (?P<words>[^>]+?) -->$", re.MULTILINE)

MAKERS: dict[str, Callable[..., str]] = {
    "decisions": decision_list.markdown,
    "diagnosis": example_figures.diagnosis,
    "effects": effect_catalogue.markdown,
    "figure": example_figures.markdown,
    "parameters": parameter_reference.markdown,
}
"""First word of a mark -> what makes Markdown of it: (folder for pictures, address of that folder, words...)."""


def fill(app: Sphinx, docname: str, content: list[str]) -> None:
    """Replace the marks of a page."""
    depth = docname.count("/")
    address = "../" * depth + PICTURES.as_posix()

    def made(mark: re.Match[str]) -> str:
        maker, *words = mark["words"].split()
        if maker not in MAKERS:
            raise ExtensionError(f"{docname}: {mark[0]} is no mark: it begins with one of {', '.join(MAKERS)}")
        folder = Path(app.srcdir) / PICTURES
        folder.mkdir(exist_ok=True)
        return MAKERS[maker](folder, address, *words)

    content[0] = MARK.sub(made, content[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Let Sphinx call `fill` for each page that it reads."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
