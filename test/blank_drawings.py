"""Results without what they show: figures and charts are empty, for tests of names, files and numbers beside them.

Drawing is nine tenths of what writing results takes. What is drawn is looked at by the tests of pages and figures.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from friction_estimator.report import style
from friction_estimator.report.page.content import Chart

BLANK_PNG = b"\x89PNG\r\n\x1a\n"


@contextmanager
def blank_drawings() -> Iterator[None]:
    """Write every file and every word of a page, and draw nothing: each chart is the same empty one."""
    import bokeh.embed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "save", _save)
        patch.setattr(Chart, "build", property(lambda _: _nothing, lambda _, _build: None), raising=False)
        patch.setattr(bokeh.embed, "json_item", lambda _chart, name: {"target_id": name})
        yield


def _nothing() -> None:
    """Stand for what makes a chart."""


def _save(_figure: object, folder: str, name: str, formats: Sequence[str] = style.USUAL) -> Path:
    paths = [Path(folder) / f"{name}.{each}" for each in formats]
    for path in paths:
        path.write_bytes(BLANK_PNG)
    return paths[0]
