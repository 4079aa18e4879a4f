"""Arithmetic over the columns of a table: `tau-0.0189*acc-1.2*sin(q[deg])`.

An expression holds numbers, columns, + - * / **, parentheses, `pi`, the functions of `FUNCTIONS` and `d`, the
derivative. A unit in brackets behind a column or a parenthesis turns values into SI units: `v[mm/s]`; a unit in a
column's own name does so by itself. Columns are written as the table calls them, spaces, dots and brackets included, or
without the unit at the end of their name; one whose name reads as something else stands in quotes: `"2"*3`. Where an
operand may stand, the longest name that fits is meant.

What is evaluated is what the tokens below can spell: nothing has attributes, and no name reaches Python's own. Python's
parser only says what binds tighter.
"""

import ast
import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_estimator.bag.column_units import Kind, header_unit, kind_of, plain_name, si, unit_of
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import Unit
from friction_estimator.core.sample import Floats

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

TWICE = 0.01
"""A column that has a unit is not also multiplied with what that unit is worth, to this relative difference."""

_QUOTES = "\"'"
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?!\w)")
_WORD = re.compile(r"[^\W\d]\w*")
_OPERATOR = re.compile(r"\*\*|[-+*/),]")
_CHUNK = re.compile(r"[^-+*/(),\[\]]+")
_BRACKET = re.compile(r"\[([^\[\]]*)\]")

_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}

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
class Value:
    """What a part of an expression comes to.

    Attributes
    ----------
    data : (n,), or one number.
    kind : what it is of, where units say so.
    converted : the column whose own unit turned it into SI units, with that unit; `times` the constants since.
    """

    data: Any
    kind: Kind | None = None
    converted: tuple[str, Unit] | None = None
    times: float = 1.0

    @property
    def is_number(self) -> bool:
        """Whether it is a constant."""
        return np.ndim(self.data) == 0


@dataclass(frozen=True)
class Expression:
    """An expression that was read.

    Attributes
    ----------
    text : as it was written.
    columns, inputs : the columns, and the other inputs of the map, that it uses.

    Examples
    --------
    >>> one = Expression.parse("v[mm/s]*-1+offset", ["v", "offset"])
    >>> one.columns
    ('v', 'offset')
    >>> found = one.value({"v": np.array([1.0, 2e3]), "offset": np.array([0.0, 1.0])}.__getitem__)
    >>> found.data.tolist()
    [-0.001, -1.0]
    """

    text: str
    columns: tuple[str, ...]
    inputs: tuple[str, ...]
    _tree: ast.expr = field(repr=False)
    _operands: tuple["_Operand", ...] = field(repr=False)
    _units: tuple[Unit, ...] = field(repr=False)

    @classmethod
    def parse(cls, text: str, columns: Iterable[str], inputs: Iterable[str] = ()) -> "Expression":
        """Read an expression over these columns, and over inputs whose names no column has.

        Raises InputError where it cannot be read; it names the nearest column or function.
        """
        return _Reader(text, list(columns), set(inputs)).expression()

    @property
    def own_units(self) -> dict[str, Unit]:
        """Unit by column, where the column's own name says it and nothing else does."""
        return {operand.name: operand.unit for operand in self._operands if operand.unit is not None}

    def value(
        self,
        column: Callable[[str], Floats],
        other: Callable[[str], Value] = Value,
        derivative: Callable[[Floats], Floats] | None = None,
    ) -> Value:
        """Return what it comes to; NaN and infinite where arithmetic has no answer.

        Parameters
        ----------
        column, other : give a column's numbers, and the value of another input.
        derivative : gives the derivative of values by time.

        Raises
        ------
        InputError where units contradict each other, or a conversion is made twice.
        """
        with np.errstate(all="ignore"):
            try:
                return _Evaluation(self, column, other, derivative).of(self._tree)
            except RecursionError:
                raise InputError(f"{_short(self.text)}: is nested too deeply") from None


@dataclass(frozen=True)
class _Operand:
    """A name in an expression: a column, another input, or a number."""

    name: str
    is_column: bool = False
    number: float = math.nan
    unit: Unit | None = None


class _Reader:
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
        self._operands: list[_Operand] = []
        self._units: list[Unit] = []
        self._source: list[str] = []

    def expression(self) -> Expression:
        if len(self._text) > LONGEST:
            raise InputError(f"{_short(self._text)}: an expression of more than {LONGEST} characters")
        if self._text in self._columns:
            self._column(self._text)
        else:
            self._tokens()
        try:
            tree = ast.parse("".join(self._source).strip(), mode="eval").body
        except (SyntaxError, RecursionError, MemoryError):
            raise self._wrong("cannot be read; are brackets and operators complete?") from None
        used = {operand.name: operand.is_column for operand in self._operands if math.isnan(operand.number)}
        return Expression(
            self._text,
            tuple(name for name, is_column in used.items() if is_column),
            tuple(name for name, is_column in used.items() if not is_column),
            tree,
            tuple(self._operands),
            tuple(self._units),
        )

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
        if name and not (called and word and name == word[0] and _is_function(name)):
            self._column(self._known[name], alone=name)
            return place + len(name), False
        if number := _NUMBER.match(text, place):
            self._source.append(f" {float(number[0])!r} ")
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
            if not _is_function(name):
                raise self._wrong(f"no function {name!r}; {_hint(name, [*FUNCTIONS, DERIVATIVE], 'functions')}")
            self._source.append(f" {name}")
            return word.end(), True
        if name in CONSTANTS:
            self._name(_Operand(name, number=CONSTANTS[name]))
        elif name in self._inputs:
            self._name(_Operand(name))
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
        self._name(_Operand(name, is_column=True, unit=header_unit(name)))

    def _name(self, operand: _Operand) -> None:
        self._source.append(f"_{len(self._operands)}")
        self._operands.append(operand)

    def _no_column(self, name: str) -> InputError:
        return self._wrong(f"no column {name!r}; {_hint(name, self._columns, 'columns', self._known)}")

    def _wrong(self, what: str) -> InputError:
        return InputError(what if self._text in what else f"{_short(self._text)}: {what}")


