"""What the theme leaves out for people who read by keyboard or by ear.

Blocks and tables that scroll sideways can be reached by the tab key, so that arrows scroll them; the captions of the
navigation say which level of heading they are (axe-core: scrollable-region-focusable, aria-required-attr).
"""

import re
from typing import Any

SCROLLS = re.compile(r'<(pre|table class="docutils[^"]*")>')

AFTER_THE_THEME = 900
"""Priority of the handler: the theme makes its navigation in one of its own."""


def reachable(body: str) -> str:
    """Return HTML in which whatever scrolls sideways takes the focus.

    >>> reachable('<pre>a</pre>'), reachable('<pre class="x">a</pre>')
    ('<pre tabindex="0">a</pre>', '<pre class="x">a</pre>')
    """
    return SCROLLS.sub(r'<\1 tabindex="0">', body)


def levelled(navigation: str) -> str:
    """Return HTML whose headings without a level are of the second one.

    >>> levelled('<p class="caption" role="heading">')
    '<p class="caption" role="heading" aria-level="2">'
    """
    return navigation.replace('role="heading">', 'role="heading" aria-level="2">')


def mend(_app: Any, _page: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """Mend the parts of a page before they are put together."""
    for name, mended in (("body", reachable), ("furo_navigation_tree", levelled)):
        if context.get(name):
            context[name] = mended(context[name])


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("html-page-context", mend, priority=AFTER_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
