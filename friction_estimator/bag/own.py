"""Recordings that this program wrote: only these may be replaced."""

from pathlib import Path
from typing import Any

import yaml

OUTPUT_PREFIX = "/friction_estimator"
"""Namespace of the node's outputs, in a recording as in a running graph."""

MARK = ("friction_estimator", "written by it: replaced when it writes here again")
"""Entry of `custom_data` in metadata.yaml, where a recording may carry what it likes."""

_METADATA = "metadata.yaml"
_LARGEST_METADATA = 1_000_000
"""Bytes; that of a recording from here has a few kilobytes."""


def refusal(folder: Path) -> str | None:
    """Return why a folder may not be replaced by a recording; None where it is one from here, or empty.

    One from here is marked, and holds its metadata and the files that they name, no more.
    """
    inside = {item.name for item in folder.iterdir()}
    if not inside:
        return None
    about = _metadata(folder / _METADATA) if _METADATA in inside else None
    if about is None:
        return "a folder that is no recording stands there; choose another name"
    if not _is_own(about):
        return "the recording there was not written by this program; choose another name, or move it away"
    strange = sorted(inside - {_METADATA} - _names(about))
    if strange:
        return f"it also holds {strange[0]}, which is not part of the recording; move it out, or choose another name"
    return None


def _metadata(path: Path) -> dict[str, Any] | None:
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_METADATA:
            return None
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        about = tree["rosbag2_bagfile_information"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError, yaml.YAMLError):
        return None
    return about if isinstance(about, dict) else None


def _is_own(about: dict[str, Any]) -> bool:
    """Whether it is marked, or holds our results as they were written before there was a mark."""
    data = about.get("custom_data")
    if isinstance(data, dict) and MARK[0] in data:
        return True
    return about.get("ros_distro") == "rosbags" and f"{OUTPUT_PREFIX}/friction_predicted" in str(
        about.get("topics_with_message_count")
    )


def _names(about: dict[str, Any]) -> set[str]:
    names = about.get("relative_file_paths")
    return {name for name in names if isinstance(name, str)} if isinstance(names, list) else set()