class _Evaluation:
    """Computes an expression's tree."""

    def __init__(
        self,
        expression: Expression,
        column: Callable[[str], Floats],
        other: Callable[[str], Value],
        derivative: Callable[[Floats], Floats] | None,
    ) -> None:
        self._operands, self._units, self._text = expression._operands, expression._units, expression.text
        self._column, self._other, self._derivative = column, other, derivative

    def of(self, node: ast.expr) -> Value:
        """Return what a part of the tree comes to."""
        match node:
            case ast.Constant(value=float(number)):
                return Value(np.float64(number))
            case ast.Name(id=name):
                return self._named(self._operands[int(name[1:])])
            case ast.Subscript(value=inner, slice=ast.Constant(value=int(number))):
                value, unit = self.of(inner), self._units[number]
                return Value(si(unit, value.data), kind_of(unit))
            case ast.UnaryOp(op=sign, operand=inner):
                value = self.of(inner)
                return replace(value, data=-value.data) if isinstance(sign, ast.USub) else value
            case ast.BinOp(left=left, op=operator, right=right):
                return self._binary(self.of(left), operator, self.of(right))
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self._call(name, [self.of(argument) for argument in arguments])
        raise self._wrong("cannot be read; a comma stands between the arguments of a function only")

    def _named(self, operand: _Operand) -> Value:
        if not math.isnan(operand.number):
            return Value(np.float64(operand.number))
        if not operand.is_column:
            return self._other(operand.name)
        data, unit = self._column(operand.name), operand.unit
        if unit is None:
            return Value(data)
        return Value(si(unit, data), kind_of(unit), (operand.name, unit))

    def _binary(self, left: Value, operator: ast.operator, right: Value) -> Value:
        data = _BINARY[type(operator)](left.data, right.data)
        if isinstance(operator, ast.Add | ast.Sub):
            if left.kind and right.kind and left.kind != right.kind:
                raise self._wrong(f"{left.kind} and {right.kind} cannot be added")
            self._offset_once(left, right)
            return Value(data, left.kind or right.kind)
        if isinstance(operator, ast.Mult | ast.Div) and (left.is_number or right.is_number):
            return self._scaled(data, left, right, divided=isinstance(operator, ast.Div))
        return Value(data)

    def _scaled(self, data: Any, left: Value, right: Value, *, divided: bool) -> Value:
        """Return a product with a constant, or a quotient by one."""
        value, number = (left, right.data) if right.is_number else (right, left.data)
        if number == 0.0 and not (divided and left.is_number):
            what = "a division by zero" if divided else "a factor of zero"
            raise self._wrong(f"{what} leaves nothing of {', '.join(self._names()) or 'it'}")
        if divided and left.is_number:
            return Value(data)
        times = value.times / number if divided else value.times * number
        if value.converted is not None:
            name, unit = value.converted
            if unit.factor != 1.0 and abs(times / unit.factor - 1.0) < TWICE:
                raise self._twice(name, unit, f"the factor {times:.4g}")
        return Value(data, value.kind if abs(number) == 1.0 else None, value.converted, float(times))

    def _offset_once(self, left: Value, right: Value) -> None:
        """Raise InputError where what a unit's zero stands for is added once more."""
        for value, number in ((left, right.data), (right, left.data)):
            if value.converted is not None and np.ndim(number) == 0:
                name, unit = value.converted
                if unit.zero and abs(abs(number) * unit.factor / abs(unit.zero) - 1.0) < TWICE:
                    raise self._twice(name, unit, f"the offset {number:.6g}")

    def _twice(self, name: str, unit: Unit, what: str) -> InputError:
        return self._wrong(
            f"column {name} is in {unit.symbol} by its own name and is taken in SI units already: {what} would convert "
            f"it twice; leave it out, or say the column's true unit in brackets"
        )

    def _call(self, name: str, arguments: list[Value]) -> Value:
        if name == DERIVATIVE:
            wanted = 1
        else:
            function, wanted = FUNCTIONS[name]
        if len(arguments) != wanted:
            raise self._wrong(f"{name} takes {wanted} argument{'s' * (wanted > 1)}, {len(arguments)} are given")
        if name != DERIVATIVE:
            kinds = {argument.kind for argument in arguments if not argument.is_number}
            kept = kinds.pop() if name in ("abs", "min", "max") and len(kinds) == 1 else None
            return Value(function(*(argument.data for argument in arguments)), kept)
        value = arguments[0]
        if value.is_number or self._derivative is None:
            raise self._wrong("the derivative of a constant" if value.is_number else "time itself has no derivative")
        return Value(self._derivative(value.data), value.kind.rate if value.kind else None)

    def _names(self) -> list[str]:
        return [operand.name for operand in self._operands if operand.is_column]

    def _wrong(self, what: str) -> InputError:
        return InputError(f"{_short(self._text)}: {what}")


def _is_function(name: str) -> bool:
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


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."
