"""Expressions as text: names of columns, inputs and functions, numbers, units and operators, told apart and named.

Where an operand may stand, the longest name of a column that fits is meant. Python's parser only says what binds
tighter: it is given placeholders, numbers and operators, and nothing of the text itself.
"""

import ast
import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from friction_estimator.bag.column_units import header_unit, plain_name, unit_of
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import Unit

LONGEST = 2000
"""Characters of an expression: more is no formula, and its nesting would fill the stack."""

DERIVATIVE = "d"
"""The function that needs time: the derivative of its argument."""

FUNCTIONS: Mapping[str, tuple[Callable[..., Any], int]] = {
    "abs": (np.abs, 1),
    "sqrt": (np.sqrt, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "log10": (np.log10, 1),
    "sin": (np.sin, 1),
    "cos": (np.cos, 1),
    "tan": (np.tan, 1),
    "asin": (np.arcsin, 1),
    "acos": (np.arccos, 1),
    "atan": (np.arctan, 1),
    "atan2": (np.arctan2, 2),
    "tanh": (np.tanh, 1),
    "sign": (np.sign, 1),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
}
"""Functions by name, with their number of arguments; angles are in rad."""

CONSTANTS = {"pi": math.pi}

_QUOTES = "\"'"
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?!\w)")
_WORD = re.compile(r"[^\W\d]\w*")
_OPERATOR = re.compile(r"\*\*|[-+*/),]")
_CHUNK = re.compile(r"[^-+*/(),\[\]]+")
_BRACKET = re.compile(r"\[([^\[\]]*)\]")

_LISTED = 20


def parts(text: str) -> list[str]:
    """Return what commas separate, but not those within quotes, parentheses or brackets.

    >>> parts("velocity=d(q[deg]),friction=min(f,9)-'a,b'")
    ['velocity=d(q[deg])', "friction=min(f,9)-'a,b'"]
    """
    found, begin, depth, quote = [], 0, 0, ""
    for place, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in _QUOTES:
            quote = character
        elif character in "([":
            depth += 1
        elif character in ")]":
            depth -= 1
        elif character == "," and depth <= 0:
            found.append(text[begin:place])
            begin = place + 1
    return [*found, text[begin:]]


@dataclass(frozen=True)
class Operand:
    """A name in an expression: a column, another input, or a number."""

    name: str
    is_column: bool = False
    number: float = math.nan
    unit: Unit | None = None


@dataclass(frozen=True)
class Reading:
    """An expression in order: its tree, and what the names `_0`, `_1`, ... and the brackets in it stand for."""

    tree: ast.expr
    operands: tuple[Operand, ...]
    units: tuple[Unit, ...]


