"""A written page, read as its reader does: what is text, what is data, and what is the drawing library's own code."""

import re
from html import unescape

_SCRIPT = re.compile(r"<script(?P<kind>[^>]*)>(?P<code>.*?)</script>", re.DOTALL)


def own(page: str) -> str:
    """Return the page without the code of libraries and of its own: words, style and data."""
    return _SCRIPT.sub(lambda m: m[0] if "json" in m["kind"] else "", page)


def words(page: str) -> str:
    """Return what one reads on the page, in one line."""
    body = re.sub(r"<style>.*?</style>", "", _SCRIPT.sub("", page), flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", body)).split())


def data(page: str) -> list[str]:
    """Return the charts' documents, as JSON."""
    return [m["code"] for m in _SCRIPT.finditer(page) if "json" in m["kind"]]
