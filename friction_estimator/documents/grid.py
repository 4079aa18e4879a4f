"""What a sweep is given to vary: a parameter file with alternatives in it, and `--set NAME=V1,V2,...`."""

import copy
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import PARAMETERS, PATHS
from friction_estimator.documents.configuration import PARAMETER_FILE_RULES, read_parameters
from friction_estimator.documents.load import parse_yaml
from friction_estimator.documents.schema import Schema

_VALUE = PARAMETER_FILE_RULES["$defs"]["value"]
_RULES = copy.deepcopy(PARAMETER_FILE_RULES)
_RULES["$defs"]["items"] = {
    "if": {"type": "array"},
    "then": {"items": {**_VALUE, "description": "a number or a word"}},
    "else": {**_VALUE, "description": "a number, a word, or a list of these"},
}

GRID_FILE = Schema(_RULES)
"""As a parameter file, but for lists within lists."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_SPAN = re.compile(rf"\s*(?P<low>{_NUMBER})\.\.(?P<high>{_NUMBER})(?P<log>:log)?\s*")


@dataclass(frozen=True)
class Given:
    """A parameter file for a sweep: the values that all configurations share, and alternatives by name."""

    shared: Mapping[str, Any] = field(default_factory=dict)
    alternatives: Mapping[str, list[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Ends:
    """A span as it is written: LOW..HIGH, or LOW..HIGH:log."""

    low: float
    high: float
    logarithmic: bool


def read_grid(path: str | os.PathLike[str]) -> Given:
    """Read a parameter file in which a list stands for alternatives: `order: [0, 4, 8]`.

    Where the parameter itself takes a list, alternatives are lists in a list: `terms: [[], [inertia]]`.

    Raises InputError where the file cannot be read, ConfigError where it is no such file.
    """
    values = read_parameters(path, schema=GRID_FILE)
    alternatives = {name: value for name, value in values.items() if _is_alternatives(name, value)}
    shared = {name: value for name, value in values.items() if name not in alternatives}
    here = Path(path).resolve().parent
    for name in set(alternatives) & set(PATHS):
        alternatives[name] = [str(here / one) if isinstance(one, str) and one else one for one in alternatives[name]]
    return Given(shared, alternatives)


def parse_set(text: str) -> tuple[str, list[Any] | Ends]:
    """Return name and alternatives of `NAME=V1,V2,...`; the values are YAML, or one span LOW..HIGH.

    >>> parse_set("fir.order=0,4,8"), parse_set("load.terms=[],[inertia]")
    (('fir.order', [0, 4, 8]), ('load.terms', [[], ['inertia']]))
    >>> parse_set("prior.tap_deviation=0.01..1:log")
    ('prior.tap_deviation', Ends(low=0.01, high=1.0, logarithmic=True))

    Raises ConfigError.
    """
    name, equals, values = text.partition("=")
    if not equals or not name.strip() or not values.strip():
        raise ConfigError(f"--set {text}: write NAME=VALUE,VALUE,..., for instance --set fir.order=0,4,8")
    if found := _SPAN.fullmatch(values):
        return name.strip(), Ends(float(found["low"]), float(found["high"]), found["log"] is not None)
    if ".." in values and re.fullmatch(r"[^\[\]'\"]*\d\.\.[-+.\d].*", values):
        raise ConfigError(f"--set {text}: a span is LOW..HIGH or LOW..HIGH:log, and stands alone")
    parsed = parse_yaml(f"[{values}]", f"--set {text}")
    if not isinstance(parsed, list) or any(value is None or isinstance(value, Mapping) for value in parsed):
        raise ConfigError(f"--set {text}: a value is empty or no number, word or list; write NAME=VALUE,VALUE,...")
    return name.strip(), parsed


def _is_alternatives(name: str, value: Any) -> bool:
    if not isinstance(value, list):
        return False
    known = PARAMETERS.get(name)
    return known is None or not known.is_array or any(isinstance(item, list) for item in value)
