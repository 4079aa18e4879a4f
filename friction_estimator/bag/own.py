"""Recordings that this program wrote: only these may be replaced."""

from pathlib import Path
from typing import Any

from friction_estimator.bag.metadata import NAME, information
from friction_estimator.core.errors import InputError

OUTPUT_PREFIX = "/friction_estimator"
"""Namespace of the node's outputs, in a recording as in a running graph."""

MARK = ("friction_estimator", "written by it: replaced when it writes here again")
"""Entry of `custom_data` in metadata.yaml, where a recording may carry what it likes."""


def refusal(folder: Path) -> str | None:
    """Return why a folder may not be replaced by a recording; None where it is one from here, or empty.

    One from here is marked, and holds its metadata and the files that they name, no more.
    """
    inside = {item.name for item in folder.iterdir()}
    if not inside:
        return None
    about = _metadata(folder) if NAME in inside else None
    if about is None:
        return "a folder that is no recording stands there; choose another name"
    if not _is_own(about):
        return "the recording there was not written by this program; choose another name, or move it away"
    strange = sorted(inside - {NAME, *about["relative_file_paths"]})
    if strange:
        return f"it also holds {strange[0]}, which is not part of the recording; move it out, or choose another name"
    return None


def _metadata(folder: Path) -> dict[str, Any] | None:
    try:
        return information(folder)
    except InputError:
        return None


def _is_own(about: dict[str, Any]) -> bool:
    """Whether it is marked, or holds our results as they were written before there was a mark."""
    data = about.get("custom_data")
    if isinstance(data, dict) and MARK[0] in data:
        return True
    return about.get("ros_distro") == "rosbags" and f"{OUTPUT_PREFIX}/friction_predicted" in str(
        about.get("topics_with_message_count")
    )
