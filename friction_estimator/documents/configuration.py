"""The one configuration format: a ROS parameter file, for the node, every verb and extended models."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import PATHS, Config
from friction_estimator.core.settings.joints import Settings
from friction_estimator.core.text import LONGEST_NAME, LONGEST_PARAGRAPH, shown
from friction_estimator.documents.load import load_yaml
from friction_estimator.documents.schema import Schema
from friction_estimator.output.target import write_text

PARAMETERS = "ros__parameters"

_ROS_OWN = ("use_sim_time", "start_type_description_service")

_VALUE = {"type": ["boolean", "number", "string", "null"]}
PARAMETER_FILE_RULES: dict[str, Any] = {
    "$ref": "#/$defs/nodes",
    "$defs": {
        "nodes": {
            "type": "object",
            "description": f"the name of a node, {PARAMETERS} below it, and NAME: VALUE below that",
            "properties": {PARAMETERS: {"$ref": "#/$defs/group"}},
            "additionalProperties": {"$ref": "#/$defs/nodes"},
        },
        "group": {
            "type": "object",
            "description": "NAME: VALUE",
            "additionalProperties": {
                "if": {"type": "object"},
                "then": {"allOf": [{"$ref": "#/$defs/group"}, {"minProperties": 1, "description": "a value"}]},
                "else": {
                    "if": {"type": "array"},
                    "then": {"items": {"$ref": "#/$defs/items"}},
                    "else": {"$ref": "#/$defs/value"},
                },
            },
        },
        "items": {**_VALUE, "description": "a number or a word"},
        "value": _VALUE,
    },
}
PARAMETER_FILE = Schema(PARAMETER_FILE_RULES)
"""Nodes by name or by namespace and name, their parameters in groups or under dotted names; lists are of single values,
as rcl reads them."""


class Word(str):
    """A word that is written in quotes: ROS reads a bare `y` as true and `1e3` as a number."""


class Dumper(yaml.SafeDumper):
    """Writes a parameter file as rcl reads it: no aliases, words in quotes."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - PyYAML's interface
        """Return True: rcl does not know aliases."""
        return True


Dumper.add_representer(Word, lambda dumper, word: dumper.represent_scalar("tag:yaml.org,2002:str", word, style="'"))


def load_parameter_file(path: str | os.PathLike[str], schema: Schema = PARAMETER_FILE) -> dict[str, Any]:
    """Return the tree of a ROS parameter file; an empty one is none.

    Raises InputError where the file cannot be read, ConfigError where it is no parameter file.
    """
    tree = load_yaml(path)
    if tree is None:
        return {}
    schema.check(tree, shown(path), ConfigError)
    return dict(tree)


def read_parameters(
    path: str | os.PathLike[str], node: str = "friction_estimator", schema: Schema = PARAMETER_FILE
) -> dict[str, Any]:
    """Read a ROS parameter file into dotted names; relative paths in it become relative to the file.

    Sections `/**` and then the node's own are merged, the latter wins. The node's own is the one of its name, in any
    namespace; where there is neither, the only one of whatever name.

    Raises InputError where the file cannot be read, ConfigError where it is no parameter file.
    """
    source = Path(path)
    tree = load_parameter_file(source, schema)
    if not tree:
        return {}
    sections = {name: flatten(section[PARAMETERS]) for name, section in tree.items() if PARAMETERS in section}
    if not sections:
        raise ConfigError(f"{shown(source)} is no ROS parameter file: it needs '/**:' with '{PARAMETERS}:' below it")
    own = [name for name in sections if name.rsplit("/", 1)[-1] == node]
    own = own or ([] if "/**" in sections else list(sections))
    if len(own) > 1:
        names = shown(", ".join(own), LONGEST_NAME)
        raise ConfigError(f"{shown(source)} holds the parameters of several nodes ({names}): keep one of them")
    values: dict[str, Any] = {}
    for name in ("/**", *own):
        values |= sections.get(name, {})
    for name, value in values.items():
        if isinstance(value, str) and value and name.endswith(PATHS):
            values[name] = str(source.resolve().parent / value)
    return values


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested sections under their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def read_config(path: str | os.PathLike[str]) -> Config:
    """Read a configuration; ROS's own parameters in it (use_sim_time, qos_overrides) are passed over."""
    return config_of(read_parameters(path), path)


def is_ros_own(name: str) -> bool:
    """Return True for parameters that rclpy itself declares: they stand in every dump of a node."""
    return name in _ROS_OWN or name.startswith("qos_overrides.")


def config_of(values: Mapping[str, Any], path: str | os.PathLike[str], joint: str = "") -> Config:
    """Return the configuration of parameters that were read from `path`, which a ConfigError names.

    With a `joint`, that of this one of several (`core.settings.joints`).
    """
    ours = {name: value for name, value in values.items() if not is_ros_own(name)}
    try:
        return Settings().updated(ours).of_joint(joint)
    except ConfigError as error:
        raise ConfigError(f"{shown(path)}: {error}") from error


def write_config(path: str | os.PathLike[str], config: Config, *, header: str = "") -> None:
    """Write a configuration as a ROS parameter file that the node and every verb read."""
    tree: dict[str, Any] = {}
    for name, value in config.to_mapping().items():
        *groups, leaf = name.split(".")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[leaf] = value
    comment = "".join(f"# {shown(line, LONGEST_PARAGRAPH)}\n" for line in header.splitlines())
    write_text(path, comment + parameter_text({"/**": {PARAMETERS: tree}}))


def parameter_text(tree: Any, *, flow: bool = False) -> str:
    """Return a tree as YAML that rcl reads as this program does; `flow`: in one line."""
    width = 2**20 if flow else 100
    return str(yaml.dump(_quoted(tree), Dumper=Dumper, sort_keys=False, width=width, default_flow_style=flow))


def _quoted(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _quoted(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_quoted(item) for item in value]
    return Word(value) if isinstance(value, str) else value
