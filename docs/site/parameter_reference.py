"""The reference of all settings, from their declarations (`core.settings`)."""

import math
from itertools import groupby
from pathlib import Path

from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.setting import Parameter


def markdown(folder: Path, address: str) -> str:  # noqa: ARG001 - no pictures
    """Return a list for each group of settings: lists fit a phone, six columns do not."""
    parts = []
    ordered = sorted(PARAMETERS.values(), key=lambda item: "." in item.name)
    for group, items in groupby(ordered, key=lambda item: item.name.rpartition(".")[0]):
        if group:
            about = (type(getattr(Config(), group)).__doc__ or "").splitlines()[0]
            parts += [f"## {group}", "", about, ""]
        parts += [_told(item) for item in items]
        parts.append("")
    return "\n".join(parts)


def _told(item: Parameter) -> str:
    acts = "written by the estimator" if item.learned else item.acts
    facts = "; ".join(filter(None, (item.units, _range(item), acts)))
    return f"- **`{item.name}`**, default {_default(item)}: {item.description} *({facts})*"


def _default(item: Parameter) -> str:
    if item.default in ((), ""):
        return "empty"
    if isinstance(item.default, bool):
        return f"`{str(item.default).lower()}`"
    return f"`{item.default:g}`" if isinstance(item.default, float) else f"`{item.default}`"


def _range(item: Parameter) -> str:
    if item.choices:
        return ", ".join(f"`{choice}`" for choice in item.choices)
    if math.isfinite(item.low) or math.isfinite(item.high):
        return f"{item.low:g} to {item.high:g}"
    return ""
