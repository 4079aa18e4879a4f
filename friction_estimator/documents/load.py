"""YAML and JSON from outside, as plain values within limits: what passes is bounded in size, depth and numbers.

Values are dicts with text as keys, lists, text, 64-bit integers, floats, booleans and None. Text holds no NUL and no
half of a surrogate pair. Nothing of a document is executed, nothing refers to itself, and a document that unfolds
(aliases, merges) counts as large as what it unfolds to.

Scalars of YAML are read as ROS reads them, not as YAML 1.1 does: `1e-3` is a number, `2001-01-01` and `1:30` are words,
a key is a word whatever it looks like. A bare `y` is a word too: here it is the name of an axis.
"""

import json
import os
import re
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import yaml

from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.regular_file import read_regular
from friction_estimator.core.settings.setting import is_text
from friction_estimator.core.text import LONGEST_NAME, shown

MOST_DIGITS = 100
"""Characters of a number: a 64-bit integer has 20, a float 24, and written out exactly some more."""

LARGEST_INTEGER = 2**63 - 1


@dataclass(frozen=True)
class Limits:
    """What a document may hold.

    Attributes
    ----------
    size : bytes. depth : of lists and sections in one another. nodes : values and sections, aliases unfolded.
    """

    size: int
    depth: int
    nodes: int


CONFIGURATION = Limits(size=2**20, depth=32, nodes=50_000)
"""Of YAML: a warm model of the largest basis has some 4,200 values and 100 kB; reading 50,000 takes 2 s."""


def load_yaml(path: str | os.PathLike[str], limits: Limits = CONFIGURATION) -> Any:
    """Return the value of a YAML file.

    Raises
    ------
    InputError : not a regular file that can be read, or too large. ConfigError : no YAML, or beyond the limits. One
        line that names the file and, where there is one, the line.
    """
    return parse_yaml(read_regular(path, limits.size), shown(path), limits)


def parse_yaml(content: bytes | str, source: str, limits: Limits = CONFIGURATION) -> Any:
    """Return the value of a YAML text; `source` names it in messages. Raises ConfigError.

    >>> parse_yaml("{a: 1e-3, on: 2001-99-99, b: &b [0x10, y], c: *b}", "text")
    {'a': 0.001, 'on': '2001-99-99', 'b': [16, 'y'], 'c': [16, 'y']}
    """
    try:
        text = content if isinstance(content, str) else content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{source} is no YAML: byte {error.start} is no UTF-8 text") from error
    loader: _Loader | None = None
    try:
        loader = _Loader(text)
        loader.limits = limits
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f" line {mark.line + 1}" if mark else ""
        reason = ", ".join(filter(None, (error.context, error.problem)))
        raise ConfigError(f"{source}{at}: {shown(reason, LONGEST_NAME)}") from error
    except yaml.YAMLError as error:  # characters that YAML does not allow
        position = getattr(error, "position", None)
        at = f" line {text.count(chr(10), 0, position) + 1}" if position is not None else ""
        raise ConfigError(f"{source}{at}: {shown(str(error).partition(chr(10))[0], LONGEST_NAME)}") from error
    finally:
        if loader is not None:
            loader.dispose()


def parse_json(content: bytes, source: str, limits: Limits) -> Any:
    """Return the value of a JSON text; `source` names it in messages. Raises InputError.

    >>> parse_json(b'{"a": [1, 2.5, null]}', "text", CONFIGURATION)
    {'a': [1, 2.5, None]}
    """
    # Before a tree of them fills the memory; text that holds such characters is counted with them.
    if sum(map(content.count, (b",", b"[", b"{"))) > limits.nodes:
        raise InputError(f"{source} holds more than {limits.nodes} values")
    try:
        value = json.loads(content, parse_int=_integer, parse_float=_number, parse_constant=_constant)
    except RecursionError:
        raise InputError(f"{source} is nested deeper than {limits.depth} levels") from None
    except (ValueError, UnicodeDecodeError) as error:
        line = getattr(error, "lineno", None)
        at = f" line {line}" if line else ""
        raise InputError(f"{source}{at} is no JSON: {shown(error, LONGEST_NAME)}") from None
    _check_tree(value, source, limits)
    return value


def _check_tree(value: Any, source: str, limits: Limits) -> None:
    """Raise InputError where a tree is too deep or too large, or text in it is none."""
    level, depth, nodes = [value], 0, 0
    while level:
        depth, nodes = depth + 1, nodes + len(level)
        if depth > limits.depth:
            raise InputError(f"{source} is nested deeper than {limits.depth} levels")
        if nodes > limits.nodes:
            raise InputError(f"{source} holds more than {limits.nodes} values")
        below: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                below += item.values()
                texts = list(item)
            else:
                below += item if isinstance(item, list) else ()
                texts = [item] if isinstance(item, str) else []
            if not all(map(is_text, texts)):
                raise InputError(f"{source} holds text with a NUL or half a surrogate pair, which is not read here")
        level = below


def _integer(text: str) -> int:
    number = int(text) if len(text) <= MOST_DIGITS else LARGEST_INTEGER + 1
    if not -LARGEST_INTEGER <= number <= LARGEST_INTEGER:
        raise ValueError("an integer of more than 64 bits")
    return number


