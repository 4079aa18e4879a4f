"""One self-contained page: figures are embedded, nothing is loaded from elsewhere."""

import base64
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from friction_estimator.core.text import LONGEST_PARAGRAPH, shown

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1d232a; background: #fff; margin: 0 auto; max-width: 62rem;
  padding: 2rem 1.2rem; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p, figcaption { max-width: 46rem; }
.lead, figcaption { color: #4a5560; }
table { border-collapse: collapse; margin: .6rem 0; display: block; overflow-x: auto; }
td, th { text-align: left; padding: .28rem 1.1rem .28rem 0; border-bottom: 1px solid #e3e6ea; vertical-align: top; }
td.number { font-variant-numeric: tabular-nums; }
figure { margin: 1.2rem 0; }
img { max-width: 100%; height: auto; }
"""


@dataclass
class Section:
    """A heading with paragraphs, a table and figures; every part may be empty.

    Attributes
    ----------
    table : rows of cells; the first row is the head.
    figures : (PNG file, caption).
    """

    title: str
    paragraphs: Sequence[str] = ()
    table: Sequence[Sequence[object]] = ()
    figures: Sequence[tuple[Path, str]] = field(default_factory=list)


def write_page(path: str | os.PathLike[str], title: str, lead: str, sections: Iterable[Section]) -> None:
    """Write the page."""
    body = "".join(_section(section) for section in sections)
    Path(path).write_text(
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{_text(title)}</h1>\n<p class="lead">{_text(lead)}</p>\n{body}</body>\n</html>\n',
        encoding="utf-8",
    )


def _text(value: object) -> str:
    """Return text for the page: what is no printable character is an escape, there as on a terminal."""
    return escape(shown(value, LONGEST_PARAGRAPH))


def _section(section: Section) -> str:
    parts = [f"<h2>{_text(section.title)}</h2>\n"]
    parts += [f"<p>{_text(text)}</p>\n" for text in section.paragraphs]
    if section.table:
        head, *rows = section.table
        parts.append("<table>\n<tr>" + "".join(f"<th>{_text(cell)}</th>" for cell in head) + "</tr>\n")
        parts += ["<tr>" + "".join(_cell(cell) for cell in row) + "</tr>\n" for row in rows]
        parts.append("</table>\n")
    for file, caption in section.figures:
        data = base64.b64encode(file.read_bytes()).decode("ascii")
        parts.append(
            f'<figure><img alt="{_text(caption)}" src="data:image/png;base64,{data}">'
            f"<figcaption>{_text(caption)}</figcaption></figure>\n"
        )
    return "".join(parts)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f'<td class="number">{value:.4g}</td>'
    return f"<td>{_text(value)}</td>"