class Reader:
    """Turns text into tokens that Python's parser puts in order."""

    def __init__(self, text: str, columns: Sequence[str], inputs: set[str]) -> None:
        self._text, self._columns, self._inputs = text.strip(), list(columns), inputs
        known = {name: name for name in columns}
        plain: dict[str, list[str]] = {}
        for name in columns:
            plain.setdefault(plain_name(name), []).append(name)
        known |= {short: names[0] for short, names in plain.items() if len(names) == 1 and short not in known}
        self._known = known
        self._bare = sorted((name for name in known if _is_bare(name)), key=len, reverse=True)
        self._operands: list[Operand] = []
        self._units: list[Unit] = []
        self._source: list[str] = []

    def read(self) -> Reading:
        """Return the expression. Raises InputError where it is none; it names the nearest column or function."""
        if len(self._text) > LONGEST:
            raise InputError(f"{short(self._text)}: an expression of more than {LONGEST} characters")
        if self._text in self._columns:
            self._column(self._text)
        else:
            self._tokens()
        try:
            tree = ast.parse("".join(self._source).strip(), mode="eval").body
        except (SyntaxError, RecursionError, MemoryError):
            raise self._wrong("cannot be read; are brackets and operators complete?") from None
        return Reading(tree, tuple(self._operands), tuple(self._units))

    def _tokens(self) -> None:
        place, wants_operand = 0, True
        while place < len(self._text):
            if self._text[place].isspace():
                place += 1
            elif wants_operand:
                place, wants_operand = self._operand(place)
            else:
                place, wants_operand = self._operator(place)

    def _operand(self, place: int) -> tuple[int, bool]:
        """Take an operand, or what stands before one; return where it ends and whether one is still wanted."""
        text = self._text
        if text[place] in _QUOTES:
            end = text.find(text[place], place + 1)
            if end < 0:
                raise self._wrong(f"{text[place:]} has no closing quote")
            self._column(text[place + 1 : end])
            return end + 1, False
        word = _WORD.match(text, place)
        called = word is not None and text[word.end() :].lstrip().startswith("(")
        name = self._longest(place)
        if name and not (called and word and name == word[0] and is_function(name)):
            self._column(self._known[name], alone=name)
            return place + len(name), False
        if number := _NUMBER.match(text, place):
            value = float(number[0])
            if math.isinf(value):
                raise self._wrong(f"{number[0]} is too large for a number")
            self._source.append(f" {value!r} ")
            return number.end(), False
        if text[place] in "+-(":
            self._source.append(text[place])
            return place + 1, True
        if word is None:
            raise self._wrong(f"a column or a number is expected at {text[place:]!r}")
        return self._word(word, called)

    def _word(self, word: re.Match[str], called: bool) -> tuple[int, bool]:
        name = word[0]
        if called:
            if not is_function(name):
                raise self._wrong(f"no function {name!r}; {_hint(name, [*FUNCTIONS, DERIVATIVE], 'functions')}")
            self._source.append(f" {name}")
            return word.end(), True
        if name in CONSTANTS:
            self._name(Operand(name, number=CONSTANTS[name]))
        elif name in self._inputs:
            self._name(Operand(name))
        else:
            raise self._no_column(_CHUNK.match(self._text, word.start())[0].strip())  # type: ignore[index]
        return word.end(), False

    def _operator(self, place: int) -> tuple[int, bool]:
        text = self._text
        if bracket := _BRACKET.match(text, place):
            unit = unit_of(bracket[1])
            if unit is None:
                raise self._wrong(f"[{bracket[1]}] is no unit; write for instance [mm/s], [deg], [mN m], [bar], [degF]")
            last = self._operands[-1] if self._operands else None
            if last is not None and last.unit is not None and self._source[-1] == f"_{len(self._operands) - 1}":
                self._operands[-1] = replace(last, unit=None)  # what the map says comes before the column's name
            self._units.append(unit)
            self._source.append(f"[{len(self._units) - 1}]")
            return bracket.end(), False
        operator = _OPERATOR.match(text, place)
        if operator is None:
            if text[place] == "^":
                raise self._wrong("a power is written **, for instance v**2")
            raise self._wrong(f"an operator is expected at {text[place:]!r}; a column's name may need quotes")
        self._source.append(operator[0])
        return operator.end(), operator[0] != ")"

    def _longest(self, place: int) -> str:
        """Return the longest name that stands here; "" where none does."""
        for name in self._bare:
            end = place + len(name)
            if self._text.startswith(name, place) and not (_is_word(name[-1]) and _is_word(self._text[end : end + 1])):
                return name
        return ""

    def _column(self, name: str, alone: str = "") -> None:
        """Take a column; where an input of the map has its name too, only quotes tell which is meant."""
        if name not in self._columns:
            raise self._no_column(name)
        if alone and alone in self._inputs:
            raise self._wrong(
                f"{alone} is a column and an input of this map that is something else: write the column in quotes "
                f'("{alone}"), or what the input is made of'
            )
        self._name(Operand(name, is_column=True, unit=header_unit(name)))

    def _name(self, operand: Operand) -> None:
        self._source.append(f"_{len(self._operands)}")
        self._operands.append(operand)

    def _no_column(self, name: str) -> InputError:
        return self._wrong(f"no column {name!r}; {_hint(name, self._columns, 'columns', self._known)}")

    def _wrong(self, what: str) -> InputError:
        return InputError(what if self._text in what else f"{short(self._text)}: {what}")


def is_function(name: str) -> bool:
    """Return whether a function has this name."""
    return name == DERIVATIVE or name in FUNCTIONS


def _is_word(character: str) -> bool:
    return character.isalnum() or character == "_"


def _is_bare(name: str) -> bool:
    """Return whether a name can stand without quotes: it has a letter, and is no number."""
    return any(map(_is_word, name)) and not _NUMBER.fullmatch(name.strip())


def _hint(name: str, names: list[str], kind: str, known: Iterable[str] = ()) -> str:
    near = difflib.get_close_matches(name, list(known) or names, n=1)
    if near:
        return f"nearest: {near[0]}"
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"{kind}: {', '.join(names[:_LISTED]) + more or 'none'}"


def short(text: str) -> str:
    """Return an expression as failures show it."""
    return text if len(text) <= 80 else f"{text[:77]}..."