def _number(text: str) -> float:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of more than {MOST_DIGITS} characters")
    return float(text)


def _constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with limits, and with ROS's reading of scalars."""

    limits = CONFIGURATION
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own place; none of YAML 1.1's

    def __init__(self, text: str) -> None:
        self._depth = 0
        self._nodes = 0
        self._sizes: dict[str, int] = {}
        super().__init__(text)

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node; an alias counts for all that it stands for."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if self.check_event(yaml.AliasEvent):
            if event.anchor in self.anchors and event.anchor not in self._sizes:
                raise yaml.composer.ComposerError(None, None, f"{event.anchor} refers to itself", event.start_mark)
            self._count(self._sizes.get(event.anchor, 1), event)
            return super().compose_node(parent, index)
        before = self._nodes
        self._count(1, event)
        self._depth += 1
        if self._depth > self.limits.depth + 1:
            raise yaml.composer.ComposerError(
                None, None, f"it is nested deeper than {self.limits.depth} levels", event.start_mark
            )
        node = super().compose_node(parent, index)
        self._depth -= 1
        if event.anchor is not None:
            self._sizes[event.anchor] = self._nodes - before
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        """Return a section whose names differ: YAML leaves open which of two counts, PyYAML and rcl do not agree."""
        node = super().compose_mapping_node(anchor)
        names: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in names:
                    raise yaml.composer.ComposerError(
                        None, None, f"{shown(key.value, LONGEST_NAME)} stands here a second time", key.start_mark
                    )
                names.add(key.value)
        return node

    def _count(self, nodes: int, event: Any) -> None:
        self._nodes += nodes
        if self._nodes > self.limits.nodes:
            raise yaml.composer.ComposerError(
                None, None, f"it holds more than {self.limits.nodes} values", event.start_mark
            )

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:  # noqa: ARG002 - PyYAML's
        """Return a section; its keys are text, as they are written."""
        if not isinstance(node, yaml.MappingNode):
            raise yaml.constructor.ConstructorError(None, None, "a section is expected here", node.start_mark)
        self.flatten_mapping(node)
        section: dict[Hashable, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a name is expected here", key.start_mark)
            section[self._text(key)] = self.construct_object(value, deep=True)
        return section

    def _scalar(self, node: Any) -> str:
        if not isinstance(node, yaml.ScalarNode):
            raise yaml.constructor.ConstructorError(None, None, "a single value is expected here", node.start_mark)
        return str(node.value)

    def _text(self, node: Any) -> str:
        text = self._scalar(node)
        if not is_text(text):
            raise yaml.constructor.ConstructorError(
                None, None, "text with a NUL or half a surrogate pair is not read here", node.start_mark
            )
        return text

    def _refuse(self, node: Any, what: str) -> Any:
        raise yaml.constructor.ConstructorError(
            None, None, f"{shown(node.value, LONGEST_NAME)} is {what}", node.start_mark
        )

    def _boolean(self, node: Any) -> bool:
        value = self.bool_values.get(self._scalar(node).lower())
        return bool(value) if value is not None else self._refuse(node, "neither true nor false")

    def _integer(self, node: Any) -> int:
        text = self._scalar(node)
        if len(text) > MOST_DIGITS:
            return int(self._refuse(node, "an integer of more than 64 bits"))
        sign, digits = (-1, text[1:]) if text.startswith("-") else (1, text.removeprefix("+"))
        base = 16 if digits[:2].lower() == "0x" else 8 if digits.startswith("0") else 10
        try:
            number = sign * int(digits, base)
        except ValueError:
            return int(self._refuse(node, "no integer"))
        if not -LARGEST_INTEGER <= number <= LARGEST_INTEGER:
            return int(self._refuse(node, "an integer of more than 64 bits"))
        return number

    def _float(self, node: Any) -> float:
        text = self._scalar(node)
        if len(text) > MOST_DIGITS:
            return float(self._refuse(node, f"a number of more than {MOST_DIGITS} characters"))
        try:
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            return float(self._refuse(node, "no number"))

    def _unknown(self, node: Any) -> Any:
        raise yaml.constructor.ConstructorError(
            None, None, f"the tag {shown(node.tag, LONGEST_NAME)} is not read here", node.start_mark
        )


_CORE = "tag:yaml.org,2002:"
_Loader.yaml_constructors = {
    f"{_CORE}null": _Loader.construct_yaml_null,
    f"{_CORE}bool": _Loader._boolean,
    f"{_CORE}int": _Loader._integer,
    f"{_CORE}float": _Loader._float,
    f"{_CORE}str": _Loader._text,
    f"{_CORE}seq": _Loader.construct_yaml_seq,
    f"{_CORE}map": _Loader.construct_yaml_map,
    None: _Loader._unknown,
}
for _tag, _pattern, _first in (
    ("bool", r"(?:yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)$", "yYnNtTfFoO"),
    ("int", r"[-+]?(?:0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)$", "-+0123456789"),
    (
        "float",
        r"(?:[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        "-+.0123456789",
    ),
    ("null", r"(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("merge", r"<<$", "<"),
):
    _Loader.add_implicit_resolver(_CORE + _tag, re.compile(_pattern), list(_first))
