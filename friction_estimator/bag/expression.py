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
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_estimator.bag.column_units import Kind, kind_of, si
from friction_estimator.bag.expression_text import DERIVATIVE, FUNCTIONS, Operand, Reader, Reading, short
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import Unit
from friction_estimator.core.sample import Floats
from friction_estimator.core.text import counted

TWICE = 0.01
"""A column that has a unit is not also multiplied with what that unit is worth, to this relative difference."""

_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
}


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
    reading : what is computed.

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
    reading: Reading = field(repr=False)

    @classmethod
    def parse(cls, text: str, columns: Iterable[str], inputs: Iterable[str] = ()) -> "Expression":
        """Read an expression over these columns, and over inputs whose names no column has.

        Raises InputError where it cannot be read; it names the nearest column or function.
        """
        reading = Reader(text, list(columns), set(inputs)).read()
        used = {operand.name: operand.is_column for operand in reading.operands if math.isnan(operand.number)}
        of_table = tuple(name for name, is_column in used.items() if is_column)
        return cls(text.strip(), of_table, tuple(name for name in used if name not in of_table), reading)

    @property
    def own_units(self) -> dict[str, Unit]:
        """Unit by column, where the column's own name says it and nothing else does."""
        return {operand.name: operand.unit for operand in self.reading.operands if operand.unit is not None}

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
                return _Evaluation(self, column, other, derivative).of(self.reading.tree)
            except RecursionError:
                raise InputError(f"{short(self.text)}: is nested too deeply") from None


class _Evaluation:
    """Computes an expression's tree."""

    def __init__(
        self,
        expression: Expression,
        column: Callable[[str], Floats],
        other: Callable[[str], Value],
        derivative: Callable[[Floats], Floats] | None,
    ) -> None:
        self._operands, self._units, self._text = expression.reading.operands, expression.reading.units, expression.text
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

    def _named(self, operand: Operand) -> Value:
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
            raise self._wrong(f"{name} takes {counted(wanted, 'argument')}, {len(arguments)} are given")
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
        return InputError(f"{short(self._text)}: {what}")
