"""Write a page: interactive where bokeh is installed, with static figures where it is not."""

import base64
import json
import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_estimator.core.text import LONGEST_PARAGRAPH, shown
from friction_estimator.report.page import static
from friction_estimator.report.page.content import Chart, Page

if TYPE_CHECKING:
    from jinja2 import Environment

NOTE = (
    "bokeh is not installed here, so the figures are still pictures: `pip install bokeh` makes this page interactive."
)


def is_interactive() -> bool:
    """Return whether what draws interactive pages is installed."""
    return find_spec("bokeh") is not None and find_spec("jinja2") is not None


def write_page(path: str | os.PathLike[str], page: Page) -> None:
    """Write a page into one file that loads nothing from elsewhere."""
    text = _interactive(page) if is_interactive() else static.text_of(page, NOTE)
    Path(path).write_text(text, encoding="utf-8")


def _interactive(page: Page) -> str:
    from markupsafe import Markup  # noqa: PLC0415

    items: list[str] = []

    def item(chart: Chart) -> str:
        """Keep a chart's document; return its name."""
        from bokeh.embed import json_item  # noqa: PLC0415 - half a second, and a page may have no chart

        name = f"chart-{len(items) + 1}"
        items.append(_script_json(json_item(chart.build(), name)))
        return name

    environment = _environment()
    body = environment.get_template("page.html").render(page=page, item=item)
    scripts = [code.replace("</script", "<\\/script") for code in (_bokeh() if items else [])]
    # The charts' data are known only when the body is made; they stand behind it, so that it is seen first.
    return environment.get_template("document.html").render(
        title=page.title,
        body=Markup(body),
        items=[(f"chart-{k}", Markup(text)) for k, text in enumerate(items, start=1)],
        scripts=[Markup(code) for code in scripts],
        css=Markup(_template("page.css")),
        js=Markup(_template("page.js")),
    )


def _bokeh() -> list[str]:
    """Return the code that draws charts in a browser, 1.3 MB."""
    from bokeh.resources import Resources  # noqa: PLC0415

    return list(Resources(mode="inline", components=["bokeh"]).js_raw)


def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415
    from markupsafe import Markup  # noqa: PLC0415

    def safe(value: Any) -> Any:
        """Return text in which nothing from a recording's names can hide; the template escapes it."""
        return value if isinstance(value, Markup) else shown(value, LONGEST_PARAGRAPH)

    environment = Environment(
        loader=PackageLoader("friction_estimator.report.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=safe,
    )
    environment.filters["cell"] = lambda value: Markup(static.cell(value))
    environment.filters["picture"] = lambda file: Markup(static.embedded(file))
    return environment


def _template(name: str) -> str:
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def _script_json(value: Any) -> str:
    """Return JSON that may stand in a script element: no `<` can end it."""
    return json.dumps(value, separators=(",", ":"), default=_buffer).replace("<", "\\u003c")


def _buffer(value: Any) -> str:
    """Return what bokeh keeps as bytes as base64."""
    return base64.b64encode(value.to_bytes() if hasattr(value, "to_bytes") else value).decode("ascii")
