"""Command-line arguments that rcl's own parser refuses although their meaning is clear.

rcl ends the process for `[0, 0.15]` ("Sequence should be of same type"). Such files and `-p` rules are
rewritten with doubles throughout before rcl sees them; everything else is left for rcl to read.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from friction_estimator.files import flatten


def params_files(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files named by `--params-file`, in order."""
    return [Path(value) for flag, value in pairwise(arguments) if flag == "--params-file"]


def repaired(arguments: Sequence[str], folder: Path) -> list[str]:
    """Return `arguments` with mixed arrays of integers and doubles made arrays of doubles.

    Rewritten parameter files are put into `folder`. What cannot be read is passed on unchanged: rcl's
    message about it is then the one to show.
    """
    result = list(arguments)
    for index in range(1, len(result)):
        flag, value = result[index - 1], result[index]
        if flag == "--params-file":
            result[index] = _repaired_file(Path(value), folder / f"{index}.yaml")
        elif flag in ("-p", "--param") and ":=" in value:
            name, _, text = value.partition(":=")
            try:
                tree, changed = _doubled(yaml.safe_load(text))
            except yaml.YAMLError:
                continue
            if changed:
                result[index] = f"{name}:={yaml.safe_dump(tree, default_flow_style=True).strip()}"
    return result


def _repaired_file(source: Path, target: Path) -> str:
    try:
        tree, changed = _doubled(yaml.safe_load(source.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return str(source)
    if not changed:
        return str(source)
    target.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return str(target)


def _doubled(tree: Any) -> tuple[Any, bool]:
    """Return the tree with mixed numeric lists made floats, and whether anything changed."""
    if isinstance(tree, dict):
        parts = {key: _doubled(value) for key, value in tree.items()}
        return {key: value for key, (value, _) in parts.items()}, any(changed for _, changed in parts.values())
    if isinstance(tree, list) and {type(item) for item in tree} == {int, float}:
        return [float(item) for item in tree], True
    return tree, False


def beside_its_file(name: str, value: str, files: Sequence[Path]) -> str:
    """Return a path parameter as an absolute path: relative to the parameter file that sets it, else as given.

    rcl hands over the value without saying which file it came from; the last file that holds the same value wins.
    """
    if not value or Path(value).is_absolute():
        return value
    for file in reversed(files):
        try:
            tree = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError):
            continue
        if isinstance(tree, dict) and _holds(tree, name, value):
            return str(file.resolve().parent / value)
    return value


def _holds(tree: dict[str, Any], name: str, value: str) -> bool:
    for section in tree.values():
        if not isinstance(section, dict):
            continue
        parameters = section.get("ros__parameters")
        if isinstance(parameters, dict) and flatten(parameters).get(name) == value:
            return True
        if _holds(section, name, value):
            return True
    return False
