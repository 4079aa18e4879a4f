"""The one configuration format: a ROS parameter file."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.setting import Value
from friction_estimator.output.target import write_text

_PATH_PARAMETERS = ("theory.table", "state.file")


class _Loader(yaml.SafeLoader):
    """Reads numbers as ROS does: `1e-3` is one, for PyYAML it is a word."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


class _Word(str):
    """A word that is written in quotes: ROS reads a bare `y` as true and `1e3` as a number."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(_Word, lambda dumper, word: dumper.represent_scalar("tag:yaml.org,2002:str", word, style="'"))


def read_parameters(path: str | os.PathLike[str], node: str = "friction_estimator") -> dict[str, Any]:
    """Read a ROS parameter file into dotted names; relative paths in it become relative to the file.

    Sections `/**` and then the node's own are merged, the latter wins. The node's own is the one of its name, in any
    namespace; where there is neither, the only one of whatever name.

    Raises InputError where the file cannot be read, ConfigError where it is no parameter file.
    """
    source = Path(path)
    try:
        tree = yaml.load(source.read_text(encoding="utf-8"), _Loader)
    except OSError as error:
        raise InputError(f"cannot read configuration {source}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        at = "" if line is None else f" (line {line + 1})"
        raise ConfigError(f"{source} is no YAML{at}: {str(error).splitlines()[0]}") from error
    if tree is None:
        return {}
    sections = {
        str(name): flatten(section["ros__parameters"])
        for name, section in (tree.items() if isinstance(tree, dict) else ())
        if isinstance(section, dict) and isinstance(section.get("ros__parameters"), dict)
    }
    if not sections:
        raise ConfigError(f"{source} is no ROS parameter file: it needs '/**:' with 'ros__parameters:' below it")
    own = [name for name in sections if name.rsplit("/", 1)[-1] == node]
    own = own or ([] if "/**" in sections else list(sections))
    if len(own) > 1:
        raise ConfigError(f"{source} holds the parameters of several nodes ({', '.join(own)}): keep one of them")
    values: dict[str, Any] = {}
    for name in ("/**", *own):
        values |= sections.get(name, {})
    for name in _PATH_PARAMETERS:
        if isinstance(values.get(name), str) and values[name]:
            values[name] = str(source.resolve().parent / values[name])
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
    values = read_parameters(path)
    ours = {k: v for k, v in values.items() if k != "use_sim_time" and not k.startswith("qos_overrides.")}
    try:
        return Config.from_mapping(ours)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def write_config(path: str | os.PathLike[str], config: Config, *, header: str = "") -> None:
    """Write a configuration as a ROS parameter file that the node and every verb read."""
    tree: dict[str, Any] = {}
    for name, value in config.to_mapping().items():
        *groups, leaf = name.split(".")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[leaf] = _plain(value)
    text = yaml.dump({"/**": {"ros__parameters": tree}}, Dumper=_Dumper, sort_keys=False, width=100)
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    write_text(path, comment + text)


def _plain(value: Value) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return _Word(value) if isinstance(value, str) else value
