"""The page without scripts: the same words and tables, and the figures as pictures."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from friction_estimator.core.text import LONGEST_PARAGRAPH, shown
from friction_estimator.report.page.content import Card, Page, Section, Whisker

KINDS = {".png": "image/png", ".svg": "image/svg+xml"}

_STYLE = Path(__file__).parent / "templates" / "page.css"


def text_of(page: Page, note: str) -> str:
    """Return the whole page; `note` says why it is a static one."""
    facts = "".join(f"<div><dt>{_text(a)}</dt><dd>{_text(b)}</dd><dd>{_text(c)}</dd></div>" for a, b, c in page.facts)
    advice = "".join(
        f"<li>{_text(one.text)}{f'<pre>{_text(one.command)}</pre>' if one.command else ''}</li>" for one in page.advice
    )
    body = "".join(_section(section) for section in page.sections)
    figures = _figures(page.files)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(page.title)}</title>\n<style>{_STYLE.read_text(encoding='utf-8')}</style>\n</head>\n<body>\n"
        f'<main>\n<h1>{_text(page.title)}</h1>\n<p class="lead">{_text(page.lead)}</p>\n'
        f'<p class="light {page.light.level}"><span aria-hidden="true">{page.light.sign}</span> '
        f"<strong>{_text(page.light.name)}.</strong> {_text(page.light.reason)}</p>\n"
        f'<p class="verdict">{_text(page.verdict)}</p>\n'
        + (f'<ul class="advice">{advice}</ul>\n' if advice else "")
        + (f'<dl class="facts">{facts}</dl>\n' if facts else "")
        + f'<p class="note">{_text(note)}</p>\n{body}'
        + (f"<section><h2>Figures</h2>\n{figures}</section>\n" if figures else "")
        + "</main>\n</body>\n</html>\n"
    )


def _text(value: object) -> str:
    """Return text for the page: what is no printable character is an escape, there as on a terminal."""
    return escape(shown(value, LONGEST_PARAGRAPH))


def _section(section: Section) -> str:
    inside = "".join(f"<p>{_text(text)}</p>\n" for text in section.paragraphs)
    inside += "".join(f"<pre>{_text(command)}</pre>\n" for command in section.commands)
    inside += "".join(_card(card) for card in section.cards) + _figures(section.files)
    if section.table:
        head, *rows = section.table
        inside += '<div class="wide"><table>\n'
        inside += "<tr>" + "".join(f"<th>{_text(one)}</th>" for one in head) + "</tr>\n" if any(head) else ""
        inside += "".join("<tr>" + "".join(f"<td>{cell(one)}</td>" for one in row) + "</tr>\n" for row in rows)
        inside += "</table></div>\n"
    if not inside:
        return ""  # it has charts only
    if section.folded:
        return f"<details><summary>{_text(section.title)}</summary>\n{inside}</details>\n"
    return f"<section><h2>{_text(section.title)}</h2>\n{inside}</section>\n"


def _card(card: Card) -> str:
    parts = [f"<h3>{_text(card.title)} <code>{_text(card.name)}</code></h3>"]
    parts += [f"<p>{_text(text)}</p>" for text in card.paragraphs]
    parts += [f"<p>{_text(a)}: <strong>{_text(b)}</strong> {_text(c)}</p>" for a, b, c in card.values]
    if card.gain is not None:
        parts.append(f"<p>{_text(card.gain.text)}</p>")
    parts += [f"<p><strong>{_text(a)}.</strong> {_text(b)}</p>" for a, b in card.facts]
    return f'<article class="card {card.level}">' + "\n".join(parts) + _figures(card.files) + "</article>\n"


def _figures(files: Sequence[tuple[Path, str]]) -> str:
    return "".join(
        f'<figure><img alt="{_text(caption)}" src="{embedded(file)}">'
        f"<figcaption>{_text(caption)}</figcaption></figure>\n"
        for file, caption in files
    )


def embedded(file: Path) -> str:
    """Return a picture as an address that holds it."""
    return f"data:{KINDS[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode('ascii')}"


def cell(value: object) -> str:
    """Return what stands in a cell of a table, as HTML."""
    if isinstance(value, Whisker):
        return _drawn(value)
    return _text(f"{value:.4g}" if isinstance(value, float) else value)


def _drawn(one: Whisker) -> str:
    """Return a whisker: the interval as a line, the value as a mark."""
    low, high, at = one.place(one.low), one.place(one.high), one.place(one.value)
    return (
        f'<svg class="whisker{" quiet" if one.quiet else ""}" viewBox="-2 0 104 12" preserveAspectRatio="none" '
        f'role="img" aria-label="{_text(one.text)}"><title>{_text(one.text)}</title>'
        f'<rect class="line" x="{low:.2f}" y="5" width="{max(high - low, 0.6):.2f}" height="2"></rect>'
        f'<rect class="mark" x="{at - 1.0:.2f}" y="1" width="2" height="10"></rect></svg>'
    )
