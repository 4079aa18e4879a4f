"""Parameters of the command line, read by the program's own loader before rcl sees them.

rcl ends the process for `[0, 0.15]` ("Sequence should be of same type"), reads a bare `y` as true, knows no aliases and
quotes what it does not understand. So parameter files and `-p` rules are read as every other configuration is
(`documents`), within its limits, and rcl gets what was read in its plainest form.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.documents.configuration import (
    PARAMETER_FILE,
    PARAMETERS,
    flatten,
    load_parameter_file,
    parameter_text,
)
from friction_estimator.documents.load import parse_yaml


def params_files(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files named by `--params-file`, in order."""
    return [Path(value) for flag, value in pairwise(arguments) if flag == "--params-file"]


def repaired(arguments: Sequence[str], folder: Path) -> list[str]:
    """Return `arguments` with every parameter in the form that rcl reads as this program does.

    Parameter files are written anew into `folder`; integers among doubles become doubles.

    Raises
    ------
    InputError : a file that cannot be read. ConfigError : no parameter file, or a rule that is none; one line.
    """
    result = list(arguments)
    for index in range(1, len(result)):
        flag, value = result[index - 1], result[index]
        if flag == "--params-file":
            result[index] = _repaired_file(Path(value), folder / str(index))
        elif flag in ("-p", "--param") and ":=" in value:
            result[index] = _repaired_rule(*value.split(":=", 1))
    return result


def _repaired_file(source: Path, folder: Path) -> str:
    tree = load_parameter_file(source)
    if not tree:
        raise ConfigError(f"{shown(source)} is empty: it needs '/**:' with '{PARAMETERS}:' below it")
    folder.mkdir()
    target = folder / source.name
    target.write_text(parameter_text(_doubled(tree)), encoding="utf-8")
    return str(target)


def _repaired_rule(name: str, text: str) -> str:
    source = f"-p {shown(name, LONGEST_NAME)}"
    value = parse_yaml(text, source)
    if isinstance(value, dict):
        raise ConfigError(f"{source}: a rule sets one value, and {shown(text, LONGEST_NAME)} is a section")
    PARAMETER_FILE.check({"/**": {PARAMETERS: {"value": value}}}, source, ConfigError)
    # A number is read alike by both, and a document of one number would end with a mark.
    plain = isinstance(value, list | str)
    return f"{name}:={parameter_text(_doubled(value), flow=True).strip()}" if plain else f"{name}:={text}"


def _doubled(tree: Any) -> Any:
    """Return the tree with mixed numeric lists made floats."""
    if isinstance(tree, dict):
        return {key: _doubled(value) for key, value in tree.items()}
    if isinstance(tree, list) and {type(item) for item in tree} == {int, float}:
        return [float(item) for item in tree]
    return tree


def beside_its_file(name: str, value: str, files: Sequence[Path]) -> str:
    """Return a path parameter as an absolute path: relative to the parameter file that sets it, else as given.

    rcl hands over the value without saying which file it came from; the last file that holds the same value wins.
    """
    if not value or Path(value).is_absolute():
        return value
    for file in reversed(files):
        try:
            tree = load_parameter_file(file)
        except FrictionEstimatorError:  # changed since the start
            continue
        if _holds(tree, name, value):
            return str(file.resolve().parent / value)
    return value


def _holds(tree: dict[str, Any], name: str, value: str) -> bool:
    """Return whether a section of the tree sets the parameter `name` to `value`."""
    return any(
        flatten(section).get(name) == value if key == PARAMETERS else _holds(section, name, value)
        for key, section in tree.items()
    )
