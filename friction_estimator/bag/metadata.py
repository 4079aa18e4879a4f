"""The metadata.yaml of a ROS 2 recording: which files it is made of.

rosbags reads the file as well, with a parser that follows merges without limit. So it is checked here, before.
"""

from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from friction_estimator.core.errors import InputError
from friction_estimator.core.text import shown
from friction_estimator.documents.load import Limits, load_yaml, parse_yaml
from friction_estimator.documents.schema import Schema

NAME = "metadata.yaml"

LIMITS = Limits(size=4 * 2**20, depth=16, nodes=200_000)
"""Of a recording split into 20,000 files, and some."""

_TEXT = {"type": "string", "description": "text"}
_COUNT = {"type": "integer", "description": "a whole number"}
_RECORDING = Schema(
    {
        "type": "object",
        "description": "rosbag2_bagfile_information",
        "required": ["rosbag2_bagfile_information"],
        "properties": {
            "rosbag2_bagfile_information": {
                "type": "object",
                "description": "NAME: VALUE",
                "required": ["relative_file_paths", "topics_with_message_count"],
                "properties": {
                    "storage_identifier": _TEXT,
                    "compression_mode": _TEXT,
                    "compression_format": _TEXT,
                    "message_count": _COUNT,
                    "starting_time": {
                        "properties": {"nanoseconds_since_epoch": _COUNT},
                        "type": "object",
                        "description": "nanoseconds_since_epoch: NUMBER",
                    },
                    "duration": {
                        "properties": {"nanoseconds": _COUNT},
                        "type": "object",
                        "description": "nanoseconds: NUMBER",
                    },
                    "files": {"type": "array", "description": "a list of files and their times"},
                    "relative_file_paths": {"type": "array", "description": "a list of files", "items": _TEXT},
                    "topics_with_message_count": {
                        "type": "array",
                        "description": "a list of topics",
                        "items": {
                            "type": "object",
                            "description": "topic_metadata and message_count",
                            "required": ["topic_metadata", "message_count"],
                            "properties": {
                                "message_count": _COUNT,
                                "topic_metadata": {
                                    "type": "object",
                                    "description": "name and type of a topic",
                                    "required": ["name", "type"],
                                    "properties": {"name": _TEXT, "type": _TEXT},
                                },
                            },
                        },
                    },
                },
            }
        },
    }
)


def information(folder: Path) -> dict[str, Any]:
    """Return what the metadata.yaml in a folder says of its recording.

    Raises InputError where it cannot be read or is none; one line that names it and the place.
    """
    source = folder / NAME
    try:
        document = load_yaml(source, LIMITS)
        _RECORDING.check(document, shown(source))
        about: dict[str, Any] = document["rosbag2_bagfile_information"]
        for topic in about["topics_with_message_count"]:
            profiles = topic["topic_metadata"].get("offered_qos_profiles")
            if isinstance(profiles, str):  # YAML within YAML, which rosbags reads too
                parse_yaml(profiles, f"{shown(source)}: offered_qos_profiles", LIMITS)
    except InputError as error:
        raise InputError(f"{shown(folder)} is damaged: {error}; `ros2 bag reindex` writes its {NAME} anew") from error
    return about


def storage_files(folder: Path, about: Mapping[str, Any]) -> list[Path]:
    """Return the files of the recording in a folder, in order; they lie in it, whatever its `information` says."""
    return [folder / PurePath(name).name for name in about["relative_file_paths"]]
