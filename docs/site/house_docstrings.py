"""The project's docstrings as napoleon reads them: `name : meaning` is no type, and formulas are no markup."""

import re
from collections.abc import Iterator

from sphinx.application import Sphinx

SECTIONS = ("Parameters", "Attributes", "Raises")

NAMES = re.compile(r"(?:^|(?<=[.;] ))(\w+(?:, \w+)*) : ")
"""The name or names that an entry begins with: at the start of its line, or after the sentence of the one before."""

CODE = re.compile(r"(``.+?``|`[^`]+`)")
MARKUP = re.compile(r"([|*]|_\b(?!\w))")


def tidy(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Rewrite a docstring in place, before napoleon does."""
    lines[:] = list(_plain(_entries(lines)))


def setup(app: Sphinx) -> dict[str, bool]:
    """Let autodoc call `tidy` before napoleon, which comes at the usual priority of 500."""
    app.connect("autodoc-process-docstring", tidy, priority=400)
    return {"parallel_read_safe": True}


def _entries(lines: list[str]) -> Iterator[str]:
    """Put names and meanings of the sections on lines of their own."""
    section, entry = "", ""
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        head = bool(line) and set(following.strip()) == {"-"}
        if section and (head or not line):
            yield from _entry(entry)
            entry = ""
        if head:
            section = line if line in SECTIONS else ""
        if not section or head or not line or set(line) == {"-"}:
            yield line
        elif line.startswith(" "):
            entry += f" {line.strip()}"
        else:
            yield from _entry(entry)
            entry = line
    yield from _entry(entry)


def _entry(text: str) -> Iterator[str]:
    begin, *rest = NAMES.split(text)
    if begin:
        yield begin
    for names, meaning in zip(rest[::2], rest[1::2], strict=True):
        yield names
        yield f"    {meaning.strip()}"


def _plain(lines: Iterator[str]) -> Iterator[str]:
    """Escape what looks like markup outside code, literal blocks and examples."""
    literal = ""
    for line in lines:
        indent = line[: len(line) - len(line.lstrip())]
        if line and literal and len(indent) < len(literal):
            literal = ""
        if literal or line.lstrip().startswith(">>>"):
            yield line
        else:
            yield "".join(part if k % 2 else MARKUP.sub(r"\\\1", part) for k, part in enumerate(CODE.split(line)))
        if line.endswith("::"):
            literal = indent + "    "
